"""Activity, level and intensity of a voice that has not ended."""

import numpy as np
import pytest
import torch

from deitalk.audio.running_level import USUAL_POWER, first_level, follow_level
from deitalk.audio.voice_activity import BAND_EDGES_HZ, WINDOW
from deitalk.config.rules import Gates, RulesConfig, VoiceIntensity
from deitalk.live.activity import MOST_STEP, RunningActivity
from deitalk.live.analysis import FrameMeasures, VoiceAnalysis
from deitalk.live.intensity import Measures, RunningIntensity, follow_means
from deitalk.models.protocol import SpectraGrid
from deitalk.models.streams import put, take
from deitalk.postprocess.gates import expression_share

BANDS = len(BAND_EDGES_HZ) - 1
GRIDS = {"live": SpectraGrid(3, 400, 3), "small": SpectraGrid(3, 400, 2, 1, 0)}


def gates_of(speaking, *, rest=0.5, noise_db=-75.0, piece=1000, ahead=5):
    """Gate of the mouth and share of the expression for a voice 30 dB above its noise, fed in
    pieces."""
    levels = np.full((len(speaking), BANDS), noise_db, np.float32)
    levels[np.asarray(speaking, bool)] += 30
    running, gates, stays = RunningActivity(Gates(), ahead), [], np.full(1, rest, np.float32)
    state = running.first(1)
    for start in range(0, len(levels), piece):
        levels_now = levels[None, start : start + piece]
        held = np.zeros(levels_now.shape[:2], bool)
        _, *found, state = running(levels_now, held, stays, state)
        gates.append([gate[0] for gate in found])
    return tuple(np.concatenate(parts)[ahead:] for parts in zip(*gates, strict=True))


def spoken(*spans, frames=200):
    flags = np.zeros(frames, bool)
    for start, stop in spans:
        flags[start:stop] = True
    return flags


@pytest.mark.parametrize(("ahead", "first"), [(5, 56), (3, 58), (2, 59), (1, 60)])
def test_mouth_opens_before_speech_as_far_as_it_is_known_and_closes_after(ahead, first):
    mouth, _ = gates_of(spoken((60, 100)), ahead=ahead)
    assert mouth[60:100].min() == 1 and mouth[:first].max() == 0 and mouth[111:150].max() == 0
    assert np.all(np.diff(mouth[first - 1 : 61]) > 0) and np.all(np.diff(mouth[99:111]) < 0)


def test_closures_are_bridged_and_clicks_left_out():
    mouth, _ = gates_of(spoken((60, 80), (84, 100), (150, 151)))
    assert mouth[60:100].min() == 1 and mouth[140:160].max() == 0


@pytest.mark.parametrize("rest", [0, 0.5, 1])
@pytest.mark.parametrize("piece", [1, 3, 1000])
def test_share_of_the_expression_is_that_of_a_whole_recording(rest, piece):
    """But for its rise, which begins with what is found ahead, and is as fast from any share."""
    speaking = spoken((60, 100), (190, 230), frames=1000)
    _, share = gates_of(speaking, rest=rest, piece=piece)
    whole = expression_share(speaking, rest)[: len(share)]
    assert share[0] == pytest.approx(rest, abs=0.01), "before any speech as long after it"
    settled = np.r_[62:170, 192:820]
    np.testing.assert_allclose(share[settled], whole[settled], atol=1e-5)
    assert share[184] < share[187] < share[191] == 1 or rest == 1, "it rises before speech"
    assert np.abs(np.diff(share)).max() <= MOST_STEP + 1e-6


def test_steady_noise_becomes_the_floor():
    levels = np.full((120, BANDS), -50, np.float32)
    running = RunningActivity(Gates(), 5)
    held, rest = np.zeros((1, 120), bool), np.zeros(1, np.float32)
    on = running(levels[None], held, rest, running.first(1))[0][0, -120:]
    assert on[:30].all() and not on[70:].any()


@pytest.mark.parametrize("gain_db", [-20, 0, 15])
def test_running_level_finds_the_voice_and_keeps_it_through_a_pause(gain_db, rng):
    syllables = np.clip(np.sin(np.arange(150) / 2), 0, 1) ** 2
    power = USUAL_POWER * 10 ** (gain_db / 10) * np.concatenate((syllables, np.zeros(300)))
    level, _ = follow_level(torch.tensor(power)[None].float(), torch.from_numpy(first_level(1)))
    found = 10 * np.log10(level[0].numpy() / USUAL_POWER) - gain_db
    assert abs(found[149]) < 4 and abs(found[60]) < 6  # syllables are half of the time
    assert found[149] == pytest.approx(found[-1], abs=1e-3)


def test_running_level_goes_on_where_it_stopped(rng):
    power = torch.tensor(rng.uniform(0, 0.01, (2, 50))).float()
    whole, end = follow_level(power, torch.from_numpy(first_level(2)))
    first, state = follow_level(power[:, :20], torch.from_numpy(first_level(2)))
    second, last = follow_level(power[:, 20:], state)
    assert torch.equal(torch.cat((first, second), dim=1), whole) and torch.equal(last, end)


