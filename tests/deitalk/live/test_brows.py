"""Brows of a voice that has not ended: accents by hand, pieces, what an emotion moves."""

import numpy as np
import pytest

from deitalk.config import Idle
from deitalk.emotions import EMOTIONS
from deitalk.live.brows import RunningAccents, RunningBrows
from deitalk.live.intensity import Measures
from deitalk.postprocess.life.brows import STEMS
from rig import default_controls

CONTROLS = default_controls()
AHEAD = 2


def voice(frames=240, every=60):
    """A level voice, 9 dB stronger for 0.2 s every two seconds."""
    level = np.full(frames, -20.0)
    for peak in range(every, frames, every):
        level[peak - 3 : peak + 4] += 9 * np.hanning(9)[1:-1]
    zeros = np.zeros(frames)
    return Measures(level, zeros, np.full(frames, 40.0), np.ones(frames)), np.ones(frames, bool)


def moved(*, piece=1000, emotion="neutral", idle=Idle(), spoken=True, seed=0):
    measures, speaking = voice()
    brows = RunningBrows(CONTROLS, idle, seed, AHEAD)
    count, done, out = len(speaking), 0, []
    mixture = np.zeros((count, len(EMOTIONS)), np.float32)
    mixture[:, EMOTIONS.index(emotion)] = 1
    for start in range(0, count, piece):
        part = slice(start, start + piece)
        brows.feed(Measures(*(m[part] for m in measures)), speaking[part] & spoken)
        new = max(min(start + piece, count) - AHEAD - done, 0)
        curves = np.zeros((new, len(CONTROLS.names)), np.float32)
        brows.add_to(curves, np.zeros_like(curves), mixture[done : done + new])
        out.append(curves)
        done += new
    return np.concatenate(out)


def column(curves, stem):
    return curves[:, CONTROLS.index(f"CTRL_L_{stem}.ty")]


def test_accents_are_peaks_and_known_soon_after():
    measures, _ = voice()
    accents = RunningAccents()
    rows = zip(measures.level, measures.pitch, measures.periodicity, strict=True)
    found = [accents.next(*row, True) for row in rows]
    at = np.flatnonzero(found)
    assert len(at) == 3 and all(1 <= frame % 60 <= 4 for frame in at)
    assert all(0 < found[frame] <= 1 for frame in at)


@pytest.mark.parametrize("level", [-20.0, -60.0])
def test_level_voice_and_silence_have_no_accent(level):
    accents = RunningAccents()
    assert not any(accents.next(level, 40.0, 1.0, level > -40) for _ in range(200))


def test_pieces_give_the_same_motion():
    whole = moved()
    np.testing.assert_array_equal(moved(piece=1), whole)
    np.testing.assert_array_equal(moved(piece=7), whole)
    assert np.abs(moved(seed=1) - whole).max() > 0.01


def test_motion_before_an_accent_does_not_depend_on_it():
    """The first accent is at frame 60, and known at 61: frames to 58 are without it."""
    accented, calm = moved(), moved(spoken=False)
    np.testing.assert_array_equal(accented[:58], calm[:58])
    assert column(accented, "brow_raiseIn")[60:100].max() > 0.03
    assert column(calm, "brow_raiseIn").max() < 0.06


def test_emotion_decides_what_moves():
    sizes = {e: {s: column(moved(emotion=e), s).max() for s in STEMS} for e in EMOTIONS}
    assert sizes["angry"]["brow_down"] > sizes["neutral"]["brow_down"] + 0.05
    assert sizes["happy"]["eye_cheekRaise"] > sizes["neutral"]["eye_cheekRaise"] + 0.05
    assert sizes["surprised"]["brow_raiseOut"] > sizes["neutral"]["brow_raiseOut"] + 0.02
    assert not moved(idle=Idle(brows=0)).any()
    still = [i for i, n in enumerate(CONTROLS.names) if not any(s in n for s in STEMS)]
    assert not moved()[:, still].any()
