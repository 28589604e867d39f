"""Defects of users' meshes: handled, or rejected in one line without output.

Quads, unused vertices, several components, mirrored normals, wrong units, mismatched
counts, missing shapes, compressed GLB.
"""

import json

import numpy as np
import pytest

from rig import RigCurves, default_controls
from rig.errors import RigError
from rig.mesh import ShapeSet, TriMesh
from rig.mesh.glb import write_glb
from rig.mesh.trimesh import components
from rig.retarget.retarget_files import read_shapes, retarget_curves
from tests.errors import one_line
from tests.meshes import write_obj, write_obj_folder

CONTROLS = default_controls()
MESH = TriMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])


def jaw_open():
    values = np.tile(CONTROLS.rest, (2, 1))
    values[1, CONTROLS.index("CTRL_C_jaw.ty")] = 1
    return RigCurves(values, CONTROLS.names)


def shapes(*names):
    rng = np.random.default_rng(0)
    return ShapeSet(MESH, names, rng.normal(size=(len(names), 4, 3)))


def as_polygons(mesh):
    """Faces with neighbours joined to quads wherever two triangles are free to."""
    free, by_edge, polygons = set(range(len(mesh.faces))), {}, []
    for t, face in enumerate(mesh.faces.tolist()):
        for i in range(3):
            by_edge[face[i], face[(i + 1) % 3]] = (t, face[(i + 2) % 3])
    for t, (a, b, c) in enumerate(mesh.faces.tolist()):
        other = by_edge.get((b, a))
        if t in free and other and other[0] in free:
            polygons.append((a, other[1], b, c))
            free -= {t, other[0]}
    return polygons + [tuple(mesh.faces[t]) for t in sorted(free)]


@pytest.mark.slow
def test_mesh_with_many_defects_is_retargeted(tmp_path):
    """Quads, unused vertices, loose eyes, metres, and normals inside out, all in one OBJ."""
    from rig.retarget.head_source import source_head

    source = source_head()
    head = source.mesh.flipped()
    polygons = as_polygons(head)
    assert sum(len(p) == 4 for p in polygons) > 0.4 * len(polygons)
    assert components(head).max() >= 5  # eyes, teeth, tongue
    lines = ["v 9 9 9"]  # two vertices that no face uses: one before all others, one after
    lines += ["v {:.7f} {:.7f} {:.7f}".format(*(0.01 * v)) for v in head.vertices]
    lines += ["v 8 8 8", *("f " + " ".join(str(v + 2) for v in p) for p in polygons)]
    (tmp_path / "mess.obj").write_text("\n".join(lines) + "\n")
    marks = {name: vertex + 1 for name, vertex in source.landmarks.items()}
    (tmp_path / "marks.json").write_text(json.dumps(marks))
    report = retarget_curves(
        jaw_open(), tmp_path / "mess.obj", tmp_path / "out.npz", landmarks=tmp_path / "marks.json"
    )
    words = " ".join(report.notes)
    assert "normals point inward" in words and "0.01 x the size of a head in centimetres" in words
    with np.load(tmp_path / "out.npz") as file:
        moved = 100 * (file["vertices"][1] - file["vertices"][0])
    np.testing.assert_array_equal(moved[[0, -1]], 0)  # unused: left where they are
    wanted = source.rig.shapes.delta("CTRL_C_jaw.ty")
    skin = components(source.mesh) == 0
    error = np.linalg.norm(moved[1:-1] - wanted, axis=1)  # cm
    assert error[skin].mean() < 0.02 * np.linalg.norm(wanted, axis=1).max()


def test_retarget_rejects_mismatched_counts(tmp_path):
    write_obj_folder(tmp_path / "face", shapes("jawOpen"))
    write_obj(tmp_path / "face" / "mouthSmile_L.obj", TriMesh(MESH.vertices[:3], [[0, 1, 2]]))
    refused(tmp_path, tmp_path / "face", "mouthSmile_L", "3 vertices")
    arrays = {
        "neutral": MESH.vertices, "triangles": MESH.faces, "names": np.array(["jawOpen"]),
        "deltas": np.zeros((1, 3, 3)),
    }  # fmt: skip
    np.savez(tmp_path / "face.npz", **arrays)
    refused(tmp_path, tmp_path / "face.npz", "(1, 3, 3)", "(1, 4, 3)")


def test_retarget_rejects_missing_shapes(tmp_path):
    (tmp_path / "empty").mkdir()
    refused(tmp_path, tmp_path / "empty", "empty")
    write_obj_folder(tmp_path / "face", shapes("jawOpen"))
    (tmp_path / "face" / "neutral.obj").unlink()
    refused(tmp_path, tmp_path / "face", "neutral")
    np.savez(tmp_path / "face.npz", neutral=MESH.vertices, triangles=MESH.faces)
    refused(tmp_path, tmp_path / "face.npz", "'names'")
    write_glb(tmp_path / "own.glb", shapes("Key 1", "Key 2"))
    refused(tmp_path, tmp_path / "own.glb", "Key 1", "mapping")


def refused(tmp_path, mesh, *words):
    """The message is one line, and there is no output."""
    with one_line(RigError, *words):
        retarget_curves(jaw_open(), mesh, tmp_path / "out.glb")
    assert not [p for p in tmp_path.iterdir() if "out" in p.name]


def test_unused_vertices_of_a_sequence_are_kept(tmp_path):
    """A GLB drops them, but keeps the others' order and motion."""
    loose = TriMesh([*MESH.vertices, [5, 5, 5]], MESH.faces)
    deltas = np.zeros((1, 5, 3))
    deltas[0, 3] = 1, 2, 3
    write_glb(tmp_path / "a.glb", ShapeSet(loose, ("jawOpen",), deltas))
    read = read_shapes(tmp_path / "a.glb")
    np.testing.assert_allclose(read.neutral.vertices, MESH.vertices)
    np.testing.assert_allclose(read.delta("jawOpen"), deltas[0, :4])
