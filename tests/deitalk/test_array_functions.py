"""Functions of arrays and tensors: each gives the same of both, and what its docstring says."""

import numpy as np
import pytest
import torch

from deitalk import array_functions as xp
from deitalk.audio.held_sound import HeldState, first_held, follow_held, held_sound
from deitalk.audio.prosody import Prosody, measure_prosody
from deitalk.audio.running_level import first_level, levelled
from deitalk.audio.vocal_strength import strength_frames, vocal_strength
from deitalk.audio.voice_activity import active_frames, band_levels
from deitalk.config.rules import Gates, HoldPose, RulesConfig, ScaleOpening
from deitalk.live.analysis import FrameMeasures, VoiceAnalysis
from deitalk.models.protocol import SpectraGrid
from deitalk.pipeline.speech import phrase_strengths
from deitalk.postprocess.factors import mean_around, opening_factor
from deitalk.postprocess.feeling import voice_intensity
from deitalk.postprocess.gates import gates_of
from tests.deitalk.audio.test_prosody import voice

RNG = np.random.default_rng(0)
TRACK, ROWS = RNG.normal(0, 10, 70), RNG.normal(0, 10, (2, 70))
FLAGS = np.repeat(RNG.random(14) < 0.5, 5)
PLACES = np.arange(70.0)
WEIGHT, BIAS = RNG.normal(size=(4, 3, 5)), RNG.normal(size=4)
SOUND = np.concatenate((np.zeros(16_000), voice(seconds=2), 0.3 * voice(seconds=1))).astype("f4")
LEVELS, PROSODY = band_levels(SOUND), measure_prosody(SOUND, 120)
STEADY = np.repeat(RNG.uniform(-40, -20, (4, 14)), 30, axis=0)
SPEAKING = active_frames(LEVELS, PROSODY.tone, len(SOUND))
NETWORK = RNG.random(120)


def held_in_pieces(levels, tones):
    """Held sounds of a stream that comes in calls of seven frames."""
    state, parts = [xp.like(part, levels) for part in first_held(1, 14)], []
    for at in range(0, 120, 7):
        rows = slice(at, at + 7)
        found, state = follow_held(
            levels[None, rows], tones[None, rows], HoldPose(), HeldState(*state)
        )
        parts.append(xp.join([xp.single(part) for part in found[:2]], 1))
    return parts


def analysed(levels, prosody, network):
    """Analysis of a stream that comes in calls of seven frames."""
    analysis, parts = VoiceAnalysis(RulesConfig(), SpectraGrid(3, 400, 3)), []
    state = tuple(xp.like(part, levels) for part in analysis.first(1))
    measured = FrameMeasures.of_rows(levels, prosody, 120)
    for at in range(0, 120, 7):
        rows = slice(at, at + 7)
        call = FrameMeasures(*(part[:, rows] for part in measured))
        found, state = analysis(
            call, network[None, rows], 9 * network[None, rows], network[:1], state
        )
        parts.append(found[1:-1])
    return parts


def levelled_in_pieces(windows, first):
    """Sound of two streams at the usual level, which comes in calls of seven frames."""
    state, parts = first, []
    for at in range(0, windows.shape[1], 21):
        found, state = levelled(windows[:, at : at + 21], 3, state)
        parts.append(found)
    return [*parts, state]


