"""People of the embedded head: names, roles, and what sets a child apart."""

import numpy as np
import pytest

from deitalk.research.contact_sheet import pose_values
from rig.errors import RigError
from rig.face import IDENTITIES, build_head
from rig.face.geometry.topology import anatomy
from rig.face.identity import ROLES, resolve_identity
from tests.each import each


@each("role", ROLES)
def test_role_is_one_of_the_people(role):
    person = resolve_identity(role)
    assert person in IDENTITIES
    assert person == resolve_identity(person.name.upper())


@each("unknown", ["-1", -1, 12, "adult", ""])
def test_unknown_identity_is_an_error_that_names_the_roles(unknown):
    with pytest.raises(RigError, match="female, male, child"):
        resolve_identity(unknown)


def test_child_has_larger_eyes_a_shorter_face_and_a_thinner_neck_than_adults():
    child = resolve_identity("child")
    for adult in IDENTITIES[:10]:
        assert anatomy(child).eye_radius > anatomy(adult).eye_radius
        assert anatomy(child).mouth_y > anatomy(adult).mouth_y + 0.5
        assert child.neck_width < adult.neck_width


def test_child_has_the_triangles_of_the_adults_and_opens_its_mouth_on_teeth():
    child, adult = build_head("child"), build_head(0)
    assert np.array_equal(child.skin.faces, adult.skin.faces)
    pose = child.pose(pose_values({"CTRL_C_jaw.ty": 0.6}))
    high, low = pose[list(child._rim_middle), 1]
    assert high - low > 1
    teeth = pose[child.slices["teeth_upper"]]
    assert teeth[np.abs(teeth[:, 0]) < 0.4, 1].min() < high  # upper teeth in sight
