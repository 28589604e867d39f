"""Gradient bases: weighted PCA against its definition, sizes by lip error, float16 storage."""

import numpy as np
import pytest

from deitalk.research.meshes.gradient_bases import choose_bases, fit_basis, read_bases, write_bases
from rig.errors import FormatError, MeshError
from rig.mesh.trimesh import TriMesh


def dome(size=9):
    x, y = np.meshgrid(np.linspace(-1, 1, size), np.linspace(-1, 1, size))
    vertices = np.stack(
        [x.ravel(), y.ravel(), np.sqrt(4 - x.ravel() ** 2 - y.ravel() ** 2)], axis=1
    )
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    a, b, c, d = corner, corner + 1, corner + size + 1, corner + size
    return TriMesh(vertices, np.concatenate([np.c_[a, b, c], np.c_[a, c, d]]))


def motion(mesh, rng, frames):
    """Six smooth bends of the dome, mixed anew in every frame."""
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    bends = np.stack([np.sin(k * x + 1) * np.cos((5 - k) * y) for k in range(6)])
    weights = rng.normal(scale=0.08, size=(frames, 6))
    return mesh.vertices + (weights @ bends)[..., None] * np.array([0.1, 0.3, 1.0])


def test_projection_is_weighted_least_squares(rng):
    areas = rng.uniform(0.2, 3.0, size=10)
    frames = rng.normal(size=(40, 4)) @ rng.normal(size=(4, 60)) + 3.0
    noisy = frames + 0.01 * rng.normal(size=frames.shape)
    basis = fit_basis(noisy, areas, most=4)
    weights = np.repeat(np.sqrt(areas / areas.mean()), 6)
    left = (noisy[5] - basis.mean) * weights
    expected = np.linalg.lstsq((basis.components.astype(float) * weights).T, left, rcond=None)[0]
    np.testing.assert_allclose(basis.project(noisy[5]), expected, rtol=5e-3, atol=5e-3)
    # The four that made the frames suffice, and their coefficients have unit variance.
    np.testing.assert_allclose(basis.expand(basis.project(noisy)), noisy, atol=0.1)
    np.testing.assert_allclose(basis.project(noisy).std(axis=0, ddof=1), 1.0, atol=1e-2)


def test_component_order_follows_the_area_weights():
    """Two independent motions of equal size: the large triangle's is the first component."""
    rng = np.random.default_rng(1)
    frames = np.zeros((50, 6))
    frames[:, 0], frames[:, 3] = rng.normal(size=(2, 50))
    for areas, first in (([9.0, 1.0], 0), ([1.0, 9.0], 3)):
        basis = fit_basis(frames, areas)
        assert np.argmax(np.abs(basis.components[0])) == first


def test_size_follows_the_share_of_variance():
    frames = np.diag([3.0, 2.0, 1.0])[[0, 0, 1, 1, 2, 2]] * np.array([1, -1] * 3)[:, None]
    basis = fit_basis(frames, [1.0])
    assert [basis.size_for(share) for share in (0.5, 0.9, 0.95, 1.0)] == [1, 2, 3, 3]
    assert len(basis.truncated(2).components) == 2


def test_chosen_bases_keep_unseen_lips_within_the_bound(rng, tmp_path):
    mesh = dome()
    training, held_out = motion(mesh, rng, 60), motion(mesh, rng, 15)
    lips = np.flatnonzero(np.abs(mesh.vertices[:, 1]) < 0.2)
    loose = choose_bases(mesh, training, held_out, lips, bound=0.05)
    tight = choose_bases(mesh, training, held_out, lips, bound=0.02)
    assert loose.table[-1]["lips_p99"] <= 0.05 and tight.table[-1]["lips_p99"] <= 0.02
    assert len(tight.rotation.deviations) > len(loose.rotation.deviations)
    errors = [row["lips_p99"] for row in tight.table]
    assert errors[-1] == min(errors)
    write_bases(tmp_path / "b.npz", tight)
    again = read_bases(tmp_path / "b.npz")
    assert again.stretch.components.dtype == np.float16
    np.testing.assert_array_equal(again.rotation.components, tight.rotation.components)


def test_fit_basis_rejects_frames_without_motion(tmp_path):
    with pytest.raises(MeshError, match="do not move"):
        fit_basis(np.ones((5, 6)), [1.0])
    with pytest.raises(MeshError, match="at least 2 rows"):
        fit_basis(np.ones((1, 6)), [1.0])
    np.savez(tmp_path / "x.npz", a=1)
    with pytest.raises(FormatError, match="holds no gradient bases"):
        read_bases(tmp_path / "x.npz")
