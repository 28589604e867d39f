"""A face baked to shapes with correctives."""

import numpy as np
import pytest

from rig.controls import Control, ControlSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import Driver, Half, bake, face_correctives, moves_of
from tests.rig.retarget.test_blendshapes import BOARD

CONTROLS = ControlSet(
    "test@1",
    (Control("jaw"), Control("lip"), Control("gaze", minimum=-2.0), Control("idle"), Control("up", rest=1.0)),
)  # fmt: skip
NEUTRAL = TriMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def toy(values):
    """A rig that bends: jaw squared, a product of jaw and lip, and a gaze of two unlike halves."""
    v = np.asarray(values, dtype=np.float64)
    out = np.tile(NEUTRAL.vertices, (len(v), 1, 1))
    out[:, 0, 2] += v[:, 0] ** 2 - 0.7 * v[:, 0] * v[:, 1] + 0.1 * v[:, 1]
    out[:, 1, 2] += np.where(v[:, 2] > 0, 3.0, 0.5) * v[:, 2]
    out[:, 2, 2] += 0.4 * v[:, 4]
    return out


AT_REST = NEUTRAL.with_vertices(toy(CONTROLS.rest[None])[0])
MOVES = moves_of(toy, AT_REST.vertices)
JAW, LIP = Half("jaw"), Half("lip")
CORRECTIVES = [("half", Driver(((JAW,),), peak=0.5)), ("both", Driver(((JAW,), (LIP,))))]


@pytest.fixture(scope="module")
def baked():
    return bake(AT_REST, MOVES, CONTROLS, correctives=CORRECTIVES).dense()


def test_baked_shapes_are_the_moving_halves(baked):
    assert baked.shapes.names == (
        "jaw",
        "lip",
        "gaze",
        "gaze_negative",
        "up_negative",
        "half",
        "both",
    )


@pytest.mark.parametrize(
    "pose",
    [(0, 0, 0, 0, 1), (1, 0, 0, 0, 1), (0.5, 0, 0, 0, 1), (1, 1, 0, 0, 1), (0, 0.4, 0, 1, 1),
     (0, 0, 0.5, 0, 1), (0, 0, -1.2, 0, 1), (0, 0, 0, 0, 0.25)],
)  # fmt: skip
def test_baked_rig_equals_the_rig_where_it_was_baked(baked, pose):
    values = np.array([pose], dtype=np.float32)
    shown = baked.shapes.evaluate(baked.weights_of(values))
    np.testing.assert_allclose(shown, toy(values), atol=1e-6)


def test_baked_rig_without_correctives_misses_the_product():
    plain = bake(AT_REST, MOVES, CONTROLS).dense()
    values = np.array([[1, 1, 0, 0, 1]], dtype=np.float32)
    error = plain.shapes.evaluate(plain.weights_of(values)) - toy(values)
    assert np.abs(error).max() == pytest.approx(0.7, abs=1e-6)


def test_baked_rig_moves_to_another_mesh(baked):
    other = TriMesh(2 * NEUTRAL.vertices, NEUTRAL.faces)
    moved = baked.on(other, 0 * baked.shapes.deltas)
    assert moved.moving().shapes.names == ()


def test_a_driver_is_a_product_of_the_least_in_each_group():
    driver = Driver(((JAW,), (LIP, Half("gaze", -1))))
    values = np.array([[0.5, 0.8, -1.0, 0, 1], [0.5, 0.2, -2.0, 0, 1], [0.5, 1, 1, 0, 1]])
    np.testing.assert_allclose(driver.weight(values, CONTROLS), [0.25, 0.1, 0.0], atol=1e-7)
    in_between = Driver(((JAW,),), peak=0.25)
    values = np.array([[x, 0, 0, 0, 1] for x in (0, 0.125, 0.25, 0.625, 1)])
    np.testing.assert_allclose(in_between.weight(values, CONTROLS), [0, 0.5, 1, 0.5, 0], atol=1e-7)


def test_face_correctives_name_real_controls():
    for _, driver in face_correctives():
        pose = driver.pose(BOARD)
        assert driver.weight(pose[None], BOARD)[0] == pytest.approx(1.0)
