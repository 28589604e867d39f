"""Voice activity on signals whose onsets are known, and the level of speech."""

import numpy as np
import pytest

from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import (
    LONGEST_DROWNED,
    active_level_db,
    band_levels,
    normalise_level,
    speech_activity,
)
from deitalk.config.rules import Gates
from deitalk.live.activity import RunningActivity

RATE = 16000
NOISES_DB = {"a synthetic voice": -300, "low noise": -80, "a room": -50, "a noisy room": -38}
"""White noise around speech of -23 dBFS; that of a synthetic voice is digital silence too."""


def voice(seconds, rng, level_db=-23.0):
    """Syllables at 4 Hz: a buzz at 120 Hz through moving formants, in a strong envelope."""
    t = np.arange(round(seconds * RATE)) / RATE
    buzz = sum(
        np.sin(2 * np.pi * 120 * k * t + rng.uniform(0, 6))
        / (1 + ((120 * k - 500 - 200 * np.sin(2 * np.pi * 2 * t)) / 300) ** 2)
        for k in range(1, 30)
    )
    envelope = 0.03 + 0.97 * np.sin(np.pi * ((4 * t) % 1)) ** 2
    samples = buzz * envelope
    return samples * 10 ** (level_db / 20) / np.sqrt(np.mean(samples**2))


def noise(seconds, rng, level_db):
    return rng.normal(0, 10 ** (level_db / 20), round(seconds * RATE))


def placed(rng, pieces, level_db=-23.0, noise_db=-70.0):
    """Speech and pauses of given seconds (pauses negative) in white noise, and the truth (T,)."""
    parts = [np.zeros(round(-p * RATE)) if p < 0 else voice(p, rng, level_db) for p in pieces]
    truth = np.concatenate([np.full(round(abs(p) * 30), float(p > 0)) for p in pieces])
    clean = np.concatenate(parts)
    return clean + noise(len(clean) / RATE, rng, noise_db), truth


def digital(seconds, rng, kind):
    """Zeros, or what 16 bits make of them with triangular dither."""
    n = round(seconds * RATE)
    return np.zeros(n) if kind == "zeros" else np.round(rng.triangular(-1, 0, 1, n)) / 32768


def around_takes(rng, kind, noise_db, between, ends, takes=4):
    """Takes of 3.5 s with digital silence between them and at the ends, and the truth (T,)."""
    parts, truth = [digital(ends, rng, kind)], [np.zeros(round(30 * ends))]
    for _ in range(takes):
        sound, speaks = placed(rng, [-0.7, 1.1, -0.7, 0.5, -0.5], noise_db=noise_db)
        parts += [sound, digital(between, rng, kind)]
        truth += [speaks, np.zeros(round(30 * between))]
    whole = np.concatenate([*parts, parts[0]]).astype(np.float32)
    return whole, np.concatenate([*truth, truth[0]])


def live_activity(waveform):
    """Flags of a voice that has not ended: gaps are not bridged [shape=(T,)]."""
    levels, running = band_levels(waveform)[None], RunningActivity(Gates(), 5)
    held, rest = np.zeros(levels.shape[:2], bool), np.zeros(1)
    return running(levels, held, rest, running.first(1))[0][0, -levels.shape[1] :]


def edges(mask):
    return np.flatnonzero(np.diff(mask))


def test_onsets_and_offsets_are_found_within_two_frames(rng):
    waveform, truth = placed(rng, [-1, 1.5, -0.7, 1, -1.2])
    activity = speech_activity(waveform)
    assert activity.dtype == np.float32
    assert activity.shape == truth.shape
    assert np.abs(edges(activity) - edges(truth)).max() <= 3  # of which the envelope takes one


@pytest.mark.parametrize("level_db", [-60, -50, -35, -10, 0])
def test_activity_does_not_depend_on_the_level(rng, level_db):
    waveform, truth = placed(rng, [-1, 1.5, -0.7, 1, -1.2], level_db, level_db - 30)
    in_steps = np.round(waveform * 32768) / 32768  # as a 16-bit file has it
    assert (speech_activity(in_steps) == truth).mean() > 0.95


def test_activity_is_found_at_five_db(rng):
    waveform, truth = placed(rng, [-1, 2, -1, 2, -1], noise_db=-28)
    activity = speech_activity(waveform)
    assert activity[truth == 1].mean() > 0.9
    assert activity[truth == 0].mean() < 0.05


def test_masked_syllable_is_no_pause(rng):
    """0.4 s without speech: a pause where the recording is clean, perhaps masked speech in noise."""
    pieces = [-1, 2, -0.4, 2, -1]
    gap = slice(30 + 60 + 2, 30 + 60 + 12 - 2)
    assert not speech_activity(placed(rng, pieces)[0])[gap].any()
    assert speech_activity(placed(rng, pieces, noise_db=-28)[0])[gap].all()
    long = [-1, 2, -0.7, 2, -1]
    assert not speech_activity(placed(rng, long, noise_db=-28)[0])[92:109].any()


@pytest.mark.parametrize("seconds", [0.5, 1, 3, 30])
@pytest.mark.parametrize("level_db", [-70, -40, -6])
def test_steady_noise_is_silence(rng, seconds, level_db):
    assert not speech_activity(noise(seconds, rng, level_db)).any()


