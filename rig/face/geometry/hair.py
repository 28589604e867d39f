"""Hair: locks over a dark cap, and brows of single hairs."""

from collections.abc import Callable

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import HAIR, STRANDS_UV, Mesh, cast, grid_faces, join, smoothstep, unit
from rig.face.geometry.skin import direction_points
from rig.face.identity import Identity

_COLUMNS, _ROWS = 112, 18
HAIR_AXIS = np.array([0.0, 2.2, -0.9])
CAP_SHARE, CAP_BACK_DEGREES = 0.45, 4.5
"""The cap's thickness as a share of the hair's, and how far it keeps from the hairline."""
LOCKS, WISPS, STEPS = 540, 150, 7
CAP_FOLDS = 14
"""Times that the cap shows the strands of the maps, to and fro, around the head."""
HANGS_BELOW_CM = -4.0


def _hairline(turn: Float64) -> Float64:
    """Elevation (degrees, from `HAIR_AXIS`) of the hair's edge at each turn (0 front, pi back)."""
    around = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)
    stops = np.radians([0, 18, 34, 46, 56, 66, 74, 80, 88, 96, 104, 112, 122, 140, 180])
    edge = [27, 28, 27, 19, 5, -10, -17, -17, 4, 7, 0, -17, -34, -42, -44]
    uneven = np.sin(11 * turn + 0.6) + 0.8 * np.sin(23 * turn) + 0.6 * np.sin(41 * turn + 2)
    return np.interp(around, stops, edge) + 0.9 * uneven * smoothstep((1.6 - around) / 0.4)


def hair(identity: Identity) -> Mesh:
    """Locks that follow how the hair is combed, over a cap that hides the scalp."""
    return join([_cap(identity), _locks(identity)])


def _cap(identity: Identity) -> Mesh:
    """A shell from the hairline to the crown."""
    turn = np.arange(_COLUMNS) / _COLUMNS * 2 * np.pi
    edge = np.radians(_hairline(turn) + CAP_BACK_DEGREES)
    rise = np.linspace(0, 1, _ROWS) ** 1.15
    elevation = edge[None] + rise[:, None] * (np.pi / 2 - 0.012 - edge[None])
    direction = np.stack(
        [np.cos(elevation) * np.sin(turn), np.sin(elevation), np.cos(elevation) * np.cos(turn)], -1
    )
    on_skin = cast(HAIR_AXIS, direction.reshape(-1, 3), identity).reshape(_ROWS, _COLUMNS, 3)
    thick = CAP_SHARE * _thickness(rise[:, None], turn[None], elevation, identity)
    shell = on_skin + thick[..., None] * direction
    hem = on_skin[0] - 0.25 * direction[0]
    vertices = np.concatenate([hem[None], shell])
    faces = grid_faces(len(vertices), _COLUMNS)[:, ::-1]
    flat = vertices.reshape(-1, 3)
    strand = 1 + 0.13 * np.sin(turn * 28) * np.sin(turn * 11 + 1.0)
    colors = 0.78 * np.array(identity.hair) * np.tile(strand, len(vertices))[:, None]
    u0, v0, wide = STRANDS_UV
    across = np.abs((turn / np.pi * CAP_FOLDS) % 2 - 1)
    along = np.concatenate([[0], rise])[:, None]
    uv = np.stack(np.broadcast_arrays(u0 + wide * across, v0 + wide * along), -1)
    return Mesh(
        flat, faces[:, ::-1], np.clip(colors, 0, 1), np.full(len(flat), 0.3), uv.reshape(-1, 2),
        kind=np.array(HAIR),
    )  # fmt: skip


def _thickness(rise: Float64, turn: Float64, elevation: Float64, identity: Identity) -> Float64:
    """Height of the hair over the skin, cm: quick at the edge, full at the crown."""
    volume = identity.hair_volume_cm
    base = 0.12 + volume * smoothstep(rise * 3.2) * (0.75 + 0.35 * np.sin(elevation))
    quiff = (
        0.55 * volume * np.exp(-(((rise - 0.28) / 0.22) ** 2)) * np.maximum(np.cos(turn), 0) ** 2
    )
    parting = identity.hair_parting
    if parting:
        side = np.sign(parting) * np.sin(turn) * np.cos(elevation)
        line = np.exp(-(((side - abs(parting)) / 0.07) ** 2)) * (np.cos(turn) > 0)
        line = line * (1 - smoothstep((rise - 0.55) * 4))
        lower = np.clip(abs(parting) - side, 0, 1) * (1 - smoothstep((rise - 0.5) * 2.5))
        base = base * (1 - 0.45 * line) + 0.18 * volume * lower
    locks = 0.05 * np.sin(turn * 28) * np.sin(turn * 11 + 1.0) * smoothstep(rise * 4)
    return np.asarray(base + quiff + locks * (1 - smoothstep((rise - 0.75) * 4)))


