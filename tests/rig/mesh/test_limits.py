"""Meshes at and above their limits, and files with wrong counts and offsets: errors of one line."""

import struct

import numpy as np
import pytest

from rig import limits
from rig.errors import RigError
from rig.mesh import TriMesh, write_ply
from rig.mesh.obj import read_obj
from rig.mesh.ply import read_ply
from rig.mesh.shapes import check_shape_count, read_shapes_npz
from rig.mesh.trimesh import check_length
from rig.retarget.mapping_files import read_mapping
from tests.errors import one_line

SQUARE = TriMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"


def refused(read, *arguments):
    with one_line(RigError) as caught:
        read(*arguments)
    return str(caught.value)


def written(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_coordinates_beyond_the_limit_are_rejected():
    assert TriMesh(SQUARE.vertices * limits.COORDINATE, SQUARE.faces).size > 1e9
    assert "vertices 1, 2, 3 are not finite" in refused(
        TriMesh, SQUARE.vertices * 1.001 * limits.COORDINATE, SQUARE.faces
    )


@pytest.mark.parametrize(("most", "fits"), [(4, True), (3, False)])
def test_obj_vertices_are_counted_while_reading(tmp_path, monkeypatch, most, fits):
    monkeypatch.setattr("rig.mesh.obj.VERTICES", most)
    path = written(tmp_path / "a.obj", OBJ)
    if fits:
        assert len(read_obj(path).vertices) == 4
    else:
        assert "more than 3 vertices" in refused(read_obj, path)


@pytest.mark.parametrize(("most", "fits"), [(2, True), (1, False)])
def test_triangles_are_counted_while_reading(tmp_path, monkeypatch, most, fits):
    for module in ("obj", "ply"):
        monkeypatch.setattr(f"rig.mesh.{module}.TRIANGLES", most)
    write_ply(tmp_path / "a.ply", SQUARE)
    for read, path in (
        (read_obj, written(tmp_path / "a.obj", OBJ)),
        (read_ply, tmp_path / "a.ply"),
    ):
        if fits:
            assert read(path).faces.tolist() == SQUARE.faces.tolist()
        else:
            assert "decimate" in refused(read, path)


def test_shapes_at_the_limits_are_held_and_above_are_not():
    check_shape_count(limits.SHAPES, limits.SHAPE_VALUES // 3 // limits.SHAPES)
    assert "2001 shapes; at most 2000" in refused(check_shape_count, 2001, 3)
    assert "more than 134217728 numbers" in refused(check_shape_count, 2000, 22_370)


def test_sequences_at_the_limit_are_made_and_above_are_not():
    check_length(1, limits.SEQUENCE_BYTES // 12)
    assert "are made" in refused(check_length, 1, limits.SEQUENCE_BYTES // 12 + 1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (OBJ + "f 1 2 99999999999999999999\n", "line 6: cannot read"),
        (OBJ + "f 1 2 " + "9" * 10_000 + "\n", "line 6"),
        (OBJ.replace("v 1 1 0", "v 1e400 1 0"), "vertices 2 are not finite"),
        (OBJ.replace("v 1 1 0", "v 1e308 1 0"), "vertices 2 are not finite"),
        ("v " + "1 " * 100_000 + "x" * 100_000, "no triangles"),
    ],
)
def test_obj_rejects(tmp_path, text, words):
    assert words in refused(read_obj, written(tmp_path / "a.obj", text))


def ply(*elements, order="binary_little_endian", body=b""):
    lines = ["ply", f"format {order} 1.0"]
    for name, count, *properties in elements:
        lines += [f"element {name} {count}", *(f"property {p}" for p in properties)]
    return ("\n".join([*lines, "end_header"]) + "\n").encode() + body


CORNERS = "list uchar int vertex_indices"
POINTS = np.array(SQUARE.vertices, "<f4").tobytes()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ply(("vertex", 5_000_000, "float x", "float y", "float z")), "cut short"),
        (ply(("vertex", 5_000_001, "float x")), "at most 5000000"),
        (ply(("vertex", 1, "float x"), body=bytes(4)).replace(b"ply", b"plx", 1), "no 'ply'"),
        (ply(order="odd"), "not a readable PLY"),
        (ply(), "has no 'vertex' element"),
        (ply(*[("a", 5_000_000)] * 100, order="ascii"), "has no properties"),
        (ply(("a", 5_000_000), order="binary_big_endian"), "has no properties"),
        (ply(("vertex", 4, "float x", "float x")), "one name twice"),
        (ply(("face", 2, "list float int vertex_indices")), "no whole number"),
        (ply(("face", 1, "list int int vertex_indices"), body=struct.pack("<i", -5)), "-5 values"),
        (ply(("face", 1, "list int int vertex_indices"), body=struct.pack("<i", 2**31 - 1)), "cut"),
        (ply(("vertex", 1, "list uchar float x"), body=bytes(9)), "not a readable PLY"),
        (ply(("face", 1, "list uchar float vertex_indices"), body=b"\1" + bytes(4)), "'vertex'"),
        (ply(("vertex", 1, "float x", "float y", "float z"), ("face", 1, CORNERS),
             order="ascii", body=b"0 0 0\n3 0 1 99999999999999999999\n"), "not a readable PLY"),
        (ply(("vertex", 4, "float x", "float y", "float z"), ("face", 1, "float vertex_indices"),
             body=POINTS + bytes(4)), "lists of whole numbers"),
    ],
)  # fmt: skip
def test_ply_rejects(tmp_path, data, words):
    assert words in refused(read_ply, written(tmp_path / "a.ply", data))