def test_noise_floor_follows_a_change(rng):
    """Noise that starts half way is no speech."""
    waveform = np.concatenate([noise(30, rng, -70), noise(30, rng, -40)])
    waveform[5 * RATE : 7 * RATE] += voice(2, rng)
    waveform[50 * RATE : 52 * RATE] += voice(2, rng)
    activity = speech_activity(waveform)
    assert activity[152:208].mean() > 0.9
    assert activity[1502:1558].mean() > 0.9
    assert activity[220 : 23 * 30].mean() == 0
    assert activity[37 * 30 : 1490].mean() == 0


@pytest.mark.parametrize("kind", ["zeros", "dither"])
@pytest.mark.parametrize("noise_db", NOISES_DB.values(), ids=NOISES_DB)
@pytest.mark.parametrize(("between", "ends"), [(0.4, 0), (0, 2), (2, 8)])
def test_digital_silence_says_nothing_of_the_room(rng, kind, noise_db, between, ends):
    """Room noise beside zeros is no speech; a synthetic voice, all of whose pauses they are, is."""
    waveform, truth = around_takes(rng, kind, noise_db, between, ends)
    activity = speech_activity(waveform)
    assert activity[truth == 1].mean() > 0.95
    assert activity[truth == 0].mean() < 0.05
    live, heard = live_activity(waveform), np.arange(len(truth)) >= 30 * (ends + 4)
    assert live[heard & (truth == 0)].mean() < 0.05
    assert live[heard & (truth == 1)].mean() > 0.8, "weak syllables, which are bridged later"


@pytest.mark.parametrize("seconds", [0.3, 0.6, 1])
def test_a_word_amid_zeros_is_speech(rng, seconds):
    """What is too short to show a room is not taken for it."""
    silence = np.zeros(3 * RATE)
    activity = speech_activity(np.concatenate([silence, voice(seconds, rng), silence]))
    assert activity[91 : 89 + round(30 * seconds)].mean() > 0.9
    assert activity[:88].max() == activity[93 + round(30 * seconds) :].max() == 0


def test_clicks_are_not_speech(rng):
    waveform = noise(4, rng, -60)
    waveform[2 * RATE] = 0.5
    waveform[3 * RATE] = 0.5
    assert not speech_activity(waveform).any()


def test_activity_is_symmetric_in_time(rng):
    """Reversed speech is active at the mirrored frames: windows are centred on frames."""
    waveform, _ = placed(rng, [-1, 1.5, -0.7, 1, -1.2])
    whole = waveform[: 161 * 1600 // 3 + 1]  # frame 161 is the last sample: frames mirror
    forwards, backwards = speech_activity(whole), speech_activity(whole[::-1])[::-1]
    assert np.abs(edges(forwards) - edges(backwards)).max() <= 1


def test_breath_far_below_the_speech_is_not_speech(rng):
    parts = [voice(1, rng, -10), np.zeros(RATE), voice(1, rng, -62), np.zeros(RATE)]
    activity = speech_activity(np.concatenate(parts))
    assert activity[1:29].all()
    assert not activity[33:].any()
    assert speech_activity(np.concatenate(parts[1:]))[31:59].all()  # alone it is speech


def test_real_speech_keeps_its_activity_in_noise(shared):
    found, false = [], []
    clips = sorted((shared / "data/speech/librispeech").glob("*-0005.mp3"))[:6]
    for name in ("white_noise", "running_tap"):
        background = load_audio(shared / f"data/noise/{name}.flac").waveform
        assert speech_activity(background).mean() < 0.01
        for clip in clips:
            speech = np.pad(load_audio(clip).waveform, RATE)
            truth = speech_activity(speech)
            scale = 10 ** ((active_level_db(speech) - 5) / 20) / background.std()
            activity = speech_activity(speech + scale * np.resize(background, len(speech)))
            found.append(activity[truth == 1].mean())
            changes = np.flatnonzero(np.diff(truth, prepend=1, append=1))
            for start, stop in changes.reshape(-1, 2):
                if stop - start > LONGEST_DROWNED:  # shorter ones are bridged on purpose
                    false.append(activity[start:stop].mean())
    assert np.mean(found) > 0.92
    assert len(false) >= 20
    assert np.mean(false) < 0.03


def test_active_level_leaves_pauses_out(rng):
    speech = voice(3, rng, -23.0)
    assert active_level_db(speech) == pytest.approx(-23, abs=0.3)
    padded = np.concatenate([np.zeros(20 * RATE), speech, np.zeros(30 * RATE)])
    assert active_level_db(padded) == pytest.approx(-23, abs=0.5)  # its mean level is -35
    assert active_level_db(np.zeros(RATE)) == -np.inf


def test_active_level_by_hand():
    waveform = np.concatenate([np.full(RATE, 0.1), np.full(RATE, 0.9)])
    activity = np.concatenate([np.ones(30), np.zeros(30)])
    assert active_level_db(waveform, activity) == pytest.approx(-20, abs=1e-4)
    assert np.abs(normalise_level(waveform, -40, activity)).max() == pytest.approx(0.09, rel=1e-5)


@pytest.mark.parametrize("gain_db", [-27, 0, 20])
def test_normalised_speech_has_the_target_level_at_any_gain(rng, gain_db):
    waveform, _ = placed(rng, [-3, 2, -3])
    levelled = normalise_level(waveform * 10 ** (gain_db / 20), -30)
    assert levelled.dtype == np.float32
    assert active_level_db(levelled) == pytest.approx(-30, abs=0.2)
