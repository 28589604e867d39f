"""OBJ, PLY, NPZ and GLB: round trips, variants of exporters, and errors of one line."""

import numpy as np
import pytest

from rig.errors import FormatError, MeshError, TopologyError
from rig.mesh.glb import WeightAnimation, read_container, write_container, write_glb
from rig.mesh.glb_reader import animate_glb, morph_names, read_accessor, read_glb
from rig.mesh.obj import read_obj, read_obj_folder
from rig.mesh.shapes import ShapeSet, read_shapes_npz
from rig.mesh.trimesh import (
    TriMesh,
    boundary_edges,
    components,
    degenerate_triangles,
    triangle_areas,
    vertex_normals,
    without_degenerate,
)
from tests.errors import one_line
from tests.meshes import write_obj, write_obj_folder, write_shapes_npz

CUBE = TriMesh(
    [[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)],
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]],
)  # fmt: skip


@pytest.fixture
def shapes(rng):
    deltas = rng.normal(scale=0.1, size=(3, 8, 3))
    deltas[1, 2:] = 0  # a sparse one
    deltas[2] = 0
    return ShapeSet(CUBE, ("jawOpen", "eyeBlink_L", "nothing"), deltas, {"chin": 3})


def write(path, text):
    path.write_text(text)
    return path


def test_cube_has_the_known_size_area_and_normals():
    assert triangle_areas(CUBE).sum() == pytest.approx(6.0)
    assert CUBE.size == pytest.approx(np.sqrt(3))
    assert len(boundary_edges(CUBE)) == 0
    outward = vertex_normals(CUBE) * (CUBE.vertices - 0.5)
    assert (outward.sum(axis=1) > 0).all()


def test_components_count_loose_vertices_and_put_the_largest_first():
    mesh = TriMesh(
        np.vstack([np.eye(3), CUBE.vertices + 5, [[9, 9, 9]]]),
        np.vstack([[[0, 1, 2]], CUBE.faces + 3]),
    )
    assert components(mesh).tolist() == [1] * 3 + [0] * 8 + [2]


def test_compact_drops_unused_vertices():
    mesh = TriMesh(np.vstack([[[7, 7, 7]], CUBE.vertices]), CUBE.faces + 1)
    compact, used = mesh.compact()
    np.testing.assert_array_equal(compact.vertices, CUBE.vertices)
    np.testing.assert_array_equal(used, np.arange(1, 9))


def test_degenerate_triangles_are_found_and_can_be_left_out():
    mesh = TriMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 3], [0, 1, 2]])
    assert degenerate_triangles(mesh).tolist() == [1]
    assert without_degenerate(mesh).faces.tolist() == [[0, 1, 3]]


@pytest.mark.parametrize(
    ("vertices", "faces", "error", "words"),
    [
        ([[0, 0]], [[0, 0, 0]], MeshError, r"\(V, 3\)"),
        (np.eye(3), [[0, 1]], MeshError, r"\(N, 3\)"),
        (np.eye(3), np.zeros((0, 3), int), MeshError, "no triangles"),
        (np.eye(3), [[0, 1, 3]], TopologyError, "triangles 0 name vertices outside 0..2"),
        (np.eye(3), [[0, 1, -1]], TopologyError, "outside"),
        (np.eye(3), [[0, 1, 2], [0, 1, 1]], TopologyError, "triangles 1 name a vertex twice"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], MeshError, "vertices 0, 1, 2 are not finite"),
    ],
)
def test_trimesh_rejects_invalid_arrays(vertices, faces, error, words):
    with pytest.raises(error, match=words):
        TriMesh(vertices, faces)


def test_obj_round_trip(tmp_path, rng):
    mesh = CUBE.with_vertices(rng.normal(size=(8, 3)))
    write_obj(tmp_path / "a.obj", mesh)
    again = read_obj(tmp_path / "a.obj")
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    np.testing.assert_array_equal(again.faces, mesh.faces)


def test_obj_variants_of_exporters_are_read(tmp_path):
    text = (
        "# made by hand\nmtllib x.mtl\no face\nv 0 0 0 1 1 1\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 5 5 5\n"
        "vt 0 0\nvn 0 0 1\ng skin\nusemtl s\ns off\nf 1/1/1 2/1/1 3/1/1 4/1/1\nf -5//1 -4//1 \\\n -3//1\n"
    )
    mesh = read_obj(write(tmp_path / "a.obj", text))
    # The quad is a fan from its first corner; negative indices count back; vertex 5 is kept.
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert len(mesh.vertices) == 5


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("", FormatError, "is empty"),
        ("# nothing\n", FormatError, "no vertices"),
        ("v 0 0 zero\n", FormatError, "line 1: cannot read 'v 0 0 zero'"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", FormatError, "line 4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", FormatError, "line 4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", TopologyError, "outside"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", MeshError, "no triangles"),
    ],
)
def test_read_obj_rejects(tmp_path, text, error, words):
    with pytest.raises(error, match=words):
        read_obj(write(tmp_path / "a.obj", text))


def test_obj_folder_round_trip(tmp_path, shapes):
    write_obj_folder(tmp_path / "set", shapes)
    again = read_obj_folder(tmp_path / "set")
    assert set(again.names) == set(shapes.names)
    for name in shapes.names:
        np.testing.assert_allclose(again.delta(name), shapes.delta(name), atol=1e-7)


def test_npz_round_trip(tmp_path, shapes):
    write_shapes_npz(tmp_path / "a.npz", shapes)
    again = read_shapes_npz(tmp_path / "a.npz")
    assert again.names == shapes.names and dict(again.landmarks) == {"chin": 3}
    np.testing.assert_array_equal(again.deltas, shapes.deltas)
    np.testing.assert_array_equal(again.neutral.faces, CUBE.faces)


