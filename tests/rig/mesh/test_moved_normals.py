"""Normals of a mesh in a pose that moves a part of it."""

import numpy as np

from rig.mesh.trimesh import MovedNormals, TriMesh, vertex_normals


def test_a_corner_lifted_out_of_a_square_turns_the_normals_of_its_two_faces():
    # Square in the xy plane; corner 2 goes up by 1. Face 012 gets normal (0,-1,1)/sqrt 2 and
    # face 023 (-1,0,1)/sqrt 2, each of length sqrt 2 as a cross product: vertex 0 has the mean.
    square = TriMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    ids, change = MovedNormals(square).turn(np.array([2]), np.array([[0.0, 0.0, 1.0]]))
    assert list(ids) == [0, 1, 2, 3]
    both = np.array([-1, -1, 2]) / 6**0.5
    one, other = np.array([0, -1, 1]) / 2**0.5, np.array([-1, 0, 1]) / 2**0.5
    assert np.allclose(change + np.array([0, 0, 1]), [both, one, both, other], atol=1e-6)


def test_only_the_faces_of_moving_vertices_count():
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0))
    grid = np.stack([x, y, 0.2 * rng.standard_normal(x.shape)], -1).reshape(-1, 3)
    a = (np.arange(4)[:, None] * 6 + np.arange(5)).ravel()
    mesh = TriMesh(grid, np.concatenate([np.c_[a, a + 1, a + 7], np.c_[a, a + 7, a + 6]]))
    moving, delta = np.array([0, 7, 8]), rng.standard_normal((3, 3))
    moved = mesh.vertices.copy()
    moved[moving] += delta
    ids, change = MovedNormals(mesh).turn(moving, delta)
    whole = vertex_normals(mesh.with_vertices(moved)) - vertex_normals(mesh)
    assert np.allclose(whole[ids], change, atol=1e-6)
    assert not np.delete(whole, ids, axis=0).any()
