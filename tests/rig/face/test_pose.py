"""Poses of the head: contact laws that hold for any controls, and the jaw's and eyes' geometry."""

import time

import numpy as np
import pytest

from deitalk.research.contact_sheet import EMOTION_POSES, MOUTH_POSES, pose_values
from rig import default_controls
from rig.errors import RigError
from rig.face import build_head
from rig.face.geometry import details
from rig.face.geometry.details import IRIS_DEGREES
from rig.face.geometry.topology import EYE_L, EYE_R, MOUTH, MOUTH_COUNT
from rig.face.head import GAZE_DEGREES
from tests.each import each

CONTROLS = default_controls()
SHEET = np.stack([pose_values(p) for p in (*MOUTH_POSES.values(), *EMOTION_POSES.values())])


@pytest.fixture(scope="module")
def head():
    return build_head(0)


def random_values(count: int, seed: int, share: float = 1.0) -> np.ndarray:
    """Random controls over their whole ranges; each is at rest with probability 1 - share."""
    rng = np.random.default_rng(seed)
    full = CONTROLS.minimum + (CONTROLS.maximum - CONTROLS.minimum) * rng.random((count, 185))
    return np.where(rng.random((count, 185)) < share, full, CONTROLS.rest)


def skin_of(head, vertices: np.ndarray) -> np.ndarray:
    return vertices[..., head.slices["skin"], :]


def rim_gaps(head, vertices: np.ndarray) -> np.ndarray:
    """Lower minus upper rim (T, n, 3), cm."""
    rim = head.features.loop(MOUTH, 0)
    upper = np.arange(1, MOUTH_COUNT // 2)
    skin = skin_of(head, vertices)
    return skin[:, rim[MOUTH_COUNT - upper]] - skin[:, rim[upper]]


def rim_middles(head, pose: dict[str, float]) -> np.ndarray:
    """Upper and lower rim in the middle of the lips: (2, 3), y and z from where they meet."""
    rim = head.features.loop(MOUTH, 0)
    middle = head.pose(pose_values(pose))[rim[[13, 39]]].astype(float)
    return middle - [0, head.features.anatomy.mouth_y, head._lip_z]


@each(
    "name",
    ["brow_down", "brow_raiseIn", "brow_raiseOut", "eye_cheekRaise", "eye_squintInner",
     "eye_faceScrunch", "eye_lidPress", "jaw_clench"],
)  # fmt: skip
def test_controls_of_eyes_and_jaw_angle_do_not_move_the_lips(head, name):
    red = np.flatnonzero((head.features.kind == MOUTH) & (head.features.ring <= 3))
    moved = head.pose(pose_values({f"*{name}.ty": 1})) - head.mesh.vertices
    assert np.abs(moved[red]).max() < 1e-4
    assert np.abs(moved).max() > 0.1


@each("name", ["purse", "funnel", "lipBite", "press", "lipsRoll"])
def test_lip_controls_do_not_move_the_tip_of_the_nose(head, name):
    tip = np.argmax(head.skin.vertices[:, 2])
    pose = {f"CTRL_{side}_mouth_{name}{lip}.ty": 1 for side in "LR" for lip in "UD"}
    moved = head.pose(pose_values(pose)) - head.mesh.vertices
    assert np.linalg.norm(moved[tip]) < 0.01  # 0.1 mm
    assert np.abs(skin_of(head, moved)).max() > 0.1


@each("name", ["cornerPull", "sharpCornerPull", "stretch", "cornerDepress"])
def test_smile_and_frown_alone_keep_the_lips_closed(head, name):
    gaps = rim_gaps(head, head.pose(pose_values({f"*mouth_{name}.ty": 1})[None]))
    assert np.linalg.norm(gaps, axis=-1).max() < 0.05


def test_upper_teeth_rest_on_the_lower_lip_for_f_and_stand_clear_of_it_for_m(head):
    upper, lower = rim_middles(head, MOUTH_POSES["F V"])
    assert lower[1] == pytest.approx(details.UPPER_EDGE, abs=0.08)
    assert lower[2] == pytest.approx(-details.UPPER_BACK, abs=0.2)  # under them, not before them
    assert upper[1] > details.UPPER_EDGE + 0.25  # and the teeth show
    closed = rim_middles(head, MOUTH_POSES["M B P"])
    assert closed[1, 2] > lower[2] + 0.2


def test_pursed_upper_lip_covers_its_teeth(head):
    upper, lower = rim_middles(head, MOUTH_POSES["UW (you)"])
    assert upper[1] < details.UPPER_EDGE + 0.05
    assert lower[1] < upper[1]
    assert upper[2] > 0.7  # and stands out


def test_rest_pose_is_the_neutral_head(head):
    assert np.abs(head.pose(CONTROLS.rest) - head.mesh.vertices).max() < 1e-5


@each("share", [0.15, 1.0])
def test_seal_closes_the_lips_in_any_pose(head, share):
    values = random_values(60, 1, share)
    for name in CONTROLS.names:
        if "lipsTogether" in name:
            values[:, CONTROLS.index(name)] = 1
    gaps = rim_gaps(head, head.pose(values))
    assert np.linalg.norm(gaps, axis=-1).max() < 0.02  # 0.2 mm


def test_open_jaw_without_seal_opens_the_lips(head):
    gaps = rim_gaps(head, head.pose(pose_values({"CTRL_C_jaw.ty": 1})[None]))
    assert np.linalg.norm(gaps, axis=-1).max() > 2.0


def test_lips_never_pass_through_each_other(head):
    gaps = rim_gaps(head, head.pose(random_values(100, 2, 0.4)))
    assert gaps[..., 1].max() < 1e-3


@pytest.mark.parametrize(
    "number", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (3, 5, 10))]
)
def test_no_lid_enters_its_eyeball(number):
    head = build_head(number)
    skin = skin_of(head, head.pose(np.concatenate([SHEET, random_values(60, 3)])))
    for kind, side in ((EYE_L, 1), (EYE_R, -1)):
        away = skin[:, head.features.kind == kind] - head.features.anatomy.eye * [side, 1, 1]
        assert np.linalg.norm(away, axis=-1).min() > head.features.anatomy.eye_radius


