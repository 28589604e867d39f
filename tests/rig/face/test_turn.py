"""Turn of the head: hand-worked axes and signs."""

import numpy as np
import pytest

from rig.face import build_head
from rig.face.head_pose import JOINT, matrices, neck_share, quaternions, turned

LEFT, UP, FORWARD = np.eye(3)


@pytest.mark.parametrize(
    ("turn", "before", "after"),
    [
        ([90, 0, 0], FORWARD, -LEFT),  # yaw to the character's right
        ([0, 90, 0], FORWARD, UP),  # pitch up
        ([0, 0, 90], UP, -LEFT),  # roll to the right shoulder
        ([90, 90, 0], FORWARD, UP),  # pitch before yaw
        ([90, 0, 90], UP, -FORWARD),  # roll, UP to -LEFT, before yaw, -LEFT to the rear
    ],
)
def test_turns_have_their_signs(turn, before, after):
    rotation, _ = matrices([[*turn, 0, 0, 0]])
    np.testing.assert_allclose(rotation[0] @ before, after, atol=1e-12)


def test_joint_stays_and_shift_is_added():
    rotation, translation = matrices([[20, -10, 5, 1, 2, 3]])
    np.testing.assert_allclose(
        rotation[0] @ JOINT + translation[0], JOINT + np.array([1, 2, 3]), atol=1e-12
    )


def test_quaternion_of_a_yaw():
    half = np.sqrt(0.5)
    np.testing.assert_allclose(quaternions([[90, 0, 0]]), [[0, -half, 0, half]], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(quaternions([[30, -50, 70]])), 1)


def test_face_turns_whole_and_the_end_of_the_neck_stays():
    head = build_head(0)
    vertices = head.mesh.vertices
    share = neck_share(vertices)
    track = [[20.0, -10.0, 5.0, 0.0, 0.0, 0.0]]
    rotation, translation = matrices(track)
    moved = turned(vertices[None], track, share)[0]
    rigid = vertices @ rotation[0].T + translation[0]
    face = vertices[:, 2] > 7
    np.testing.assert_allclose(
        moved[face & (vertices[:, 1] > -10)], rigid[face & (vertices[:, 1] > -10)], atol=0.02
    )
    low = vertices[:, 1] < -15
    np.testing.assert_allclose(moved[low], vertices[low], atol=0.12)
    np.testing.assert_array_equal(turned(vertices[None], np.zeros((1, 6)), share)[0], vertices)
