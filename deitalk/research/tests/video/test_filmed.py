"""Landmarks of a head whose curves are known: the curves, the turn of the head and the gaps return."""

import numpy as np
import pytest
import torch

from deitalk.research.tests.filmed_head import SIZE, filmed_mesh
from deitalk.research.video.filmed import filmed_curves
from deitalk.research.video.head_face import MEASURES, SIDES, HeadFace
from deitalk.research.video.landmarks import FaceTrack, pixels
from deitalk.research.video.proportions import measure
from deitalk.research.video.straighten import straightened
from rig import default_controls
from rig.face.head import build_head

CONTROLS = default_controls()
JAW = "CTRL_C_jaw.ty"
N_FRAMES = 90
TIMES = np.arange(N_FRAMES) / 30


def put(values: np.ndarray, part: str, track: np.ndarray) -> None:
    """Move every control with a part of a name."""
    for place, name in enumerate(CONTROLS.names):
        if part in name:
            values[:, place] = track


def planted() -> tuple[np.ndarray, np.ndarray]:
    """Curves of two open vowels, a smile, raised brows, two blinks; a turning head."""
    values = np.tile(np.asarray(CONTROLS.rest, np.float64), (N_FRAMES, 1))
    bump = lambda at, width: np.exp(-(((TIMES - at) / width) ** 2))  # noqa: E731
    put(values, JAW, 0.5 * bump(1.0, 0.15) + 0.3 * bump(2.4, 0.15))
    put(values, "mouth_cornerPull", 0.6 * bump(1.7, 0.15))
    put(values, "brow_raise", 0.7 * bump(2.0, 0.2))
    put(values, "eye_blink", bump(0.6, 0.06) + bump(1.5, 0.06))
    head = np.zeros((N_FRAMES, 6))
    head[:, :3] = np.stack([12 * np.sin(2 * TIMES), 6 * np.sin(3 * TIMES), 4 * np.sin(TIMES)], 1)
    return values, head


def track_of(mesh: np.ndarray) -> FaceTrack:
    return FaceTrack(pixels(mesh, SIZE), TIMES[: len(mesh)])


@pytest.fixture(scope="module")
def filmed():
    values, head = planted()
    return filmed_curves(track_of(filmed_mesh(build_head(2), values, head)), "talk.mp4")


def r(a, b) -> float:
    return float(np.corrcoef(a, b)[0, 1])


@pytest.mark.parametrize(
    ("name", "least"),
    [
        (JAW, 0.97),
        ("CTRL_L_mouth_cornerPull.ty", 0.95),
        ("CTRL_R_brow_raiseIn.ty", 0.94),
        ("CTRL_L_brow_raiseOut.ty", 0.94),
        ("CTRL_R_eye_blink.ty", 0.97),
    ],
)
def test_planted_curves_return_from_landmarks_of_another_head(filmed, name, least):
    truth = planted()[0][:, CONTROLS.index(name)]
    found = filmed.curves[name]
    assert r(found, truth) >= least
    assert found.max() == pytest.approx(truth.max(), abs=0.36)


def test_turn_of_the_head_returns_in_degrees(filmed):
    wanted = planted()[1][:, :3]
    wanted = wanted - np.median(wanted, axis=0)
    np.testing.assert_allclose(filmed.curves.head[:, :3], wanted, atol=0.85)
    assert not filmed.curves.head[:, 3:].any()


def test_controls_that_landmarks_cannot_show_rest_and_are_not_known(filmed):
    hidden = [n for n in CONTROLS.names if n not in filmed.known]
    rest = np.asarray(CONTROLS.rest)[[CONTROLS.index(n) for n in hidden]]
    np.testing.assert_allclose([filmed.curves[n][0] for n in hidden], rest, atol=1e-6)
    parts = ("tongue", "teeth", "lipBite", "cheek", "nose", "neck", "suckBlow")
    assert all(any(p in n for n in hidden) for p in parts)
    assert not any(p in n for n in filmed.known for p in parts)


def test_gaze_to_the_left_is_positive_and_shut_eyes_keep_it():
    values = np.tile(np.asarray(CONTROLS.rest, np.float64), (N_FRAMES, 1))
    side = np.where(TIMES < 1.5, 0.4, -0.4)
    put(values, "_eye.tx", side)
    values[:, CONTROLS.index("CTRL_C_eye.tx")] = 0
    shut = (TIMES > 0.7) & (TIMES < 0.9)
    put(values, "eye_blink", shut.astype(float))
    mesh = filmed_mesh(build_head(), values)
    mesh[shut, 468:] += 0.1  # an iris behind a lid is guessed
    found = filmed_curves(track_of(mesh), "a.npz").curves["CTRL_L_eye.tx"]
    np.testing.assert_allclose(found, side, atol=0.06)


def test_size_place_and_roll_of_the_picture_change_no_measure():
    values, head = planted()
    mesh = filmed_mesh(build_head(1), values, head)
    face, seen = HeadFace(build_head()), np.ones(N_FRAMES, bool)
    whole = track_of(mesh)
    angle = np.radians(8)
    turn = np.array(
        [[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    other = FaceTrack((0.4 * whole.points @ turn + [300, -20, 0]).astype(np.float32), whole.times)
    one, two = (measure(straightened(t, seen)[0], seen, face) for t in (whole, other))
    np.testing.assert_allclose(one.displacements, two.displacements, atol=6e-3)
    np.testing.assert_allclose(one.gaze, two.gaze, atol=2e-3)


def test_measures_are_those_of_the_posed_mesh():
    head = build_head(2)
    face, marks = HeadFace(head), head.landmarks
    rng = np.random.default_rng(0)
    used = [i for i, n in enumerate(CONTROLS.names) if any(p in n for p in ("eye", "brow", "jaw."))]
    values = np.tile(np.asarray(CONTROLS.rest, np.float64), (20, 1))
    values[:, used] += rng.uniform(-1, 1, (20, len(used))) * (rng.random((20, len(used))) < 0.3)
    values = np.clip(values, CONTROLS.minimum, CONTROLS.maximum)
    found = face(torch.tensor(values).float()).numpy()
    poses = head.pose(values)
    for side, word in zip(SIDES, ("left", "right"), strict=True):
        upper, lower = (poses[:, marks[f"eye_{lid}_{word}"], 1] for lid in ("upper", "lower"))
        np.testing.assert_allclose(
            found[:, MEASURES.index(f"lid_{side}")], upper - lower, atol=1e-4
        )
        np.testing.assert_allclose(found[:, MEASURES.index(f"lower_lid_{side}")], lower, atol=1e-4)
        corner = poses[:, marks[f"mouth_corner_{word}"]] - poses[:, marks["nose_base"]]
        out = np.abs(corner[:, 0])
        np.testing.assert_allclose(found[:, MEASURES.index(f"corner_out_{side}")], out, atol=0.02)
