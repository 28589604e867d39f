"""Vertex sequences: principal shapes against the truth, and the three files they go to."""

import numpy as np
import pytest

from deitalk.research.meshes.frames import read_ply_sequence
from rig.errors import FormatError, MeshError, TargetError
from rig.mesh import TriMesh
from rig.mesh.glb import read_container
from rig.mesh.glb_reader import read_accessor, read_glb
from rig.mesh.sequence import principal_shapes, write_sequence
from rig.mesh.trimesh import check_length

MESH = TriMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.2]], [[0, 1, 2], [1, 3, 2]])


def moving(n_frames, rank=2, seed=0):
    """The mesh under `rank` motions of its own."""
    rng = np.random.default_rng(seed)
    motions = rng.normal(size=(rank, 4, 3))
    return MESH.vertices + np.tensordot(rng.normal(size=(n_frames, rank)), motions, axes=1)


def test_principal_shapes_are_as_many_as_the_motions():
    frames = moving(50, rank=3)
    shapes, weights = principal_shapes(MESH, frames, 1e-5)
    assert len(shapes.names) == 3
    np.testing.assert_allclose(shapes.evaluate(weights), frames, atol=2e-5)
    np.testing.assert_allclose(np.abs(weights).max(axis=0), 1, atol=1e-6)


def test_bound_is_kept_with_the_fewest_shapes():
    strong, weak = np.zeros((2, 4, 3))
    strong[0, 0], weak[3, 2] = 1.0, 0.01
    phase = np.linspace(0, 6, 40)[:, None, None]
    frames = MESH.vertices + np.sin(phase) * strong + np.cos(3 * phase) * weak
    coarse, weights = principal_shapes(MESH, frames, 0.02)
    assert len(coarse.names) == 1
    assert np.linalg.norm(coarse.evaluate(weights) - frames, axis=-1).max() <= 0.02
    assert len(principal_shapes(MESH, frames, 0.001)[0].names) == 2


def test_a_face_at_rest_has_no_weights():
    frames = np.concatenate([moving(5), MESH.vertices[None]])
    _, weights = principal_shapes(MESH, frames, 1e-6)
    np.testing.assert_allclose(weights[-1], 0, atol=1e-6)
    shapes, weights = principal_shapes(MESH, np.repeat(MESH.vertices[None], 3, axis=0), 1e-6)
    assert weights.shape == (3, 1) and not weights.any() and not shapes.deltas.any()


def test_one_different_frame_among_a_thousand_is_kept():
    """Evenly chosen frames miss it; the frames with the largest error are added."""
    frames = np.repeat(MESH.vertices[None], 1000, axis=0)
    frames[:, 0, 0] += np.sin(np.arange(1000))
    frames[501, 3, 2] += 0.5
    shapes, weights = principal_shapes(MESH, frames, 1e-4)
    np.testing.assert_allclose(shapes.evaluate(weights[501:502])[0], frames[501], atol=2e-4)
    assert len(shapes.names) == 2


def test_files_hold_the_frames(tmp_path):
    frames = moving(7).astype(np.float32)
    for name in ("a.npz", "a.glb", "frames"):
        write_sequence(
            tmp_path / name, MESH, frames, fps=24, tolerance=1e-5, unit_metres=0.01,
            colours=np.full((4, 3), 0.25),
        )  # fmt: skip
    with np.load(tmp_path / "a.npz") as file:
        np.testing.assert_array_equal(file["vertices"], frames)
        np.testing.assert_array_equal(file["triangles"], MESH.faces)
        assert file["fps"] == 24
    first, read = read_ply_sequence(tmp_path / "frames")
    np.testing.assert_allclose(read, frames, atol=1e-6)
    np.testing.assert_array_equal(first.faces, MESH.faces)
    document, binary = read_container(tmp_path / "a.glb")
    sampler = document["animations"][0]["samplers"][0]
    times = read_accessor(document, binary, sampler["input"])
    np.testing.assert_allclose(times.ravel(), np.arange(7) / 24, atol=1e-6)
    shapes = read_glb(tmp_path / "a.glb")
    weights = read_accessor(document, binary, sampler["output"]).reshape(7, -1)
    np.testing.assert_allclose(shapes.evaluate(weights), 0.01 * frames, atol=1e-6)
    colour = document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    np.testing.assert_allclose(read_accessor(document, binary, colour), 0.25)


def test_failed_write_leaves_no_file(tmp_path):
    with pytest.raises(TargetError, match=r"a\.fbx: .*\.glb, \.npz"):
        write_sequence(tmp_path / "a.fbx", MESH, moving(2), fps=30)
    with pytest.raises(FormatError, match="is not a folder"):
        write_sequence(tmp_path / "none" / "a.npz", MESH, moving(2), fps=30)
    with pytest.raises(MeshError, match=r"400000 frames of 1000 vertices are 4\.5 GiB, at most 4 "):
        check_length(400_000, 1000)
    assert not list(tmp_path.iterdir())
