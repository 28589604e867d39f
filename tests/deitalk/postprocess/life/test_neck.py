"""Neck of a face whose head moves: breath, swallowing, the turning muscles."""

import numpy as np
import pytest

from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.character import Seeds
from deitalk.postprocess.life.motion import plan_motion
from deitalk.postprocess.life.neck import neck_tracks
from deitalk.postprocess.life.voice import Phrase, Voice

N_FRAMES = 900
BREATH, SWALLOW, TURNS = 0, 1, (2, 3)
"""Columns of the neck."""
PHRASES = tuple(Phrase(start, start + 75, False) for start in range(60, 800, 90))
VOICE = Voice(N_FRAMES, np.zeros(N_FRAMES, np.float32), (), PHRASES)


def necks(voice, count=200):
    calm, only_head = np.zeros((voice.n_frames, 9), np.float32), Life(blinks=0, gaze=0, brows=0)
    seeds = (Seeds((1, 2, seed)) for seed in range(count))
    return [plan_motion(voice, calm, one, life=only_head).tracks.neck for one in seeds]


def test_breath_is_drawn_before_phrases_and_is_over_within_them():
    breath = necks(VOICE, 1)[0][:, BREATH]
    for phrase in PHRASES[1:]:
        assert breath[phrase.start - 6 : phrase.start].max() > 0.3
        assert breath[phrase.start + 12 : phrase.stop - 20].max() < 0.02


def test_people_swallow_once_a_minute_and_never_while_they_speak():
    """Ten minutes of a phrase of 4 s and a pause of 2 s."""
    phrases = tuple(Phrase(start, start + 120, False) for start in range(60, 18_000, 180))
    voice = Voice(18_060, np.zeros(18_060, np.float32), (), phrases)
    counts, speaking = [], voice.speaking > 0
    for tracks in necks(voice, 5):
        above = tracks[:, SWALLOW] > 0.5
        counts.append(int((above[1:] & ~above[:-1]).sum()))
        assert not above[speaking].any()
    assert 7 <= np.mean(counts) <= 13
    short = Voice(
        900,
        np.zeros(900, np.float32),
        (),
        tuple(Phrase(s, s + 60, False) for s in range(20, 860, 80)),
    )
    assert all(tracks[:, SWALLOW].max() == 0 for tracks in necks(short, 10)), "pauses of 0.7 s"


@pytest.mark.parametrize(("yaw", "contracts"), [(22.0, 0), (-22.0, 1)])
def test_the_muscle_of_the_other_side_turns_the_head(yaw, contracts):
    none = np.zeros(2)
    tracks = neck_tracks(none, none, np.array([yaw, yaw]))
    assert tracks[:, TURNS[contracts]] == pytest.approx(0.5)
    assert tracks[:, TURNS[1 - contracts]].max() == 0
    assert not any(neck_tracks(none, none, np.array([1.9, -1.9]))[:, side].any() for side in TURNS)