CASES = {
    "levelled": (
        levelled_in_pieces, 0.1 * RNG.normal(size=(2, 90, 40)).astype("f4"), first_level(2)
    ),
    "percentile": (lambda x, f: xp.percentile(x, 30, f), TRACK, FLAGS),
    "percentile of rows": (lambda x, f: xp.percentile(x, 95, f, 1), ROWS, ROWS > -5),
    "median": (xp.median, TRACK),
    "mean_of": (xp.mean_of, TRACK, FLAGS),
    "neighbours": (xp.neighbours, FLAGS),
    "running_maximum": (xp.running_maximum, ROWS),
    "last_value": (xp.last_value, ROWS > 12, PLACES, np.array([-3.0, -5.0])),
    "last_value of one": (xp.last_value, FLAGS[None], PLACES, np.array([-3.0])),
    "between": (xp.between, TRACK, FLAGS),
    "padded": (lambda x: xp.padded(x, 2, 3, -1), ROWS),
    "smoothed": (lambda x: xp.smoothed(x, 6.0), TRACK),
    "filtered": (lambda x: xp.filtered(x, np.array([1.0, 2.0, 1.0])), ROWS.T),
    "convolved": (lambda x, w, b: xp.convolved(x, w, b, 2), RNG.normal(size=(70, 3)), WEIGHT, BIAS),
    "gelu": (xp.gelu, TRACK / 5),
    "replaced": (
        lambda f, a, b: xp.replaced(f, (a, b), lambda x: (x[:, 0], 2 * x), b),
        FLAGS, TRACK, np.stack((TRACK, TRACK + 1), axis=1),
    ),
    "held sounds": (lambda x, t: held_sound(x, t, HoldPose()), STEADY, np.ones(120)),
    "held sounds in pieces": (held_in_pieces, STEADY, np.ones(120)),
    "speech": (lambda x, t: active_frames(x, t, len(SOUND)), LEVELS, PROSODY.tone),
    "gates": (lambda f, r: gates_of(f, r, Gates()), SPEAKING, NETWORK),
    "strength": (
        lambda f, *p: phrase_strengths(
            *vocal_strength().follow(strength_frames(Prosody(*p), f)), f, 4 * p[4]
        ),
        SPEAKING, *PROSODY,
    ),
    "intensity": (lambda f, n, *p: voice_intensity(n, Prosody(*p), f, 2 * n), SPEAKING, NETWORK, *PROSODY),
    "opening": (
        lambda n, f: opening_factor(ScaleOpening(), mean_around(n, f), mean_around(n * n, f)),
        NETWORK, SPEAKING,
    ),
    "analysis": (lambda x, n, *p: analysed(x, Prosody(*p), n), LEVELS, NETWORK, *PROSODY),
}  # fmt: skip


def flat(found):
    """All arrays of what a function gives, as numbers."""
    if isinstance(found, tuple | list):
        return [array for part in found for array in flat(part)]
    return [np.asarray(found, np.float64)]


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_arrays_and_tensors_give_the_same(case):
    function, *given = case
    tensors = [torch.from_numpy(np.asarray(part)) for part in given]
    tensors = [part.float() if part.is_floating_point() else part for part in tensors]
    expected, found = flat(function(*given)), flat(function(*tensors))
    assert any(array.any() for array in expected)
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-5, atol=1e-4)


def test_percentile_is_that_of_the_values_that_are_used():
    for percent in (0, 10, 50, 98, 100):
        found = xp.percentile(TRACK, percent, FLAGS)
        assert found == pytest.approx(np.percentile(TRACK[FLAGS], percent))


def test_median_is_that_of_numpy():
    for rows in (ROWS, ROWS[:, :1], ROWS[:, :-1]):
        np.testing.assert_allclose(xp.median(rows, 1), np.median(rows, axis=1), rtol=1e-12)


def test_neighbours_and_lines_between_are_those_of_a_search():
    last, following = xp.neighbours(FLAGS)
    places = np.flatnonzero(FLAGS)
    for frame in range(70):
        before, after = places[places <= frame], places[places >= frame]
        assert last[frame] == (before.max() if len(before) else -xp.FAR)
        assert following[frame] == (after.min() if len(after) else xp.FAR)
    expected = np.interp(np.arange(70), places, TRACK[FLAGS])
    np.testing.assert_allclose(xp.between(TRACK, FLAGS), expected)


def test_convolution_of_long_arrays_is_that_of_pieces(monkeypatch):
    rows = RNG.normal(size=(70, 3))
    whole = xp.convolved(rows, WEIGHT, BIAS, 4)
    monkeypatch.setattr(xp, "ROWS_AT_ONCE", 11)
    np.testing.assert_allclose(xp.convolved(rows, WEIGHT, BIAS, 4), whole)