def test_blink_closes_both_lids_exactly_and_half_blink_half(head):
    t = head.features.loop(EYE_L, 0)
    count = len(t)
    upper = np.arange(1, count // 2)

    def gap(amount):
        skin = skin_of(head, head.pose(pose_values({"*eye_blink.ty": amount})))
        return np.linalg.norm(skin[t[upper]] - skin[t[count - upper]], axis=1)

    assert gap(1.0).max() < 0.02
    assert 0.3 < gap(0.5).max() / gap(0.0).max() < 0.7


@each("number", [0, 1, 3])
def test_lids_at_rest_cover_the_rim_of_the_iris_above_and_touch_it_below(number):
    """1 to 3 mm above (Farkas 1994); below, the sclera shows by less than 1 mm."""
    place, skin = build_head(number).features.anatomy, build_head(number).features
    rim = skin.vertices[skin.loop(EYE_L, 0)] - place.eye
    angle = np.degrees(np.arctan2(rim[:, 1], rim[:, 2]))
    mm = 10 * place.eye_radius * np.pi / 180  # on the eyeball, a degree
    assert 1 < mm * (IRIS_DEGREES - angle[len(angle) // 4]) < 3
    assert mm * (-IRIS_DEGREES - angle[3 * len(angle) // 4]) < 1


def test_profile_has_a_fold_between_the_lower_lip_and_the_chin(head):
    x, y, z = head.skin.vertices.T
    line = (np.abs(x) < 1e-6) & (z > 7) & (y < head.features.anatomy.mouth_y - 0.2)
    y, z = y[line], z[line]
    fold = np.argmin(np.where((y > -9.2) & (y < -8.2), z, np.inf))
    assert z[y > y[fold]].max() > z[fold] + 0.4  # 4 mm behind the lip
    assert z[y < y[fold]].max() > z[fold] + 0.3


@each("look", [-1.0, -0.5, 0.5, 1.0])
def test_lids_follow_the_gaze(head, look):
    """The iris stays in sight, and the upper lid near its upper edge, wherever the eye looks."""
    rim = skin_of(head, head.pose(pose_values({"CTRL_C_eye.ty": look})))
    rim = rim[head.features.loop(EYE_L, 0)] - head.features.anatomy.eye
    angle = np.degrees(np.arctan2(rim[:, 1], rim[:, 2]))
    upper, lower = angle[len(angle) // 4], angle[3 * len(angle) // 4]
    middle = look * GAZE_DEGREES["up" if look > 0 else "down"]
    assert abs(upper - (middle + IRIS_DEGREES)) < 18
    assert min(upper, middle + IRIS_DEGREES) - max(lower, middle - IRIS_DEGREES) > 15


def outer_surface(head) -> np.ndarray:
    """Faces of the skin seen from outside, with the lips' slit closed by a strip."""
    features = head.features
    inner = (features.kind == MOUTH) & (features.ring < 0)
    faces = features.faces[~inner[features.faces].any(1)]
    rim = features.loop(MOUTH, 0)
    half = MOUTH_COUNT // 2
    strip = []
    for k in range(half):
        a, b = rim[k], rim[k + 1]
        c, d = rim[-k % MOUTH_COUNT], rim[-(k + 1) % MOUTH_COUNT]
        strip += [f for f in ([a, b, c], [c, b, d]) if len(set(f)) == 3]
    return np.concatenate([faces, strip])


def winding_number(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How often the surface winds around each point (1 inside, 0 outside); van Oosterom's angle."""
    a, b, c = (vertices[faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    top = np.einsum("nfc,nfc->nf", a, np.cross(b, c))
    bottom = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(top, bottom).sum(1) / (2 * np.pi)


def test_winding_number_is_one_inside_and_zero_outside(head):
    faces = outer_surface(head)
    points = np.array([[0, 2.0, 0], [0, -7.1, 7.5], [0, -7.1, 11.0], [12.0, 0, 0]])
    inside = winding_number(points, head.skin.vertices, faces) > 0.5
    assert inside.tolist() == [True, True, False, False]


@pytest.mark.slow
def test_no_tooth_pokes_through_skin_or_lips(head):
    faces = outer_surface(head)
    poses = head.pose(np.concatenate([SHEET, random_values(24, 4, 0.15), random_values(8, 5)]))
    for pose in poses:
        front = np.concatenate([pose[head.slices[k]][::29] for k in ("teeth_upper", "teeth_lower")])
        front = front[front[:, 2] > 5.5].astype(float)
        assert winding_number(front, skin_of(head, pose).astype(float), faces).min() > 0.5


def test_front_teeth_stay_inside_for_the_mouth_sheet(head):
    faces = outer_surface(head)
    for pose in head.pose(SHEET[1:9]):
        points = np.concatenate(
            [pose[head.slices[k]][::97] for k in ("teeth_upper", "teeth_lower")]
        )
        points = points[points[:, 2] > 7.5].astype(float)
        assert winding_number(points, skin_of(head, pose).astype(float), faces).min() > 0.5


def test_jaw_is_a_rotation(head):
    part = head.slices["teeth_lower"]
    before = head.mesh.vertices[part]
    after = head.pose(pose_values({"CTRL_C_jaw.ty": 1}))[part].astype(float)
    a, b = before - before.mean(0), after - after.mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    rotation = u @ vt
    assert np.abs(a @ rotation - b).max() < 1e-4  # rigid
    angle = np.degrees(np.arccos((np.trace(rotation) - 1) / 2))
    assert angle == pytest.approx(19.0, abs=0.01)


def test_upper_teeth_do_not_follow_the_jaw(head):
    part = head.slices["teeth_upper"]
    opened = head.pose(pose_values({"CTRL_C_jaw.ty": 1, "CTRL_C_jaw.tx": 1}))
    assert np.abs(opened[part] - head.mesh.vertices[part]).max() < 1e-5


def test_eyes_turn_by_the_boards_angles(head):
    def aim(pose, name):
        part = head.pose(pose_values(pose))[head.slices[name]].astype(float)
        axis = part[0] - part.mean(0)  # the pupil's centre is the first vertex
        center = head.features.anatomy.eye * [1 if name == "eye_L" else -1, 1, 1]
        axis = part[:40].mean(0) - center
        return axis / np.linalg.norm(axis)

    rest = aim({}, "eye_L")
    left, up = aim({"CTRL_L_eye.tx": 1}, "eye_L"), aim({"CTRL_L_eye.ty": 1}, "eye_L")
    assert left[0] > rest[0] and up[1] > rest[1]
    assert np.degrees(np.arccos(left @ rest)) == pytest.approx(40, abs=0.1)
    assert np.degrees(np.arccos(up @ rest)) == pytest.approx(30, abs=0.1)


def test_tongue_tip_touches_the_ridge_for_l_and_n(head):
    pose = head.pose(pose_values(MOUTH_POSES["L N T D"]))
    tongue, upper = pose[head.slices["tongue"]], pose[head.slices["teeth_upper"]]
    edge = head.features.anatomy.mouth_y + details.UPPER_EDGE
    tip = tongue[: 3 * details.TONGUE_COLUMNS]
    assert tip[:, 1].max() > edge  # above the biting edge,
    assert tip[:, 2].max() < upper[:, 2].max() - 0.2  # behind the front teeth


def test_tongue_goes_between_the_teeth_for_th(head):
    pose = head.pose(pose_values(MOUTH_POSES["TH (thin)"]))
    tongue = pose[head.slices["tongue"]]
    upper, lower = pose[head.slices["teeth_upper"]], pose[head.slices["teeth_lower"]]
    incisors = np.abs(upper[:, 0]) < 0.4
    assert tongue[:, 2].max() > upper[incisors, 2].max()
    outside = tongue[tongue[:, 2] > upper[incisors, 2].max() - 0.1]
    assert outside[:, 1].max() <= upper[incisors, 1].min() + 0.03
    front = lower[(np.abs(lower[:, 0]) < 0.4) & (lower[:, 2] > 7)]
    assert outside[:, 1].min() >= front[:, 1].max() - 0.1


@each("name", ["AA (father)", "SH CH", "OW (go)"])
def test_open_mouth_shows_the_lower_incisors_before_a_lower_tongue(head, name):
    pose = head.pose(pose_values(MOUTH_POSES[name]))
    lower, tongue = pose[head.slices["teeth_lower"]], pose[head.slices["tongue"]]
    edge = lower[(np.abs(lower[:, 0]) < 0.4) & (lower[:, 2] > lower[:, 2].max() - 0.6), 1].max()
    lip = pose[head._rim_middle[1], 1]
    assert edge > lip  # in sight over the lip
    front = tongue[tongue[:, 2] > tongue[:, 2].max() - 0.6]
    assert front[:, 1].max() < edge  # the tip lies behind the teeth and below their edge


def test_closed_jaw_keeps_the_tongue_behind_the_teeth(head):
    pose = head.pose(pose_values({"CTRL_C_tongue_inOut.ty": -1}))
    tongue, upper = pose[head.slices["tongue"]], pose[head.slices["teeth_upper"]]
    assert tongue[:, 2].max() < upper[:, 2].max() - 0.3


def test_frames_together_equal_frames_alone(head):
    values = random_values(5, 6)
    together = head.pose(values)
    alone = np.stack([head.pose(v) for v in values])
    assert np.abs(together - alone).max() < 1e-4


def test_mirrored_controls_give_a_mirrored_face(head):
    values = random_values(4, 7, 0.3)
    flipped = values[:, CONTROLS.mirror_index] * CONTROLS.mirror_sign
    a = skin_of(head, head.pose(values))
    b = skin_of(head, head.pose(flipped))[:, head.features.mirror] * [-1, 1, 1]
    assert np.abs(a - b).max() < 2e-3


def test_nose_wrinkle_upper_scales_the_wrinkle(head):
    wrinkled = {"*nose.ty": 1.0}
    full = head.pose(pose_values(wrinkled))
    less = head.pose(pose_values({**wrinkled, "*nose_wrinkleUpper.ty": 0.0}))
    still = head.pose(pose_values({"*nose_wrinkleUpper.ty": 0.0}))
    assert np.abs(full - less).max() > 0.1
    assert np.abs(still - head.mesh.vertices).max() < 1e-5


def test_a_frame_takes_milliseconds(head):
    values = random_values(64, 8)
    head.pose(values)
    best = np.inf
    for _ in range(3):
        start = time.process_time()
        head.pose(values)
        best = min(best, (time.process_time() - start) / len(values))
    assert best < 10e-3


@each(
    ("values", "message"),
    [
        (np.zeros(184), r"shape \(184,\)"),
        (np.zeros((2, 3, 185)), r"needs \(T, 185\)"),
        (np.full(185, np.nan), "finite"),
    ],
)
def test_pose_rejects_invalid_values(head, values, message):
    with pytest.raises(RigError, match=message):
        head.pose(values)


def test_pose_values_rejects_unknown_controls():
    with pytest.raises(RigError, match="CTRL_L_nothing"):
        pose_values({"*nothing.ty": 1})
