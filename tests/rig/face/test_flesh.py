"""Cheeks, lids and chin follow the mouth, and the teeth stand right behind the lips."""

from dataclasses import replace

import numpy as np
import pytest

from deitalk.research.contact_sheet import EMOTION_POSES, pose_values
from rig.face import IDENTITIES, build_head
from rig.face.head import LID_RAISERS
from rig.face.mesh import NO_MAPS, PLAIN
from rig.face.render import VIEWS
from rig.face.render.software import Renderer

PEOPLE = [identity.name for identity in IDENTITIES]
X, Y, Z = 0, 1, 2


@pytest.fixture(scope="module")
def sites():
    """Points of the skin on the character's left, by name, of the first head."""
    head = build_head(0)
    skin = head.skin.vertices
    mark = {name: skin[point] for name, point in head.landmarks.items()}
    eye, wing, corner = mark["eye_lower_left"], mark["nose_wing_left"], mark["mouth_corner_left"]
    places = {
        "lower lid": eye, "wing": wing, "corner": corner, "chin": mark["chin"],
        "apple": [eye[X] + 0.3, wing[Y] + 0.4, 8], "fold": [wing[X] + 0.6, wing[Y] - 0.6, 8.5],
        "cheek": [corner[X] + 1.4, corner[Y] + 1.4, 7],
        "chin groove": [0, 0.5 * (mark["lower_lip_bottom"] + mark["chin"])[Y] + 0.3, 9],
    }  # fmt: skip
    front = np.where(skin[:, Z] > 4, 0, 99)
    return {
        name: np.argsort(np.hypot(*(skin[:, :2] - place[:2]).T) + front)[:5]
        for name, place in places.items()
    }


@pytest.mark.parametrize(
    ("pose", "name", "axis", "least"),
    [
        ("*mouth_cornerPull.ty", "apple", Y, 0.3),  # zygomaticus major lifts the cheek
        ("*mouth_cornerPull.ty", "apple", Z, 0.2),  # which becomes round
        ("*mouth_cornerPull.ty", "lower lid", Y, 0.05),
        ("*eye_cheekRaise.ty", "apple", Y, 0.4),  # orbicularis oculi
        ("*mouth_cornerPull.ty", "corner", Z, -0.3),  # the mouth wraps the teeth
        ("*nose.ty", "wing", Y, 0.4),  # levator labii alaeque nasi
        ("*nose.ty", "apple", Y, 0.2),
        ("*nose.ty", "fold", Y, 0.4),
        ("*mouth_upperLipRaise.ty", "fold", Y, 0.4),  # levator labii
        ("*mouth_upperLipRaise.ty", "apple", Y, 0.2),
        ("*mouth_cornerDepress.ty", "fold", Y, -0.15),
        ("*jaw_ChinRaiseD.ty", "chin", Y, 0.4),  # mentalis
        ("CTRL_C_jaw.ty", "apple", Y, -0.1),  # a dropped jaw makes the cheeks long
        ("CTRL_C_jaw.ty", "cheek", Y, -0.3),
    ],
)
def test_flesh_goes_with_the_muscle(sites, pose, name, axis, least):
    head = build_head(0)
    moved = (head.pose(pose_values({pose: 1})) - head.mesh.vertices)[sites[name]].mean(0)
    assert np.sign(least) * moved[axis] > abs(least), moved.round(2)


def test_nasolabial_fold_is_deeper_in_a_smile(sites):
    """The apple comes forward more than the fold between it and the mouth."""
    head = build_head(0)
    moved = head.pose(pose_values({"*mouth_cornerPull.ty": 1})) - head.mesh.vertices
    assert moved[sites["apple"], Z].mean() - moved[sites["fold"], Z].mean() > 0.3


