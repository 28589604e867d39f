"""The upper face by emotion: which parts of the brows rise, and lids and shadow about the eyes."""

import numpy as np
import pytest

from deitalk.research.poses import EMOTION_POSES, pose_values
from rig.face import IDENTITIES, build_head
from rig.face.accents import accents

PEOPLE = [identity.name for identity in IDENTITIES]


def risen(person, pose):
    """How far the inner, middle and outer third of the left brow rise, cm."""
    head = build_head(person)
    brow = head.slices["brow_L"]
    moved = head.pose(pose_values(pose)) - head.neutral
    edges = np.quantile(head.neutral[brow, 0], [0, 1 / 3, 2 / 3, 1])
    third = np.searchsorted(edges[1:-1], head.neutral[brow, 0])
    return [moved[brow, 1][third == k].mean() for k in range(3)]


@pytest.mark.parametrize("person", PEOPLE)
def test_sadness_raises_the_inner_ends_of_brows_alone(person):
    inner, middle, outer = risen(person, EMOTION_POSES["sad"])
    assert inner > 0.25 and inner > middle > outer and abs(outer) < 0.15


@pytest.mark.parametrize("person", PEOPLE)
def test_surprise_raises_whole_brows_as_an_arch(person):
    inner, middle, outer = risen(person, EMOTION_POSES["surprised"])
    assert min(inner, middle, outer) > 0.3
    assert middle > inner - 0.12 and middle > outer


@pytest.mark.parametrize("person", PEOPLE)
def test_brows_of_surprise_never_slant_like_anger(person):
    """Their outer part stands no higher than the inner end; Chidi's stood 3 mm higher."""
    head = build_head(person)
    brow = head.slices["brow_L"]
    x, y = head.pose(pose_values(EMOTION_POSES["surprised"]))[brow, :2].T
    edges = x.min() + np.ptp(x) * np.arange(7) / 6
    inner, outer = (y[(x >= edges[k]) & (x <= edges[k + 1])].mean() for k in (0, 4))
    assert outer < inner + 0.1


@pytest.mark.parametrize("person", PEOPLE)
def test_frowning_brows_come_together(person):
    """Corrugator draws their inner ends towards the middle, by more than a millimetre each."""
    head = build_head(person)
    brow = head.slices["brow_L"]
    inner = head.neutral[brow, 0] < np.quantile(head.neutral[brow, 0], 1 / 6)
    moved = head.pose(pose_values({"*brow_lateral.ty": 1})) - head.neutral
    assert moved[brow, 0][inner].mean() < -0.13


@pytest.mark.parametrize("person", PEOPLE)
def test_upper_lids_go_down_with_the_look(person):
    """By nearly half of the way of the pupil."""
    head = build_head(person)
    pose = head.pose(pose_values({"CTRL_C_eye.ty": -0.6}))
    lid, pupil = head.landmarks["eye_upper_left"], head.slices["eye_L"].start
    way = (pose - head.neutral)[[lid, pupil], 1]
    assert way[1] < -0.3 and way[0] < 0.45 * way[1]


@pytest.mark.parametrize("person", PEOPLE)
def test_eyes_are_darker_in_their_corners(person):
    head, values = build_head(person), pose_values({})[None]
    pose = head.pose(values)
    eye = head.slices["eye_L"]
    shadow, ball = accents(head, values, pose)[0, eye], pose[0, eye] - head.eyes[0, :3]
    front = (ball[:, 2] > 0) & (np.abs(ball[:, 1]) < 0.25)
    aside = np.abs(ball[:, 0]) / head.eyes[0, 3]
    means = [shadow[front & (aside > a) & (aside <= b)].mean() for a, b in
             ((0, 0.35), (0.35, 0.6), (0.6, 0.9))]  # fmt: skip
    assert means == sorted(means) and means[2] > means[0] + 0.15
