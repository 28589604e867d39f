"""Hair cap and brows."""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import Mesh, grid_faces, join, painted, smoothstep, unit
from rig.face.geometry.sdf import cast
from rig.face.geometry.skin import direction_points
from rig.face.identity import Identity

_COLUMNS, _ROWS = 112, 18
_AXIS = np.array([0.0, 2.2, -0.9])
_FRONT, _SIDE, _BACK = 0.0, np.pi / 2, np.pi


def _hairline(turn: Float64) -> Float64:
    """Elevation (degrees, from `_AXIS`) of the hair's edge at each turn (0 front, pi back)."""
    around = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)
    stops = np.radians([0, 18, 34, 46, 56, 66, 74, 80, 88, 96, 104, 112, 122, 140, 180])
    edge = [30, 31, 29, 24, 12, -6, -16, -17, 4, 7, 0, -17, -34, -42, -44]
    return np.interp(around, stops, edge)


def hair(identity: Identity) -> Mesh:
    """A closed-looking shell from the hairline to the crown; longer hair hangs below it."""
    turn = np.arange(_COLUMNS) / _COLUMNS * 2 * np.pi
    edge = np.radians(_hairline(turn))
    rise = np.linspace(0, 1, _ROWS) ** 1.15
    elevation = edge[None] + rise[:, None] * (np.pi / 2 - 0.012 - edge[None])
    direction = np.stack(
        [np.cos(elevation) * np.sin(turn), np.sin(elevation), np.cos(elevation) * np.cos(turn)], -1
    )
    on_skin = cast(_AXIS, direction.reshape(-1, 3), identity).reshape(_ROWS, _COLUMNS, 3)
    thick = _thickness(rise[:, None], turn[None], elevation, identity)
    shell = on_skin + thick[..., None] * direction
    hem = on_skin[0] - 0.25 * direction[0]
    rows = [hem[None], *_hanging(shell, hem, turn, identity), shell]
    vertices = np.concatenate(rows)
    faces = grid_faces(len(vertices), _COLUMNS)[:, ::-1]
    flat = vertices.reshape(-1, 3)
    strand = 1 + 0.13 * np.sin(turn * 28) * np.sin(turn * 11 + 1.0)
    colors = np.array(identity.hair) * np.tile(strand, len(vertices))[:, None]
    shell_mesh = Mesh(flat, faces[:, ::-1], np.clip(colors, 0, 1), np.full(len(flat), 0.35))
    return join([shell_mesh, _lining(shell_mesh)]) if identity.hair_length_cm else shell_mesh


def _lining(shell: Mesh) -> Mesh:
    """The inside of hanging hair: the shell's lowest rows turned inside out, darker."""
    rows = 12
    count = rows * _COLUMNS
    faces = shell.faces[(shell.faces < count).all(1)][:, ::-1]
    return Mesh(
        shell.vertices[:count], faces, shell.colors[:count] * 0.45, shell.gloss[:count] * 0.2
    )


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


def _hanging(shell: Float64, hem: Float64, turn: Float64, identity: Identity) -> list[Float64]:
    """Rows of hair below the edge at the sides and the back (nothing for short hair)."""
    if not identity.hair_length_cm:
        return []
    around = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)
    reach = identity.hair_length_cm * smoothstep((around - np.radians(52)) / np.radians(14))
    floor = _AXIS[1] - 4.6 - reach
    rows = []
    hangs = (reach > 0)[:, None]
    start = shell[2]
    drop = np.minimum(floor - start[:, 1], 0) * (reach > 0)
    outward = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], -1)
    for k in np.linspace(1, 0.12, 9):
        row = start + k * drop[:, None] * [0, 1, 0]
        swell = 0.9 * np.sin(np.pi * k) + 0.35 * k
        row = row + (swell * reach / identity.hair_length_cm)[:, None] * outward
        rows.append(np.where(hangs, row, shell[0]))
    inner = np.where(hangs, rows[0] - 0.6 * outward, hem)
    return [np.stack([inner, *rows])]


def brow(identity: Identity) -> Mesh:
    """The left eyebrow, lying on the skin."""
    columns, around = 22, 8
    s = np.linspace(0, 1, columns)
    x = (0.95 + 3.95 * s) * (0.5 + 0.5 * identity.eye_spacing)
    y = 1.72 + 0.66 * np.sin(np.pi * np.minimum(s * 0.84, 1)) - 0.36 * s**3 + identity.brow_lift_cm
    thick = 0.36 * (1 - 0.78 * s**1.6) * np.minimum(1, 0.3 + s * 4) * identity.brow_thickness
    aim = np.stack([x, y, 8.4 - 0.30 * np.maximum(x - 2.0, 0)], -1)
    row = np.linspace(-1, 1, around)[:, None]
    spread = aim + np.stack([0.10 * row * (1 - s), thick * row, 0 * row * s], -1)
    on_skin = direction_points(spread.reshape(-1, 3), identity).reshape(spread.shape)
    lift = 0.12 * np.sqrt(np.maximum(1 - row**2, 0)) + 0.025
    vertices = (on_skin + lift[..., None] * unit(on_skin - [0, 1, 0])).reshape(-1, 3)
    blend = np.tile(np.clip(s * 7 + 0.35, 0, 1), around)[:, None]
    colors = np.array(identity.hair) * 0.8 * blend + np.array(identity.skin) * 0.8 * (1 - blend)
    return painted(vertices, grid_faces(around, columns, closed=False), colors, 0.05)
