"""People of the embedded heads: names, roles, and what sets a child apart."""

import numpy as np
import pytest

from deitalk.research.poses import pose_values
from rig.errors import RigError
from rig.face import IDENTITIES, build_head
from rig.face.identity import ROLES, resolve_identity


@pytest.mark.parametrize("role", ROLES)
def test_role_is_one_of_the_people(role):
    person = resolve_identity(role)
    assert person in IDENTITIES
    assert person == resolve_identity(person.name.upper())


@pytest.mark.parametrize("unknown", ["-1", -1, 12, "adult", ""])
def test_unknown_identity_is_an_error_that_names_the_roles(unknown):
    with pytest.raises(RigError, match="female, male, child"):
        resolve_identity(unknown)


def test_child_has_larger_eyes_in_a_shorter_face_than_adults():
    def face(name):
        head = build_head(name)
        eye, mouth = head.eyes[0], head.skin.vertices[head.landmarks["upper_rim"]]
        return eye[3] / (eye[1] - mouth[1])

    assert all(face("child") > 1.05 * face(person.name) for person in IDENTITIES[:3])


@pytest.mark.parametrize("person", IDENTITIES, ids=lambda person: person.name)
def test_people_have_the_same_triangles_of_skin_and_open_their_mouths_on_teeth(person):
    head, other = build_head(person), build_head(0)
    assert np.array_equal(head.skin.faces, other.skin.faces)
    assert head.landmarks == other.landmarks
    pose = head.pose(pose_values({"CTRL_C_jaw.ty": 0.6}))
    assert head.lip_gaps(pose[None]).max() > 1
    rim = pose[head.motion.lips[0].rim]
    high = rim[np.abs(rim[:, 0]) < 0.3, 1].mean()
    teeth = pose[head.slices["teeth_upper"]]
    assert teeth[np.abs(teeth[:, 0]) < 0.4, 1].min() < high  # upper teeth in sight