@pytest.mark.parametrize("person", PEOPLE)
def test_teeth_stand_right_behind_the_lips(person):
    """An incisor is 3 to 5 mm behind the middle of the line of the lips, half of their thickness."""
    head = build_head(person)
    rest = head.neutral
    lip = head.lip_columns(rest[None])[0][0]
    teeth = rest[head.slices["teeth_upper"]]
    edge = teeth[:, Y] < np.sort(teeth[np.abs(teeth[:, X]) < 0.5, Y])[:20].mean() + 0.5
    front = teeth[edge & (np.abs(teeth[:, X]) < 0.6), Z].max()
    assert 0.3 < lip[len(lip) // 2, Z] - front < 0.5


def _green(person, pose, view, parts):
    """A pose, its picture of 300 x 300 pixels in which only some vertices are green, its view."""
    head = build_head(person)
    points = head.pose(pose_values(pose)).astype(float)
    green = np.zeros((len(points), 3))
    green[parts, 1] = 1
    plain = np.full(len(points), PLAIN)
    mesh = replace(head.mesh, colors=green, light=np.ones(2), kind=plain, maps=NO_MAPS)
    return points, Renderer(mesh, (300, 300), VIEWS[view]).render(points).astype(int), VIEWS[view]


def _is_green(drawn):
    return drawn[..., 1] > drawn[..., [0, 2]].max(-1) + 40


def _green_teeth(person, pose, view):
    """`_green` of teeth and gums."""
    slices = build_head(person).slices
    rows = slice(slices["teeth_upper"].start, slices["teeth_lower"].stop)
    return _green(person, pose, view, rows)


MOUTHS = [*EMOTION_POSES, "rest"]


@pytest.mark.parametrize(
    ("person", "emotion"),
    [
        (person, MOUTHS[(3 * i + j) % len(MOUTHS)])
        for i, person in enumerate(PEOPLE)
        for j in range(3)
    ],
)
def test_no_tooth_comes_through_shut_lips(person, emotion):
    """In front of every tooth there is skin when the lips are together."""
    shut = {"*mouth_lipsTogetherU.ty": 1.0, "*mouth_lipsTogetherD.ty": 1.0}
    _, drawn, _ = _green_teeth(person, {**EMOTION_POSES.get(emotion, {}), **shut}, "mouth")
    assert _is_green(drawn).sum() <= 2


@pytest.mark.parametrize("person", PEOPLE)
def test_no_tooth_or_gum_comes_through_the_chin_of_a_dropped_jaw(person):
    """Below the lower lip a wide open mouth shows skin alone."""
    pose, drawn, view = _green_teeth(person, {"CTRL_C_jaw.ty": 1.0}, "face")
    bottom = np.append(pose[build_head(person).landmarks["lower_lip_bottom"]], 1)
    _, y, _, far = view.matrix(1) @ bottom
    chin = drawn[int(150 * (1 - y / far)) :]
    assert drawn[..., 1].max() > 200  # teeth are seen
    assert not _is_green(chin).any()


@pytest.mark.parametrize("person", PEOPLE)
def test_upper_lip_of_a_smile_is_thinner_and_keeps_its_bow(person):
    """Zygomaticus major stretches the lip over the teeth; its line hangs between the corners."""
    head = build_head(person)
    rest, smile = head.neutral, head.pose(pose_values({"*mouth_cornerPull.ty": 0.9}))
    top, rim = head.landmarks["upper_lip_top"], head.landmarks["upper_rim"]
    assert (smile[top] - smile[rim])[Y] < 0.9 * (rest[top] - rest[rim])[Y]
    skin = rest[head.slices["skin"]]
    row = (np.abs(skin[:, Y] - rest[top, Y]) < 0.12) & (skin[:, Z] > rest[top, Z] - 0.8)
    peaks = np.flatnonzero(row & (np.abs(np.abs(skin[:, X]) - 0.55) < 0.15))
    bow, at_rest = ((x[peaks, Y].mean() - x[top, Y]) for x in (smile, rest))
    assert bow > at_rest - 0.01
    upper, _ = head.lip_columns(smile[None])
    assert upper[0, [0, -1], Y].mean() > upper[0, len(upper[0]) // 2, Y] + 0.3


def _lips(person, pose, places):
    """Height of both lips (2, P) at shares of the way from the middle to the left corner, cm."""
    head = build_head(person)
    points = head.pose(pose_values(pose))
    corner = points[head.landmarks["mouth_corner_left"]]
    upper, lower = head.lip_columns(points[None])
    return [np.interp(corner[X] * np.array(places), c[0, :, X], c[0, :, Y]) for c in (upper, lower)]


@pytest.mark.parametrize("person", PEOPLE)
def test_open_smile_is_a_crescent_that_closes_before_its_corners(person):
    """Both lips rise from the middle to the corner, the lower one more."""
    upper, lower = _lips(person, EMOTION_POSES["happy"], (0, 0.4, 0.7))
    assert (np.diff(upper) > 0.03).all() and (np.diff(lower) > 0.05).all()
    gap = upper - lower
    assert 0.3 < gap[0] and gap[2] < 0.5 * gap[0]


@pytest.mark.parametrize("person", PEOPLE)
def test_snarl_is_square(person):
    """Levator labii alaeque nasi raises the lip over the canine more than in the middle."""
    middle, canine, side = _lips(person, EMOTION_POSES["angry"], (0, 0.45, 0.9))[0]
    assert canine > middle + 0.08 and canine > side + 0.2


@pytest.mark.parametrize("person", PEOPLE)
def test_corner_of_a_smile_goes_as_far_aside_as_it_rises_over_the_middle(person):
    """Zygomaticus major pulls to the cheek bone, aslant: a corner that rises more is a joker's."""
    head = build_head(person)
    moved = head.pose(pose_values({"*mouth_cornerPull.ty": 1})) - head.neutral
    corner, middle = (moved[head.landmarks[n]] for n in ("mouth_corner_left", "upper_rim"))
    rise = corner[Y] - middle[Y]
    assert 0.7 * corner[X] < rise < 1.1 * corner[X]


@pytest.mark.parametrize("person", PEOPLE)
def test_snarl_bares_lit_teeth_and_gum(person):
    """Gum is seen over the teeth, and these are nearly as light as the skin around the mouth."""
    head = build_head(person)
    row, atlas = head.slices["teeth_upper"], head.mesh.maps.atlas
    place = (head.mesh.uv[row] * len(atlas)).astype(int)
    red, green, _ = atlas[tuple(place.T[::-1])][:, :3].astype(float).T
    gum, tooth = (row.start + np.flatnonzero(k) for k in (red > 1.3 * green, red < 1.2 * green))
    pose = EMOTION_POSES["angry"]
    assert _is_green(_green(person, pose, "mouth", gum)[1]).sum() > 20
    points, drawn, view = _green(person, pose, "mouth", tooth)
    skin = _green(person, pose, "mouth", head.slices["skin"])[1]
    seen = Renderer(head.mesh, (300, 300), view).render(points).mean(-1)
    assert np.median(seen[_is_green(drawn)]) > 0.9 * np.median(seen[_is_green(skin)])


@pytest.mark.parametrize("person", PEOPLE)
def test_tongue_lies_before_the_lower_teeth_of_a_surprised_mouth(person):
    """From the front the sides of the lower row are hidden behind the tongue."""
    slices = build_head(person).slices
    tongue, row = (
        _is_green(_green(person, EMOTION_POSES["surprised"], "mouth", slices[part])[1]).sum()
        for part in ("tongue", "teeth_lower")
    )
    assert tongue > 20 * row


@pytest.mark.parametrize("person", PEOPLE)
def test_lower_teeth_hide_in_a_surprised_mouth(person):
    """The incisors' edges are at most 1 mm over the lower lip's."""
    head = build_head(person)
    points = head.pose(pose_values(EMOTION_POSES["surprised"]))
    lip = head.lip_columns(points[None])[1][0]
    row = points[head.slices["teeth_lower"]]
    edge = row[np.abs(row[:, X]) < 0.5, Y].max()
    assert edge < lip[len(lip) // 2, Y] + 0.1


@pytest.mark.parametrize("person", PEOPLE)
@pytest.mark.parametrize("raiser", LID_RAISERS)
def test_lids_meet_in_a_blink_whatever_raises_the_lower_one(person, raiser):
    """The middle of both lids is one line, 0.6 mm, and not one beyond the other."""
    head = build_head(person)
    both = [head.landmarks[f"eye_{lid}_left"] for lid in ("upper", "lower")]
    pose = head.pose(pose_values({"*eye_blink.ty": 1, f"*{raiser}.ty": 1}))
    assert abs(np.subtract(*pose[both, Y])) < 0.06


@pytest.mark.parametrize("person", PEOPLE)
def test_a_broad_smile_narrows_the_eyes_from_below_and_leaves_them_open(person):
    """By 2 to 4 mm, as lower lids of people in a Duchenne smile; the outer brow comes down a little.

    Lids that rose 7 mm hid the iris before the cheek was seen to rise.
    """
    head = build_head(person)
    smile = {"*mouth_cornerPull.ty": 1, "*eye_cheekRaise.ty": 1, "*eye_squintInner.ty": 0.5}
    moved = head.pose(pose_values(smile)) - head.neutral
    up, low = (head.landmarks[f"eye_{lid}_left"] for lid in ("upper", "lower"))
    assert 0.2 < moved[low, Y] < 0.42 and abs(moved[up, Y]) < 0.1
    assert np.subtract(*(head.neutral + moved)[[up, low], Y]) > 0.5  # cm
    brow = head.slices["brow_L"]
    outer = head.neutral[brow, X] > np.quantile(head.neutral[brow, X], 2 / 3)
    assert -0.25 < moved[brow, Y][outer].mean() < -0.02


@pytest.mark.parametrize("person", PEOPLE)
def test_lids_at_rest_cover_the_edge_of_the_iris_and_show_no_white_above(person):
    """The upper lid lies 1 to 4 mm below the top of an iris of 12 mm, the lower at its edge."""
    head = build_head(person)
    up, low = (head.neutral[head.landmarks[f"eye_{lid}_left"], Y] for lid in ("upper", "lower"))
    middle, radius = head.eyes[0, Y], 0.6 * head.eyes[0, 3] / 1.51
    assert 0.1 < middle + radius - up < 0.4
    assert abs(middle - radius - low) < 0.1