def _radius_table(identity: Identity) -> Callable[[Float64], Float64]:
    """Distance of the skin from `HAIR_AXIS` in any direction (n, 3), from a table of rays."""
    from scipy.interpolate import RegularGridInterpolator

    elevation = np.radians(np.linspace(-80, 90, 48))
    turn = np.linspace(-np.pi, np.pi, 97)
    e, t = np.meshgrid(elevation, turn, indexing="ij")
    direction = np.stack([np.cos(e) * np.sin(t), np.sin(e), np.cos(e) * np.cos(t)], -1)
    skin = cast(HAIR_AXIS, direction.reshape(-1, 3), identity)
    table = np.linalg.norm(skin - HAIR_AXIS, axis=1).reshape(e.shape)
    look_up = RegularGridInterpolator((elevation, turn), table, bounds_error=False, fill_value=None)

    def radius(direction: Float64) -> Float64:
        return np.asarray(look_up(_angles(direction)))

    return radius


def _angles(direction: Float64) -> Float64:
    """Elevation and turn (n, 2) of unit directions."""
    elevation = np.arcsin(np.clip(direction[:, 1], -1, 1))
    return np.stack([elevation, np.arctan2(direction[:, 0], direction[:, 2])], -1)


def _combed(direction: Float64, identity: Identity, sway: Float64) -> Float64:
    """Where hair that lies over `direction` (n, 3) points, along the skin."""
    elevation, turn = np.degrees(_angles(direction)).T
    around, x, long = np.abs(turn), direction[:, 0], identity.hair_length_cm
    if long:
        side = np.tanh((x - 0.35 * identity.hair_parting) * 9)
        over = np.stack([side, 0.0 * x, -0.62 - 0.3 * sway], -1)
        low, span = np.interp(around, [30, 60, 100], [-30, 14, 26]), 24
    else:
        side = -np.sign(identity.hair_parting or 1.0) * 0.45 + sway
        over = np.stack([side, 0.2 + 0 * x, np.full(len(x), -1.0)], -1)
        low, span = np.interp(around, [45, 80], [-15, 30]), 30
    top = smoothstep((elevation - low) / span)[:, None]
    back = np.where(around < 110, -0.5, 0.0) * (0.45 if long else 1)
    down = np.stack([0.25 * sway, np.full(len(x), -1.0), back], -1)
    flow = top * over + (1 - top) * down
    flow -= (flow * direction).sum(1, keepdims=True) * direction
    return unit(flow + 1e-9)


def rise(direction: Float64) -> Float64:
    """0 at the hairline, 1 at the crown, negative below."""
    elevation, turn = _angles(direction).T
    edge = np.radians(_hairline(turn))
    return np.asarray((elevation - edge) / (np.pi / 2 - edge))


def _roots(identity: Identity, rng: np.random.Generator) -> Float64:
    """Directions of the locks' roots, evenly over the scalp, then of the wisps along its edge."""
    i = np.arange(8 * LOCKS) + 0.5
    polar, turn = np.arccos(1 - 2 * i / len(i)), np.pi * (1 + 5**0.5) * i
    sphere = np.stack(
        [np.sin(polar) * np.sin(turn), np.cos(polar), np.sin(polar) * np.cos(turn)], -1
    )
    inside = sphere[rise(sphere) > 0.01]
    inside = inside[np.linspace(0, len(inside) - 1, LOCKS).astype(int)]
    around = np.linspace(-np.pi, np.pi, WISPS, endpoint=False)
    edge = np.radians(_hairline(around) + rng.uniform(-0.5, 3.5, WISPS))
    rim = np.stack([np.cos(edge) * np.sin(around), np.sin(edge), np.cos(edge) * np.cos(around)], -1)
    return np.concatenate([inside, rim])


