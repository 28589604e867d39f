"""VRMA: what is written is read back; three-vrm reads it in test_independent_readers.py."""

import numpy as np
import pytest

from rig import RigCurves, default_controls, read_curves, write_curves
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import convert
from rig.errors import FormatError
from rig.mesh.glb import read_container, write_container
from tests.errors import one_line

BOARD = default_controls()


@pytest.fixture
def take(rng):
    values = rng.uniform(BOARD.minimum, BOARD.maximum, (6, 185)).astype(np.float32)
    head = rng.uniform(-20, 20, (6, 6)).astype(np.float32)
    return RigCurves(values, BOARD.names, 25, head=head)


def test_arkits_shapes_and_the_turn_come_back(tmp_path, take):
    report = write_curves(tmp_path / "a.vrma", take)
    assert "ARKit is a lossy preview" in report.note and "vrm1: the shapes show" in report.note
    back = read_curves(tmp_path / "a.vrma", control_set=None)
    assert back.control_set == ARKIT_ID and back.fps == pytest.approx(25)
    expected = convert(take, ARKIT_ID).reorder(arkit_controls()).values[:, :52]
    np.testing.assert_allclose(back.values[:, :52], expected, atol=1e-6)
    np.testing.assert_allclose(back.head[:, :3], take.head[:, :3], atol=1e-4)


def test_the_extension_names_bones_expressions_and_gaze(tmp_path, take):
    write_curves(tmp_path / "a.vrma", take)
    document, _ = read_container(tmp_path / "a.vrma")
    own = document["extensions"]["VRMC_vrm_animation"]
    assert own["specVersion"] == "1.0" and "lookUp" not in own["expressions"]["preset"]
    moved = {
        c["target"]["node"]: c["target"]["path"] for c in document["animations"][0]["channels"]
    }
    for kind in ("preset", "custom"):
        for name, found in own["expressions"][kind].items():
            assert document["nodes"][found["node"]]["name"] == name
            assert moved[found["node"]] == "translation"
    assert moved[own["lookAt"]["node"]] == "rotation"
    assert moved[own["humanoid"]["humanBones"]["head"]["node"]] == "rotation"


@pytest.mark.parametrize("part", ["extensions", "animations"])
def test_other_files_are_refused_in_one_line(tmp_path, take, part):
    write_curves(tmp_path / "a.vrma", take)
    document, binary = read_container(tmp_path / "a.vrma")
    del document[part]
    write_container(tmp_path / "a.vrma", document, binary)
    with one_line(FormatError, match="no VRMC_vrm_animation"):
        read_curves(tmp_path / "a.vrma")


def empty_parts(node, path=""):
    """Places of lists and objects without a member, which Khronos' validator calls errors."""
    if isinstance(node, dict | list):
        if not node:
            yield path
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from empty_parts(value, f"{path}/{key}")


@pytest.mark.parametrize("name", ["a.vrma", "a.glb"])
def test_no_list_or_object_is_empty(tmp_path, take, name):
    write_curves(tmp_path / name, take)
    assert list(empty_parts(read_container(tmp_path / name)[0])) == []