@pytest.mark.parametrize("order", ["<", ">", ""])
@pytest.mark.parametrize("polygons", [[[0, 1, 2], [0, 2, 3]], [[0, 1, 2, 3]], [[0, 1, 2, 3], [1, 2], [3, 0, 2]]])  # fmt: skip
def test_ply_polygons_of_any_lengths_become_fans(tmp_path, order, polygons):
    name = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    if order:
        body = np.array(SQUARE.vertices, order + "f4").tobytes() + b"".join(
            struct.pack(f"{order}B{len(p)}i", len(p), *p) for p in polygons
        )
    else:
        rows = [*SQUARE.vertices.tolist(), *([len(p), *p] for p in polygons)]
        body = "\n".join(" ".join(map(str, row)) for row in rows).encode()
    elements = ("vertex", 4, "float x", "float y", "float z"), ("face", len(polygons), CORNERS)
    path = written(tmp_path / "a.ply", ply(*elements, order=name, body=body))
    expected = [[p[0], p[i], p[i + 1]] for p in polygons for i in range(1, len(p) - 1)]
    assert read_ply(path).faces.tolist() == expected


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"neutral": np.array(["a"])}, "'neutral' holds <U1"),
        ({"triangles": np.array([[0.0, 1, 2]])}, "'triangles' holds float64"),
        ({"names": np.array("jawOpen")}, "names have shape ()"),
        ({"names": np.array([str(i) for i in range(2001)])}, "at most 2000"),
        ({"deltas": np.full((1, 4, 3), 1e300)}, "not finite"),
        ({"landmark_names": np.array(["chin"]), "landmark_vertices": np.array([4])}, "one of 4"),
        ({"landmark_names": np.array(["chin"]), "landmark_vertices": np.array([-1])}, "one of 4"),
        ({"landmark_names": np.array(["chin"])}, "one of 4"),
        ({"triangles": np.array([[0, 1, 2**63]], np.uint64)}, "outside"),
    ],
)
def test_shape_file_rejects(tmp_path, change, words):
    arrays = {
        "neutral": SQUARE.vertices, "triangles": SQUARE.faces, "names": np.array(["jawOpen"]),
        "deltas": np.zeros((1, 4, 3)), **change,
    }  # fmt: skip
    np.savez(tmp_path / "a.npz", **arrays)
    assert words in refused(read_shapes_npz, tmp_path / "a.npz")


def test_most_shapes_are_mapped_and_one_more_is_not(tmp_path):
    rows = ["shape,control,value", *(f"s{i},jaw,1" for i in range(limits.POINT_NAMES + 1))]
    assert len(read_mapping(written(tmp_path / "m.csv", "\n".join(rows[:-1])))) == 1000
    assert "1001 shapes; at most 1000" in refused(
        read_mapping, written(tmp_path / "m.csv", "\n".join(rows))
    )
