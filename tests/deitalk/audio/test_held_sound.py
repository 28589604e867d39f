"""Held sounds: found in voices and not in noise; the mouth stays open while a vowel sounds."""

from itertools import combinations

import numpy as np
import pytest
from scipy.signal import lfilter

from deitalk import animate
from deitalk.audio.held_sound import Held, first_held, follow_held, held_sound
from deitalk.audio.load import load_audio
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import band_levels, speech_activity
from deitalk.config.rules import HoldPose
from deitalk.live.animator import LiveAnimator
from rig import default_controls
from rig.arrays import Float32

RATE = 16_000
FORMANTS = {"AA": (730, 1090, 2440), "EH": (530, 1840, 2480), "OW": (450, 900, 2400)}
JAW = default_controls().index("CTRL_C_jaw.ty")
LEAD = 0.5
"""Seconds of a quiet room before and after a vowel."""


def vowel(name, seconds, pitch=120.0, vibrato=0.0, swell_db=0.0) -> Float32:
    """Pulses of a voice through three resonances, at -20 dB RMS."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * RATE)) / RATE
    track = pitch * (1 + vibrato * np.sin(2 * np.pi * 5.5 * t))
    pulses = np.diff(np.floor(np.cumsum(track / RATE)), prepend=0)
    sound = lfilter([1, -1], [1, -0.97], pulses)
    for centre, width in zip(FORMANTS[name], (80, 100, 140), strict=True):
        r = np.exp(-np.pi * width / RATE)
        sound = lfilter([1 - r], [1, -2 * r * np.cos(2 * np.pi * centre / RATE), r * r], sound)
    sound = sound * np.clip(np.minimum(t / 0.05, (seconds - t) / 0.08), 0, 1)
    sound = sound * 10 ** (-swell_db * np.cos(2 * np.pi * t / seconds) / 20)
    sound = np.pad(0.1 * sound / np.sqrt(np.square(sound).mean()), round(LEAD * RATE))
    return (sound + 10 ** (-65 / 20) * rng.standard_normal(len(sound))).astype(np.float32)


VOWELS = {
    "5 s": ("AA", 5), "12 s": ("EH", 12), "rounded": ("OW", 8),
    "high": ("EH", 5, 260.0), "sung": ("EH", 6, 440.0, 0.02),
    "vibrato": ("AA", 8, 200.0, 0.03), "swell": ("EH", 6, 150.0, 0, 6.0),
}  # fmt: skip


@pytest.mark.parametrize("how", ["animate", "live"])
@pytest.mark.parametrize("given", VOWELS.values(), ids=VOWELS)
def test_the_mouth_stays_open_while_a_vowel_sounds_and_shuts_after(given, how):
    sound = vowel(*given)
    if how == "animate":
        curves = animate(sound, sample_rate=RATE, life="off").curves.values
    else:
        animator = LiveAnimator(life="off")
        curves = np.concatenate((animator.feed(sound), animator.finish()))
    jaw, last = curves[:, JAW], round((LEAD + given[1]) * 30)
    early = jaw[18:27].max()
    assert early > 0.04 and jaw[18 : last - 2].min() > 0.02
    # a voice that has not ended is known to be held after 0.7 s
    first = 20 if how == "animate" else 36
    assert jaw[first : last - 2].min() > 0.4 * early
    assert jaw[last + 13 :].max() < 0.02


@pytest.mark.parametrize("given", VOWELS.values(), ids=VOWELS)
def test_all_of_a_vowel_is_speech(given):
    activity, last = speech_activity(vowel(*given)), round((LEAD + given[1]) * 30)
    assert activity[16 : last - 1].min() == 1
    assert activity[:13].max() == 0 == activity[last + 4 :].max()


def held_in(sound):
    prosody = measure_prosody(sound, len(sound) * 30 // RATE)
    levels = band_levels(sound)[: len(prosody.tone)]
    return held_sound(levels, prosody.tone, HoldPose())


NOISES = {"white": 0.0, "dark": 0.9, "rumble": 0.99}


@pytest.mark.parametrize("pole", NOISES.values(), ids=NOISES)
def test_noise_is_not_held(pole, rng):
    noise = lfilter([1], [1, -pole], rng.standard_normal(6 * RATE)).astype(np.float32)
    assert held_in(0.1 * noise / noise.std()).sounding.mean() < 0.02


@pytest.mark.parametrize("name", ["promise", "amiable"])
def test_speech_is_not_held(name):
    """Nasals between vowels change a spectrum little."""
    assert not held_in(load_audio(f"docs/samples/{name}.flac").waveform).share.any()


@pytest.mark.parametrize("piece", [1, 3, 50])
def test_pieces_give_the_same(piece, rng):
    levels = np.repeat(rng.uniform(-40, -20, (2, 8, 14)), (3, 40, 1, 30, 5, 20, 1, 44), axis=1)
    tones = np.ones(levels.shape[:2])
    whole, _ = follow_held(levels, tones, HoldPose(), first_held(2, 14))
    state, parts = first_held(2, 14), []
    for start in range(0, levels.shape[1], piece):
        rows = slice(start, start + piece)
        found, state = follow_held(levels[:, rows], tones[:, rows], HoldPose(), state)
        parts.append(found)
    for name, part in zip(Held._fields, zip(*parts, strict=True), strict=True):
        np.testing.assert_array_equal(np.concatenate(part, axis=1), getattr(whole, name))
    assert whole.sounding.any() and (np.diff(whole.back[0]) == 1).any()


def test_parts_of_a_state_share_no_memory():
    """Streams write theirs in place."""
    state = first_held(2, 14)
    assert not any(np.shares_memory(one, other) for one, other in combinations(state, 2))
