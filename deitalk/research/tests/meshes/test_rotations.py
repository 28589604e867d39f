"""Polar decomposition, logarithm, exponential, unwrapping: laws and independent references."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from deitalk.research.meshes.packing import (
    polar,
    rotation_exp,
    rotation_log,
    unwrap,
    unwrap_sequence,
)

ANGLES = [0.0, 1e-12, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-6, np.pi - 1e-9]


def axes(rng, count=40):
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def positive_matrices(rng, count=200):
    t = rng.normal(size=(count, 3, 3))
    t[np.linalg.det(t) < 0, 0] *= -1
    return t[np.abs(np.linalg.det(t)) > 1e-3]


def test_polar_agrees_with_svd(rng):
    t = positive_matrices(rng)
    u, _, vt = np.linalg.svd(t)
    rotation, stretch = polar(t)
    np.testing.assert_allclose(rotation, u @ vt, atol=1e-10)
    np.testing.assert_allclose(rotation @ stretch, t, atol=1e-12)


def test_polar_gives_a_rotation_and_a_symmetric_positive_stretch(rng):
    rotation, stretch = polar(positive_matrices(rng))
    identity = rotation @ rotation.swapaxes(-1, -2)
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), identity.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-14)
    np.testing.assert_array_equal(stretch, stretch.swapaxes(-1, -2))
    assert np.linalg.eigvalsh(stretch).min() > 0


def test_polar_is_accurate_for_thin_triangles():
    # The rim of the ICT lips stretches between 0.004 and 116 times.
    turn = Rotation.from_euler("xyz", [40, -70, 160], degrees=True).as_matrix()
    stretch = np.diag([0.004, 116.0, 1.0])
    rotation, found = polar(turn @ stretch)
    np.testing.assert_allclose(rotation, turn, atol=1e-11)
    np.testing.assert_allclose(found, stretch, atol=1e-9)


def test_polar_rejects_a_reflection():
    with pytest.raises(ValueError, match="positive determinant"):
        polar(np.diag([1.0, 1.0, -1.0]))


@pytest.mark.parametrize("angle", ANGLES)
def test_log_inverts_exp_at(angle, rng):
    vectors = angle * axes(rng)
    matrices = rotation_exp(vectors)
    np.testing.assert_allclose(rotation_log(matrices), vectors, atol=1e-12, rtol=1e-9)
    np.testing.assert_allclose(rotation_exp(rotation_log(matrices)), matrices, atol=1e-12)


def test_exp_agrees_with_the_matrix_exponential(rng):
    for x, y, z in rng.normal(scale=2, size=(20, 3)):
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        np.testing.assert_allclose(rotation_exp([x, y, z]), expm(cross), atol=1e-13)


def test_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(rotation_exp([0, 0, np.pi / 2]) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_unwrap_is_continuous_beyond_pi():
    steps = np.linspace(0, 3 * np.pi, 90)
    turning = steps[:, None, None] * np.array([0.0, 0.6, 0.8])
    wrapped = rotation_log(rotation_exp(turning))
    assert np.abs(np.diff(wrapped, axis=0)).max() > 3  # the jump is really there
    np.testing.assert_allclose(unwrap_sequence(wrapped), turning, atol=1e-7)


def test_unwrap_keeps_the_rotation(rng):
    wrapped = rotation_log(Rotation.random(200, rng=rng).as_matrix())
    reference = rng.normal(scale=6, size=(200, 3))
    unwrapped = unwrap(wrapped, reference)
    np.testing.assert_allclose(rotation_exp(unwrapped), rotation_exp(wrapped), atol=1e-12)
    assert (
        np.linalg.norm(unwrapped - reference, axis=1)
        <= np.linalg.norm(wrapped - reference, axis=1) + 1e-12
    ).all()
