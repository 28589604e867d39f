"""The readout of a voice's strength on planted laws."""

from pathlib import Path

import numpy as np

from deitalk.research.evaluation.strength_clips import ACTORS, LEVELS, READERS, StrengthClip
from deitalk.research.training.effort import STEP_DB, Heard, fit

D = 12
VOICE, ROOM = np.eye(D)[0], np.eye(D)[1]
"""Directions of the strength, and of microphone and noise."""


def heard():
    """Takes whose features are strength, room and the actor's own; noise moves the room alone."""
    rng, found = np.random.default_rng(0), []
    for actor in range(20):
        own = rng.normal(0, 3, D)
        for strength, level in enumerate(LEVELS):
            room = rng.normal(0, 2) + strength  # strong takes come from nearer
            mean = own + strength * VOICE + room * ROOM
            clip = StrengthClip(ACTORS, Path("x"), str(actor), str(actor), "ANG", level)
            found.append(Heard(clip, 100 * mean, 100 * (mean + rng.normal(0, 5) * ROOM)))
    for reader in range(6):
        own = rng.normal(0, 3, D)
        pieces = [(100 * (own + k * VOICE), k * STEP_DB / 2) for k in range(5)]
        clip = StrengthClip(READERS, Path("x"), str(reader), str(reader))
        found.append(Heard(clip, 100 * own, pieces=pieces))
    return found


def test_readout_is_the_planted_direction_and_not_the_room():
    """A step of one of three strengths is half of `STEP_DB`."""
    clips = heard()
    weights, offset = fit(clips, ridge=0.01)
    np.testing.assert_allclose(100 * VOICE @ weights, STEP_DB / 2, rtol=0.15)
    assert abs(100 * ROOM @ weights) < 0.05 * STEP_DB
    readers = [one.mean @ weights + offset for one in clips if one.clip.kind == READERS]
    assert abs(np.mean(readers)) < 1e-6, "0 dB is the mean reader where there is no neutral take"