def intensity_of(level_db, network=0.5, rule=VoiceIntensity(), speaking=True, effort=0.0):
    n = len(level_db)
    zeros, ones = np.zeros(n), np.ones(n)
    measures = Measures(np.asarray(level_db, float), zeros, zeros, ones, zeros)
    flags = np.full(n, speaking)
    network, effort = np.full(n, network, np.float32), np.broadcast_to(effort, n)
    running = RunningIntensity(rule)
    measures = Measures(*(track[None] for track in measures))
    given = network[None], measures, flags[None], effort[None]
    return running(*given, running.first(1))[0][0]


def test_steady_effort_gives_in_time_the_operating_point_of_a_take_of_that_strength():
    """0.1 of the logarithm of odds a decibel, as `voice_intensity` has it for a whole take."""
    for effort in (0.0, 5.0, -5.0, 20.0):
        found = intensity_of(np.full(3000, -20.0), effort=effort)[-1]
        expected = 1.2 / (1 + np.exp(-0.1 * (effort - VoiceIntensity().middle)))
        assert found == pytest.approx(expected, abs=0.01)


def test_effort_is_followed_within_a_second_or_two():
    """Ten usual seconds and two of a shout, of the same level."""
    effort = np.repeat([0.0, 12.0], [300, 60])
    found = intensity_of(np.full(360, -20.0), effort=effort)
    assert found[330] > found[299] + 0.1 and found[359] > found[299] + 0.2


def test_intensity_rises_with_the_level_and_not_with_the_gain():
    louder = np.repeat([-30.0, -20.0], 90)
    voice = intensity_of(louder)
    assert voice[110] > voice[80] + 0.03
    assert np.allclose(intensity_of(louder + 12), voice)


def test_intensity_stays_in_pauses_and_is_the_networks_without_the_rule():
    assert np.ptp(intensity_of(np.linspace(-60, 0, 50), speaking=False)) == 0
    analysis = VoiceAnalysis(RulesConfig(voice_intensity=None), GRIDS["live"])
    network = np.full((2, 5), 0.3, np.float32)
    rest = np.zeros(2, np.float32)
    silence = np.zeros((2, 5, WINDOW), np.float32)
    found, _ = analysis(
        FrameMeasures.of_windows(silence), network, 0 * network, rest, analysis.first(2)
    )
    np.testing.assert_array_equal(found.intensity, network)


def test_means_of_the_opening_move_a_thirtieth_a_frame_of_speech_and_not_in_silence():
    speaking = np.array([[False, True, False, True]])
    rows, before = np.full((1, 4, 2), (0.9, 0.3)), np.full((1, 2), 0.6)
    found, after = follow_means(rows, speaking, before)
    once, twice = 0.3 / 30, 0.3 / 30 + (0.3 - 0.3 / 30) / 30
    np.testing.assert_allclose(found[0, :, 0] - 0.6, [0, once, once, twice], rtol=1e-9)
    np.testing.assert_allclose(0.6 - found[0, :, 1], [0, once, once, twice], rtol=1e-9)
    later, _ = follow_means(rows[:, :1], np.zeros((1, 1), bool), after)
    np.testing.assert_array_equal(later[0], after)


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_streams_side_by_side_are_heard_as_each_alone_in_any_pieces(grid, rng):
    """Voices of several levels that began at different times, over the measures of the floor."""
    analysis, n_frames = VoiceAnalysis(RulesConfig(), grid), 64
    sound = 0.1 * rng.standard_normal((3, n_frames, WINDOW)) * (rng.random((3, n_frames, 1)) < 0.6)
    sound = (sound * np.array([1.0, 0.1, 3.0])[:, None, None]).astype(np.float32)
    network, effort = rng.random((2, 3, n_frames)).astype(np.float32)
    rest = np.array([0, 0.3, 1], np.float32)
    state = list(analysis.first(3))
    put(state, [1], analysis.begin(0.1 + sound[1:2, : grid.delay], analysis.first(1)))
    first, together, at = tuple(state), [], 0
    for size in (1, 7, 30, 2, 24):
        rows = slice(at, at + size)
        found, state = analysis(
            FrameMeasures.of_windows(sound[:, rows]), network[:, rows], effort[:, rows], rest, state
        )
        together.append(np.stack((*found[1:-1], *found.held), axis=-1))
        at += size
    for k in range(3):
        windows, *own = (part[k : k + 1] for part in (sound, network, effort, rest))
        alone, _ = analysis(FrameMeasures.of_windows(windows), *own, take(first, [k]))
        expected = np.stack((*alone[1:-1], *alone.held), axis=-1)[0]
        np.testing.assert_allclose(np.concatenate(together, axis=1)[k], expected, atol=1e-6)


def test_windows_are_measured_alike_on_a_device() -> None:
    """Another name of the processor takes the way of a GPU: tensors measure, arrays come back."""
    sound = np.random.default_rng(3).standard_normal((2, 5, WINDOW)).astype(np.float32)
    here, there = (FrameMeasures.of_windows(sound, device) for device in ("cpu", "cpu:0"))
    for ours, theirs in zip(here, there, strict=True):
        np.testing.assert_allclose(theirs, ours, atol=2e-4)
