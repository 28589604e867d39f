"""What a head looks like beside its shape: accents, baked light, maps, textures."""

import numpy as np
import pytest

from deitalk.research.contact_sheet import pose_values
from rig.face import build_head
from rig.face.accents import SHADOW, accents
from rig.face.geometry.mesh import Mesh, join
from rig.face.geometry.skin import skin_uv
from rig.face.maps import LEAST_AMBIENT, build_maps, occlusion
from rig.face.render.shading import TO_LIGHT
from tests.each import each


@pytest.fixture(scope="module")
def head():
    return build_head(0)


def accented(head, pose: dict[str, float]) -> np.ndarray:
    values = pose_values(pose)[None]
    return accents(head, values, head.pose(values))[0]


@each(
    ("control", "center"),
    [
        ("brow_raiseOut.ty", (2.5, 5.0)),
        ("brow_down.ty", (0.6, 1.5)),
        ("eye_cheekRaise.ty", (5.0, 0.0)),
        ("mouth_cornerPull.ty", (2.6, -5.5)),
    ],
)
def test_creases_deepen_where_the_control_of_their_side_folds_the_skin(head, control, center):
    deeper = accented(head, {f"CTRL_L_{control}": 1}) - accented(head, {})
    x, y, z = head.skin.vertices.T
    at = [np.argmin(np.hypot(x - s * center[0], y - center[1]) - (z > 4)) for s in (1, -1)]
    left, right = deeper[head.slices["skin"]][at]
    assert left > 0.2
    assert right < 0.5 * left
    chin = np.argmin(np.hypot(x, y + 10) - (z > 4))
    assert deeper[head.slices["skin"]][chin] == 0


def test_the_upper_lid_shades_the_eye_below_it(head):
    part = head.slices["eye_L"]
    for pose in ({}, {"*eye_blink.ty": -1}):
        values = pose_values(pose)[None]
        ball = head.pose(values)[0, part] - head.features.anatomy.eye
        shadow = accented(head, pose)[part]
        front = (ball[:, 2] > 0.5 * ball[:, 2].max()) & (np.abs(ball[:, 0]) < 0.3)
        order = np.argsort(ball[front, 1])
        assert (np.diff(shadow[front][order]) > -0.06).all()  # darker upwards
        assert shadow[front].max() > 0.8 * SHADOW
    assert shadow[front][order[0]] == 0


def plate(y: float, half: float, up: float) -> Mesh:
    corner = half * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) + [0, y, 0]
    faces = np.array([[0, 2, 1], [0, 3, 2]]) if up > 0 else np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(corner.astype(float), faces, np.ones((4, 3)), np.zeros(4))


def test_a_roof_keeps_ambient_and_first_light_from_what_lies_under_it():
    small, roof = plate(-10, 0.5, 1), join([plate(-8.5, 9, 1), plate(-8.6, 9, -1)])
    free, covered = occlusion(small), occlusion(join([small, roof]))
    assert np.allclose(free, 1, atol=1e-3)
    assert TO_LIGHT[0, 1] > 0  # the first light is above
    assert np.allclose(covered[:4, 1], 0)
    assert (covered[:4, 0] < LEAST_AMBIENT + 0.25).all()
    assert np.allclose(covered[4:8], 1, atol=1e-3)


def test_maps_are_the_same_each_time_and_stubble_is_the_beards():
    made = {}
    for name in ("Bruno", "Dana"):
        head = build_head(name)
        uv = skin_uv(head.features)
        maps = head.mesh.maps
        x, y, z = head.skin.vertices.T
        chin = (y < head.features.anatomy.mouth_y - 2) & (y > -11) & (np.abs(x) < 2) & (z > 4)
        u, v = (1024 * uv[chin & (head.features.ring >= 0)].T).astype(int)
        made[name] = maps.atlas[v, u].mean()
    again = build_maps(head.features, uv, head.identity)
    pairs = zip(vars(maps).values(), vars(again).values(), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)
    assert made["Bruno"] < 0.9 * made["Dana"]
    assert made["Dana"] == pytest.approx(127.5, rel=0.05)
