"""GLB files of strangers: counts, circles and offsets that do not fit are refused."""

import struct
import tracemalloc

import numpy as np
import pytest

from rig import limits
from rig.errors import RigError
from rig.mesh import ShapeSet
from rig.mesh.glb import read_container, write_container, write_glb
from rig.mesh.glb_reader import morph_names, read_glb
from rig.mesh.ply import read_ply
from rig.retarget.retarget_files import read_shapes
from tests.rig.mesh.test_limits import SQUARE, refused


def changed_glb(folder, change):
    deltas = np.zeros((2, 4, 3))
    deltas[:, 1] = 0.5
    write_glb(folder / "a.glb", ShapeSet(SQUARE, ("jawOpen", "blink"), deltas))
    document, binary = read_container(folder / "a.glb")
    change(document)
    write_container(folder / "b.glb", document, binary)
    return folder / "b.glb"


def bare(document):
    for accessor in document["accessors"]:
        accessor.pop("bufferView", None)


def many_nodes(document):
    document["nodes"] = [{"mesh": 0}] * (limits.NODES + 1)
    document["scenes"] = [{"nodes": list(range(limits.NODES + 1))}]


def many_primitives(document):
    document["meshes"][0]["primitives"] *= limits.PRIMITIVES + 1


def zero_stride(document):
    place = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    view = document["bufferViews"][document["accessors"][place]["bufferView"]]
    view["byteStride"] = 0
    document["accessors"][place]["count"] = 4_000_000


def position_count(count):
    def change(document):
        place = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
        document["accessors"][place]["count"] = count

    return change


def set_in(*path):
    *parents, last, value = path

    def change(document):
        part = document
        for key in parents:
            part = part[key]
        part[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (bare, "with data"),
        (many_nodes, "10001 nodes; at most 10000"),
        (many_primitives, "more than 10000 primitives"),
        (zero_stride, "reaches past the file's data"),
        (position_count(10**18), "at most 15000000 numbers"),
        (position_count(-1), "at most"),
        (position_count("x" * 10**6), "inconsistent"),
        (set_in("meshes", 0, "extras", []), "inconsistent"),
        (set_in("nodes", 0, 5), "inconsistent"),
        (set_in("nodes", 0, "matrix", [1e308] * 16), "not finite"),
        (set_in("nodes", 0, "matrix", [10**400] * 16), "inconsistent"),
        (set_in("meshes", 0, "primitives", 0, "targets", [{"POSITION": 0}] * 2001), "2001 morph"),
        (set_in("scenes", 0, "nodes", [10**9]), "inconsistent"),
    ],
)
def test_glb_rejects(tmp_path, change, words):
    assert words in refused(read_shapes, changed_glb(tmp_path, change))


def test_glb_nodes_in_a_circle_are_visited_once(tmp_path):
    path = changed_glb(tmp_path, set_in("nodes", 0, "children", [0] * 1000))
    assert len(read_glb(path).neutral.vertices) == 4


@pytest.mark.parametrize("change", [set_in("nodes", [{"mesh": 7}]), set_in("meshes", 0, "primitives", [])])  # fmt: skip
def test_morph_names_reject_documents_that_do_not_fit(tmp_path, change):
    assert "inconsistent" in refused(morph_names, changed_glb(tmp_path, change))


@pytest.mark.parametrize("length", [100, 2**28, 2**31 - 1])
def test_ply_list_longer_than_its_file_takes_no_memory(tmp_path, length):
    data = b"ply\nformat binary_little_endian 1.0\nelement face 1\n"
    data += b"property list uint double vertex_indices\nend_header\n" + struct.pack("<I", length)
    (tmp_path / "a.ply").write_bytes(data + bytes(80))
    tracemalloc.start()
    with pytest.raises(RigError, match="cut short"):
        read_ply(tmp_path / "a.ply")
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_glb_with_large_counts_in_a_small_file_takes_no_memory(tmp_path):
    """A file of 300 bytes that declares 3.6 GB of zeros."""
    document = {
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 0}]}],
        "accessors": [{"componentType": 5126, "type": "VEC3", "count": 5_000_000}],
    }
    write_container(tmp_path / "a.glb", document, b"")
    tracemalloc.start()
    refused(read_glb, tmp_path / "a.glb")
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()