def _locks(identity: Identity) -> Mesh:
    """Tapered, rounded ribbons that grow from their roots along the combed direction."""
    rng = np.random.default_rng(7)
    roots = _roots(identity, rng)
    count, is_wisp = len(roots), np.arange(len(roots)) >= LOCKS
    sway = 0.14 * rng.standard_normal(count)
    layer = np.where(is_wisp, 0.55, rng.choice([0.78, 0.90, 1.02], count))
    long = identity.hair_length_cm
    length = rng.uniform(0.75, 1.15, count) * (11.0 + long if long else 4.4)
    length[is_wisp] = rng.uniform(0.8, 2.0, is_wisp.sum()) * (1.6 if long else 1.0)
    rows = _grown(identity, roots, length, layer, sway)
    steps = np.linalg.norm(np.diff(rows, axis=1), axis=-1)
    s = np.cumsum(np.pad(steps, ((0, 0), (1, 0))), axis=1) / steps.sum(1, keepdims=True)
    width = (0.85 if long else 0.55) * rng.uniform(0.7, 1.2, count)
    width[is_wisp] *= 0.17
    taper = np.minimum(0.45 + 3 * s, 1) * np.sqrt(1 - 0.99 * s ** (3 if long else 2))
    half = 0.5 * width[:, None] * taper
    along = unit(np.gradient(rows, axis=1) + 1e-9)
    out = unit(rows - HAIR_AXIS * [1, 0.3, 1])
    side = unit(np.cross(out, along) + 1e-9) + 0.25 * sway[:, None, None] * out
    left, right = rows + half[..., None] * side, rows - half[..., None] * side
    middle = rows + 0.36 * half[..., None] * out
    vertices = np.stack([left, middle, right], 2)  # (N, STEPS, 3, 3)
    quads = np.concatenate(
        [grid_faces(STEPS, 3, closed=False, start=k * 3 * STEPS) for k in range(count)]
    )
    shade = (rng.uniform(0.84, 1.18, count)[:, None] * (0.62 + 0.48 * np.minimum(s * 3, 1)))[
        ..., None, None
    ]
    colors = np.array(identity.hair) * np.broadcast_to(shade, vertices.shape)
    start = rng.uniform(0, 0.75, count)
    u = start[:, None, None] + np.array([0, 0.125, 0.25])[None, None]
    u0, v0, wide = STRANDS_UV
    uv = np.stack(np.broadcast_arrays(u0 + wide * u, v0 + wide * s[..., None]), -1)
    n = count * STEPS * 3
    locks = Mesh(
        vertices.reshape(-1, 3), quads, np.clip(colors, 0, 1).reshape(-1, 3),
        np.full(n, 0.33), uv.reshape(-1, 2), kind=np.array(HAIR),
    )  # fmt: skip
    return join([locks, _inside(locks)]) if long else locks


def _inside(locks: Mesh) -> Mesh:
    """The other side, darker, of locks that hang free and can be seen from within."""
    of_lock = np.arange(len(locks.vertices)) // (3 * STEPS)
    low = locks.vertices.reshape(-1, 3 * STEPS, 3)[..., 1].min(1) < HANGS_BELOW_CM
    kept = np.flatnonzero(low[of_lock])
    index = np.full(len(locks.vertices), -1)
    index[kept] = np.arange(len(kept))
    faces = index[locks.faces]
    faces = faces[(faces >= 0).all(1)][:, ::-1]
    return Mesh(
        locks.vertices[kept], faces, 0.55 * locks.colors[kept], 0.5 * locks.gloss[kept],
        locks.uv[kept], kind=np.array(HAIR),
    )  # fmt: skip


def _grown(
    identity: Identity, roots: Float64, length: Float64, layer: Float64, sway: Float64
) -> Float64:
    """Middle lines (N, STEPS, 3) of locks: along the head, then hanging."""
    radius, long = _radius_table(identity), identity.hair_length_cm
    floor = HAIR_AXIS[1] - 5.2 - long
    start = _thickness(
        np.clip(rise(roots), 0, 1), _angles(roots)[:, 1], _angles(roots)[:, 0], identity
    )
    point = HAIR_AXIS + (radius(roots) + 0.5 * layer * start)[:, None] * roots
    rows = [point]
    for k in range(1, STEPS):
        direction = unit(point - HAIR_AXIS)
        flow = _combed(direction, identity, sway)
        hang = smoothstep((3.5 - point[:, 1]) / 3) * (long > 0)
        flow = unit(flow * (1 - hang[:, None]) + hang[:, None] * [0, -1, 0])
        step = length / (STEPS - 1)
        if not long:
            step = step * (0.12 + 0.88 * smoothstep((rise(direction) + 0.05) / 0.08))
        else:
            step = step * np.maximum(smoothstep((point[:, 1] - floor - 2 * sway) / 3.0), 0.02)
        point = point + step[:, None] * flow
        direction = unit(point - HAIR_AXIS)
        elevation, turn = _angles(direction).T
        above = rise(direction)
        thick = _thickness(np.clip(above, 0, 1), turn, elevation, identity) + 0.05
        tip = 1 - 0.45 * (k / (STEPS - 1)) ** 3 * (long == 0)
        least = radius(direction) + layer * tip * thick
        if long:
            over_ear = np.exp(
                -(((np.degrees(np.abs(turn)) - 92) / 24) ** 2)
                - (((np.degrees(elevation) + 12) / 26) ** 2)
            )
            least = least + (0.75 + 0.75 * layer) * over_ear
        lift = least - np.linalg.norm(point - HAIR_AXIS, axis=1)
        point = point + np.maximum(lift, lift * (1 - hang))[:, None] * direction
        if long:
            point = _beside_the_face(point, sway)
        rows.append(point)
    return np.stack(rows, 1)