def test_evaluate_adds_weighted_shapes(shapes):
    moved = shapes.evaluate([[0, 0, 0], [0.5, 1, 1]])
    np.testing.assert_array_equal(moved[0], CUBE.vertices)
    expected = CUBE.vertices + 0.5 * shapes.delta("jawOpen") + shapes.delta("eyeBlink_L")
    np.testing.assert_allclose(moved[1], expected, atol=1e-6)


def test_glb_round_trip(tmp_path, shapes):
    write_glb(tmp_path / "a.glb", shapes)
    again = read_glb(tmp_path / "a.glb")
    assert again.names == shapes.names
    np.testing.assert_allclose(again.neutral.vertices, CUBE.vertices, atol=1e-7)
    np.testing.assert_array_equal(again.neutral.faces, CUBE.faces)
    np.testing.assert_allclose(again.deltas, shapes.deltas, atol=1e-4)


def test_glb_targets_are_sparse_and_bounded(tmp_path, shapes):
    write_glb(tmp_path / "a.glb", shapes)
    document, _ = read_container(tmp_path / "a.glb")
    targets = document["meshes"][0]["primitives"][0]["targets"]
    accessors = [document["accessors"][t["POSITION"]] for t in targets]
    assert accessors[1]["sparse"]["count"] == 2
    assert "sparse" not in accessors[2] and accessors[2]["max"] == [0, 0, 0]
    np.testing.assert_allclose(
        accessors[1]["min"], np.minimum(shapes.deltas[1].min(axis=0), 0), atol=1e-6
    )
    assert document["meshes"][0]["extras"]["targetNames"] == list(shapes.names)


def test_glb_animation_has_a_weight_for_every_target_and_frame(tmp_path, shapes, rng):
    weights = rng.random((5, 3)).astype(np.float32)
    write_glb(tmp_path / "a.glb", shapes, animation=WeightAnimation(weights, fps=30))
    document, binary = read_container(tmp_path / "a.glb")
    animation = document["animations"][0]
    assert animation["channels"][0]["target"] == {"node": 0, "path": "weights"}
    times = read_accessor(document, binary, animation["samplers"][0]["input"])
    output = read_accessor(document, binary, animation["samplers"][0]["output"])
    np.testing.assert_allclose(times, np.arange(5) / 30, atol=1e-7)
    np.testing.assert_array_equal(output.reshape(5, 3), weights)
    time_accessor = document["accessors"][animation["samplers"][0]["input"]]
    assert time_accessor["min"] == [0] and time_accessor["max"] == pytest.approx([4 / 30])


def test_glb_agrees_with_an_independent_reader(tmp_path, shapes):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is an independent reader")
    write_glb(tmp_path / "a.glb", shapes)
    other = trimesh.load(tmp_path / "a.glb", force="mesh", process=False)
    np.testing.assert_allclose(other.vertices, CUBE.vertices, atol=1e-7)
    np.testing.assert_array_equal(other.faces, CUBE.faces)


def test_animate_keeps_the_users_file_and_fills_by_name(tmp_path, shapes):
    write_glb(tmp_path / "a.glb", shapes)
    assert morph_names(tmp_path / "a.glb") == shapes.names
    weights = np.array([[0.1, 0.2], [0.3, 0.4]])
    animate_glb(
        tmp_path / "a.glb", tmp_path / "b.glb", ("eyeBlink_L", "unknown"), WeightAnimation(weights)
    )
    before, old = read_container(tmp_path / "a.glb")
    after, new = read_container(tmp_path / "b.glb")
    assert after["meshes"] == before["meshes"] and new[: len(old)] == old
    output = read_accessor(after, new, after["animations"][0]["samplers"][0]["output"])
    np.testing.assert_allclose(output.reshape(2, 3), [[0, 0.1, 0], [0, 0.3, 0]], atol=1e-7)
    with pytest.raises(MeshError, match="none of the morph targets nobody"):
        animate_glb(tmp_path / "a.glb", tmp_path / "b.glb", ("nobody",), WeightAnimation(weights))


def test_glb_nodes_move_and_scale_their_meshes(tmp_path, shapes):
    write_glb(tmp_path / "a.glb", shapes)
    document, binary = read_container(tmp_path / "a.glb")
    half = np.sqrt(0.5)
    document["nodes"] = [
        {"children": [1], "translation": [1, 0, 0]},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 2, 2]},
    ]
    write_container(tmp_path / "b.glb", document, binary)
    again = read_glb(tmp_path / "b.glb")
    quarter_turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(
        again.neutral.vertices, 2 * CUBE.vertices @ quarter_turn.T + [1, 0, 0], atol=1e-6
    )
    np.testing.assert_allclose(
        again.delta("jawOpen"), 2 * shapes.delta("jawOpen") @ quarter_turn.T, atol=1e-4
    )


@pytest.mark.parametrize(
    ("extension", "words"),
    [
        ("KHR_draco_mesh_compression", "Draco"),
        ("EXT_meshopt_compression", "meshopt"),
        ("KHR_texture_basisu", "KTX2"),
        ("VENDOR_secret", "needs the extension VENDOR_secret"),
    ],
)
def test_read_glb_rejects_compression_in_one_line(tmp_path, shapes, extension, words):
    write_glb(tmp_path / "a.glb", shapes)
    document, binary = read_container(tmp_path / "a.glb")
    document["extensionsRequired"] = [extension]
    write_container(tmp_path / "a.glb", document, binary)
    with one_line(FormatError, match=words):
        read_glb(tmp_path / "a.glb")
