"""People of the embedded head: names, roles, and what sets a child apart."""

import os

import numpy as np
import pytest

from deitalk.research.contact_sheet import pose_values
from rig.errors import RigError
from rig.face import IDENTITIES, build_head
from rig.face.geometry.topology import anatomy
from rig.face.head import MOST_KEPT, load_or_build
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


def test_cache_keeps_the_newest_heads_and_no_others_files(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "deitalk"
    folder.mkdir()
    for age in range(MOST_KEPT + 2):
        old = folder / f"head-{age:02}.npz"
        old.write_bytes(b"")
        os.utime(old, (1e9 - age, 1e9 - age))
    (folder / "morphs-0.npz").write_bytes(b"")
    made = {"a": np.arange(3)}
    assert load_or_build("head", IDENTITIES[0], lambda identity: made) is made
    again = load_or_build("head", IDENTITIES[0], lambda identity: pytest.fail("built again"))
    np.testing.assert_array_equal(again["a"], made["a"])
    names = {path.name for path in folder.iterdir()}
    assert len(names) == MOST_KEPT + 1 and "morphs-0.npz" in names
    gone = {f"head-{age:02}.npz" for age in range(MOST_KEPT - 1, MOST_KEPT + 2)}
    assert not gone & names