def _beside_the_face(point: Float64, sway: Float64) -> Float64:
    """Hair at the level of the face moved around the head's axis until it leaves the face free."""
    around = np.arctan2(point[:, 0], point[:, 2] + 1.0)
    reach = np.hypot(point[:, 0], point[:, 2] + 1.0)
    least = np.radians(64) * smoothstep((6.5 - point[:, 1]) / 4.5)
    around = np.where(np.abs(around) < least, np.sign(around + 1e-9) * least, around)
    moved = point.copy()
    moved[:, 0], moved[:, 2] = reach * np.sin(around), reach * np.cos(around) - 1.0
    moved[:, 0] += 0.25 * np.sin(0.9 * point[:, 1] + 9 * sway) * smoothstep((0 - point[:, 1]) / 5)
    return moved


BROW_HAIRS = 260


def brow_place(s: Float64, identity: Identity) -> tuple[Float64, Float64, Float64]:
    """x, y and half the height of the left brow at s in 0 (inner end) .. 1, cm."""
    x = (0.95 + 3.95 * s) * (0.5 + 0.5 * identity.eye_spacing)
    y = 1.72 + 0.66 * np.sin(np.pi * np.minimum(s * 0.84, 1)) - 0.36 * s**3 + identity.brow_lift_cm
    half = 0.36 * (1 - 0.78 * s**1.6) * np.minimum(1, 0.3 + s * 3) * identity.brow_thickness
    return x, y, half


def brow(identity: Identity) -> Mesh:
    """The left eyebrow: single hairs that lie on the skin, upwards inside and outwards outside."""
    rng = np.random.default_rng(11)
    s = np.sort(rng.uniform(0, 1, BROW_HAIRS))
    across = rng.uniform(-1, 1, BROW_HAIRS)
    x, y, half = brow_place(s, identity)
    angle = np.radians(np.interp(s, [0, 0.12, 0.45, 1], [88, 62, 26, -12]) - 16 * across)
    angle += 0.14 * rng.standard_normal(BROW_HAIRS)
    length = (
        0.62
        * rng.uniform(0.7, 1.15, BROW_HAIRS)
        * (1 - 0.3 * s)
        * np.minimum(1, 0.55 + 2.5 * s)
        * (0.6 + 0.4 * identity.brow_thickness)
    )
    t = np.linspace(-0.45, 0.55, 4)[:, None]
    way = np.stack([np.cos(angle), np.sin(angle)], -1)
    over = np.stack([-way[:, 1], way[:, 0]], -1)
    base = np.stack([x, y + 0.8 * half * across], -1)
    line = base + (t * length)[..., None] * way + (0.10 * t**2 * length)[..., None] * over
    thick = 0.012 * np.array([0.7, 1.0, 0.8, 0.1])[:, None, None] * over
    flat = np.stack([line + thick, line - thick], 2).transpose(1, 0, 2, 3)  # (N, 4, 2, 2)
    depth = 8.4 - 0.30 * np.maximum(flat[..., 0] - 2.0, 0)
    aim = np.concatenate([flat, depth[..., None]], -1).reshape(-1, 3)
    on_skin = direction_points(aim, identity)
    lift = np.tile(np.repeat([0.02, 0.06, 0.09, 0.07], 2), BROW_HAIRS)[:, None]
    vertices = on_skin + lift * unit(on_skin - [0, 1, 0])
    faces = np.concatenate([grid_faces(4, 2, closed=False, start=8 * k) for k in range(BROW_HAIRS)])
    shade = np.repeat(rng.uniform(0.8, 1.5, BROW_HAIRS), 8)[:, None]
    fair = np.repeat(np.interp(s, [0, 0.2], [0.35, 0.0]), 8)[:, None]  # the inner end
    colors = np.array(identity.hair) * shade * (1 - fair) + np.array(identity.skin) * fair
    return Mesh(vertices, faces, colors, np.full(len(vertices), 0.1), kind=np.array(HAIR))
