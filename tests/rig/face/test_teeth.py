"""Teeth: enamel below gums, the upper row in front of the lower one, and rows that move in one piece."""

import numpy as np
import pytest

from deitalk.research.poses import pose_values
from rig.face import IDENTITIES, build_head

PEOPLE = [identity.name for identity in IDENTITIES]
X, Y, Z = 0, 1, 2


def incisors(head, row):
    """Vertices of the front of a row's incisors."""
    part = head.slices[f"teeth_{row}"]
    points = head.neutral[part]
    is_front = (np.abs(points[:, X]) < 0.5) & (points[:, Z] > points[:, Z].max() - 0.35)
    return part.start + np.flatnonzero(is_front)


@pytest.mark.parametrize("person", PEOPLE)
@pytest.mark.parametrize(("row", "up"), [("upper", 1), ("lower", -1)])
def test_crowns_are_enamel_and_roots_are_gum(person, row, up):
    head = build_head(person)
    ids = incisors(head, row)
    atlas, place = head.mesh.maps.atlas, head.mesh.uv[ids]
    colour = atlas[tuple((place * len(atlas)).astype(int).T[::-1])][:, :3].astype(float)
    far = up * head.neutral[ids, Y]
    far -= far.min()  # from the edge to the root
    enamel, gum = (colour[k].mean(0) for k in ((far > 0.2) & (far < 0.6), far > 1.15))
    assert gum[0] - gum[1] > 1.4 * (enamel[0] - enamel[1])  # redder
    assert enamel.mean() > 1.1 * gum.mean()


@pytest.mark.parametrize("person", PEOPLE)
def test_upper_incisors_bite_before_the_lower_ones(person):
    head = build_head(person)
    upper, lower = (head.neutral[incisors(head, row)] for row in ("upper", "lower"))
    assert 0.05 < upper[:, Z].max() - lower[:, Z].max() < 0.5
    assert upper[:, Y].min() < lower[:, Y].max()  # overbite


@pytest.mark.parametrize("person", PEOPLE)
def test_the_jaw_moves_the_lower_row_alone_and_in_one_piece(person):
    head = build_head(person)
    pose = head.pose(pose_values({"CTRL_C_jaw.ty": 0.5}))
    upper, lower = (head.slices[f"teeth_{row}"] for row in ("upper", "lower"))
    assert np.array_equal(pose[upper], head.neutral[upper].astype(np.float32))
    ends = head.mesh.faces[:, :2]
    a, b = ends[((ends >= lower.start) & (ends < lower.stop)).all(1)].T
    before, after = (np.linalg.norm(x[a] - x[b], axis=1) for x in (head.neutral, pose))
    long = before > 0.1
    assert np.abs(after[long] / before[long] - 1).max() < 0.2  # a turn is a sum of shifts
    assert (pose[lower] - head.neutral[lower])[:, Y].mean() < -1
