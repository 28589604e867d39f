"""PLY files: round trips, foreign layouts, refusals."""

import struct

import numpy as np
import pytest

from deitalk.research.meshes.frames import read_ply_sequence
from rig.errors import FormatError, TopologyError
from rig.mesh.ply import read_ply, write_ply, write_ply_sequence
from rig.mesh.trimesh import TriMesh
from tests.rig.mesh.test_files import CUBE


@pytest.mark.parametrize("ascii", [True, False])
def test_ply_round_trip(tmp_path, rng, ascii):
    mesh = CUBE.with_vertices(rng.normal(size=(8, 3)))
    write_ply(tmp_path / "a.ply", mesh, ascii=ascii)
    again = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    np.testing.assert_array_equal(again.faces, mesh.faces)


def test_ply_big_endian_with_colours_and_a_quad(tmp_path):
    header = (
        "ply\nformat binary_big_endian 1.0\ncomment x\nelement vertex 4\nproperty float x\n"
        "property float y\nproperty float z\nproperty uchar red\nelement face 1\n"
        "property list uchar int vertex_index\nproperty float quality\nend_header\n"
    )
    body = b"".join(
        struct.pack(">fffB", *p, 7) for p in [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 2)]
    )
    body += struct.pack(">Biiiif", 4, 0, 1, 2, 3, 0.5)
    (tmp_path / "a.ply").write_bytes(header.encode() + body)
    mesh = read_ply(tmp_path / "a.ply")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.vertices[3].tolist() == [0, 1, 2]
    (tmp_path / "a.ply").write_bytes((header.encode() + body)[:-3])
    with pytest.raises(FormatError, match="cut short"):
        read_ply(tmp_path / "a.ply")


def test_ply_sequence_round_trip(tmp_path, rng):
    frames = rng.normal(size=(12, 8, 3))
    write_ply_sequence(tmp_path / "s", CUBE, frames)
    mesh, again = read_ply_sequence(tmp_path / "s")
    np.testing.assert_allclose(again, frames, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, CUBE.faces)
    write_ply(tmp_path / "s" / "z.ply", TriMesh(np.eye(3), [[0, 1, 2]]))
    with pytest.raises(TopologyError, match=r"z\.ply has 3 vertices"):
        read_ply_sequence(tmp_path / "s")
