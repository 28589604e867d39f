"""What poses move is what `Head.pose` moves."""

import numpy as np
import pytest

from rig.controls import default_controls
from rig.face import IDENTITIES, build_head
from rig.face.moves import moves
from rig.retarget.bake import control_halves, face_correctives


@pytest.mark.parametrize("identity", IDENTITIES, ids=lambda person: person.name)
def test_moved_vertices_are_those_of_the_pose_and_the_others_stay(identity):
    head, board = build_head(identity), default_controls()
    halves = control_halves(board)[:: 1 if identity.name == "Ada" else 5]
    drivers = [driver for _, driver in [*halves, *face_correctives()]]
    poses = np.stack([driver.pose(board) for driver in drivers]).astype(np.float64)
    found = moves(head, poses)
    assert np.mean([len(ids) for ids, _ in found]) < 0.2 * len(head.neutral)
    for start in range(0, len(poses), 16):
        posed = head.pose(poses[start : start + 16])
        for pose, (ids, delta) in zip(posed, found[start : start + 16], strict=True):
            assert (np.diff(ids) > 0).all()
            shown = head.neutral.copy()
            shown[ids] += delta
            assert np.abs(shown - pose).max() < 1e-5  # cm
