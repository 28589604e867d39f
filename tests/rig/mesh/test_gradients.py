"""Gradients and reconstruction: laws on small meshes, round trips on the ICT face."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deitalk.research.meshes.packing import pack, pack_vertices, unpack
from rig.errors import MeshError
from rig.mesh.deformation import (
    DeformationSolver,
    deformation_gradients,
    similarity,
    small_parts,
)
from rig.mesh.trimesh import TriMesh, triangle_areas


def sheet(size=6, shift=(0.0, 0.0, 0.0)):
    """A square of triangles, slightly domed."""
    x, y = np.meshgrid(np.arange(size, dtype=float), np.arange(size, dtype=float))
    z = -0.05 * ((x - size / 2) ** 2 + (y - size / 2) ** 2)
    vertices = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1) + shift
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    a, b, c, d = corner, corner + 1, corner + size + 1, corner + size
    return TriMesh(vertices, np.concatenate([np.c_[a, b, c], np.c_[a, c, d]]))


def joined(*meshes):
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return TriMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=False)]),
    )


def test_a_mesh_that_did_not_move_gives_the_identity():
    mesh = sheet()
    gradients = deformation_gradients(mesh, mesh.vertices)
    np.testing.assert_allclose(gradients, np.broadcast_to(np.eye(3), gradients.shape), atol=1e-14)
    s, r = pack(gradients)
    np.testing.assert_allclose(s, 0, atol=1e-14)
    np.testing.assert_allclose(r, 0, atol=1e-14)


def test_a_rigid_motion_is_pure_rotation_and_leaves_the_stretch(rng):
    mesh = sheet()
    bent = mesh.vertices + rng.normal(scale=0.1, size=mesh.vertices.shape)
    turn = Rotation.from_euler("xyz", [20, 50, -80], degrees=True).as_matrix()
    s, _ = pack(deformation_gradients(mesh, bent))
    s_moved, _ = pack(deformation_gradients(mesh, bent @ turn.T + [5, -3, 2]))
    np.testing.assert_allclose(s_moved, s, atol=1e-12)
    only_moved = deformation_gradients(mesh, mesh.vertices @ turn.T + 7.0)
    np.testing.assert_allclose(only_moved, np.broadcast_to(turn, only_moved.shape), atol=1e-13)


def test_determinant_is_the_area_ratio_to_the_three_halves(rng):
    mesh = sheet()
    moved = mesh.vertices + rng.normal(scale=0.2, size=mesh.vertices.shape)
    ratio = triangle_areas(mesh.with_vertices(moved)) / triangle_areas(mesh)
    np.testing.assert_allclose(
        np.linalg.det(deformation_gradients(mesh, moved)), ratio**1.5, rtol=1e-10
    )


def test_gradients_do_not_depend_on_the_orientation(rng):
    mesh = sheet()
    moved = mesh.vertices + rng.normal(scale=0.1, size=mesh.vertices.shape)
    np.testing.assert_allclose(
        deformation_gradients(mesh.flipped(), moved), deformation_gradients(mesh, moved), atol=1e-12
    )


def test_unpack_inverts_pack(rng):
    mesh = sheet()
    moved = mesh.vertices + rng.normal(scale=0.3, size=(4, *mesh.vertices.shape))
    gradients = deformation_gradients(mesh, moved)
    s, r = pack(gradients)
    assert s.shape == (4, 6 * len(mesh.faces)) and r.shape == (4, 3 * len(mesh.faces))
    np.testing.assert_allclose(unpack(s, r), gradients, atol=1e-12)


def test_consecutive_frames_are_unwrapped():
    """A sheet turning once and a half keeps turning in r; single poses come back to |r| <= pi."""
    mesh = sheet(4)
    angles = np.linspace(0, 3 * np.pi, 60)
    turns = Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    frames = mesh.vertices @ turns.swapaxes(1, 2)
    s, r = pack_vertices(mesh, frames, continuous=True)
    np.testing.assert_allclose(r[:, 2::3], np.tile(angles[:, None], len(mesh.faces)), atol=1e-7)
    single_s, single_r = pack_vertices(mesh, frames)
    assert np.abs(single_r).max() <= np.pi + 1e-12
    np.testing.assert_allclose(unpack(single_s, single_r), unpack(s, r), atol=1e-12)


def test_degenerate_triangles_are_rejected_by_index():
    mesh = sheet()
    vertices = mesh.vertices.copy()
    vertices[mesh.faces[7, 1]] = vertices[mesh.faces[7, 0]]
    with pytest.raises(MeshError, match=r"triangles .*\b7\b.* have no area"):
        deformation_gradients(TriMesh(vertices, mesh.faces), mesh.vertices)
    with pytest.raises(MeshError, match=r"triangles .*\b7\b.* of frame 1 collapse"):
        deformation_gradients(mesh, np.stack([mesh.vertices, vertices]))
    with pytest.raises(MeshError, match=r"\b7\b"):
        DeformationSolver(TriMesh(vertices, mesh.faces))


def test_solve_recovers_the_moved_vertices(rng):
    mesh = sheet(8)
    moved = mesh.vertices + rng.normal(scale=0.2, size=(20, *mesh.vertices.shape))
    solver = DeformationSolver(mesh)
    s, r = pack(deformation_gradients(mesh, moved))
    solved = solver.solve(s, r, pin_positions=moved[:, solver.pins])
    np.testing.assert_allclose(solved, moved, atol=1e-11)
    one = solver.solve(s[3:4], r[3:4], pin_positions=moved[3, solver.pins])
    np.testing.assert_allclose(one[0], moved[3], atol=1e-11)
    from_gradients = solver.solve_gradients(
        deformation_gradients(mesh, moved), pin_positions=moved[:, solver.pins]
    )
    np.testing.assert_allclose(from_gradients, moved, atol=1e-11)


def test_solve_is_the_least_squares_solution_of_the_full_system(rng):
    """Against Eq. 5 written out with dense matrices, area weights and the pin as a column."""
    mesh = sheet(4)
    noisy = np.eye(3) + rng.normal(scale=0.2, size=(len(mesh.faces), 3, 3))
    solver = DeformationSolver(mesh)
    rows, targets = [], []
    for face, t in zip(mesh.faces, noisy, strict=True):
        v = mesh.vertices[face]
        root_area = np.sqrt(np.linalg.norm(np.cross(v[1] - v[0], v[2] - v[0])) / 2)
        # x2-x1 and x3-x1 in orthonormal coordinates of the plane.
        q, upper = np.linalg.qr(np.stack([v[1] - v[0], v[2] - v[0]], axis=1))
        inverse = np.linalg.inv(upper)
        for k in range(2):
            row = np.zeros(len(mesh.vertices))
            row[face[1]] += inverse[0, k]
            row[face[2]] += inverse[1, k]
            row[face[0]] -= inverse[0, k] + inverse[1, k]
            rows.append(root_area * row)
            targets.append(root_area * t @ q[:, k])
    matrix, right = np.array(rows), np.array(targets)
    free = np.setdiff1d(np.arange(len(mesh.vertices)), solver.pins)
    pinned = mesh.vertices[solver.pins]
    expected = np.linalg.lstsq(
        matrix[:, free], right - matrix[:, solver.pins] @ pinned, rcond=None
    )[0]
    np.testing.assert_allclose(solver.solve_gradients(noisy[None])[0, free], expected, atol=1e-10)


def test_a_rigid_part_follows_its_skin():
    mesh = joined(sheet(8), sheet(3, (2, 2, -3)))
    part = small_parts(mesh)[0]
    assert set(part.vertices) == set(range(64, 73)) and part.follows.max() < 64
    turn = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    moved = mesh.vertices @ turn.T + [1, 2, 3]
    solver = DeformationSolver(mesh, parts=[part])
    assert len(solver.pins) == 1
    gradients = deformation_gradients(mesh, moved)
    gradients[-8:] = np.nan  # nothing of the part's own gradients is used
    solved = solver.solve_gradients(gradients[None], pin_positions=moved[solver.pins])
    np.testing.assert_allclose(solved[0], moved, atol=1e-10)


def test_rigid_motion_never_mirrors(rng):
    points = rng.normal(size=(10, 3))
    _, rotation, _ = similarity(points, points * [1, 1, -1], is_rigid=True)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_ict_round_trip(shared, rng):
    file = np.load(shared / "data" / "meshes" / "ict_face.npz")
    mesh = TriMesh(file["neutral"], file["triangles"])
    deltas = file["expression_deltas"][::2].astype(float)
    mixes = np.einsum("tk,kvc->tvc", rng.exponential(0.1, (6, len(deltas))), deltas)
    moved = mesh.vertices + np.concatenate([deltas, mixes])
    s, r = pack_vertices(mesh, moved, continuous=True)
    solver = DeformationSolver(mesh)
    pins = moved[:, solver.pins]
    every, some = slice(None), slice(-12, None)  # the mixes and six of the shapes
    for dtype, bound, part in (
        (np.float64, 1e-9, every), (np.float32, 1e-4, some), (np.float16, 1e-4, some)
    ):  # fmt: skip
        stored = s[part].astype(dtype), r[part].astype(dtype)
        solved = solver.solve(*stored, pin_positions=pins[part])
        error = np.linalg.norm(solved - moved[part], axis=-1).max() / mesh.size
        assert error <= bound, dtype
