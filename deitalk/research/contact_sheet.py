"""Contact sheets: many poses of a head in one picture, with their names."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.research.poses import EMOTION_POSES, MOUTH_POSES, pose_values
from rig.arrays import Float64
from rig.controls import default_controls
from rig.errors import RigError
from rig.face.accents import accents
from rig.face.head import Head
from rig.face.render import VIEWS
from rig.face.render.picture import Picture, png, text_width, write_text
from rig.files import atomic_write

SHEETS = (
    "mouth", "mouth-side", "emotions", "views", "brow", "eye", "nose", "cheek", "lips", "jaw",
    "tongue", "teeth", "neck", "ear",
)  # fmt: skip
"""Names of the sheets; the last ten show each control of a region at its ends."""
_REGION_VIEW = {
    "brow": "eyes", "eye": "eyes", "nose": "face", "cheek": "face", "lips": "mouth",
    "jaw": "face", "tongue": "mouth", "teeth": "mouth", "neck": "neck", "ear": "ear",
}  # fmt: skip


@dataclass(frozen=True)
class Tile:
    """One picture of a sheet: its title, control values (185,) and view."""

    title: str
    values: Float64
    view: str


def sheet_tiles(name: str) -> list[Tile]:
    """Tiles of a named sheet.

    Raises
    ------
    RigError
        If there is no such sheet.
    """
    if name in ("mouth", "mouth-side"):
        view = name.replace("-", "_")
        return [Tile(title, pose_values(pose), view) for title, pose in MOUTH_POSES.items()]
    if name == "emotions":
        return [
            Tile(f"{title} {strength:.0%}", pose_values(pose, strength), "face")
            for strength in (0.35, 0.7, 1.0)
            for title, pose in EMOTION_POSES.items()
        ]
    if name == "views":
        return [Tile(view, pose_values({}), view) for view in ("front", "three_quarter", "side")]
    if name in _REGION_VIEW:
        return _control_tiles(name)
    raise RigError(f"sheet {name!r} is unknown; use one of {', '.join(SHEETS)}")


def _control_tiles(region: str) -> list[Tile]:
    """Both ends of the region's controls; of left and right controls only the left."""
    controls = default_controls()
    group = controls.subset("mouth" if region == "lips" else region)
    base = _base(region)
    tiles = [Tile("base", pose_values(base), _REGION_VIEW[region])]
    for k in group:
        name = controls.names[k]
        if name.startswith("CTRL_R_"):
            continue
        for end in (controls.maximum[k], controls.minimum[k]):
            if end != controls.rest[k]:
                values = pose_values({**base, name: float(end)})
                title = f"{name.removeprefix('CTRL_')} {end:+.0f}"
                tiles.append(Tile(title, values, _REGION_VIEW[region]))
    return tiles


def _base(region: str) -> dict[str, float]:
    """A pose in which the region's controls are visible."""
    if region in ("tongue", "teeth"):
        return {"CTRL_C_jaw.ty": 0.45, "*mouth_lowerLipDepress.ty": 0.5,
                "*mouth_upperLipRaise.ty": 0.4}  # fmt: skip
    return {"CTRL_C_jaw.ty": 0.15} if region == "lips" else {}


def draw_sheet(
    head: Head,
    tiles: Sequence[Tile],
    *,
    columns: int = 4,
    size: tuple[int, int] = (380, 320),
) -> Picture:
    """Draw tiles row by row.

    Parameters
    ----------
    head : Head
        The head.
    tiles : sequence of Tile
        Poses, row by row.
    columns : int, optional
        Tiles in a row.
    size : (int, int), optional
        Width and height of a tile, pixels.

    Returns
    -------
    picture : ndarray [shape=(rows * height, columns * width, 3)], uint8
    """
    from rig.face.render.software import Renderer

    renderers: dict[str, Renderer] = {}
    width, height = size
    rows = -(-len(tiles) // columns)
    picture = np.zeros((rows * height, columns * width, 3), np.uint8)
    for k, tile in enumerate(tiles):
        if tile.view not in renderers:
            renderers[tile.view] = Renderer(head.mesh, size, VIEWS[tile.view], many=True)
        values = tile.values[None]
        pose = head.pose(values)
        drawn = renderers[tile.view].render(
            pose[0].astype(np.float64), accents=accents(head, values, pose)[0]
        )
        fitting = (h for h in (11, 10, 9, 8, 7) if text_width(tile.title, h) <= width - 12)
        drawn = write_text(drawn, tile.title, (8, 8), height=next(fitting, 6))
        y, x = k // columns * height, k % columns * width
        picture[y : y + height, x : x + width] = drawn
    return picture


def draw_people(*, columns: int = 4, size: tuple[int, int] = (360, 400)) -> Picture:
    """Every identity at rest, three quarter view, in one picture."""
    from rig.face.head import build_head
    from rig.face.identity import IDENTITIES

    rest = pose_values({})
    people = [
        draw_sheet(build_head(i), [Tile(person.name, rest, "three_quarter")], columns=1, size=size)
        for i, person in enumerate(IDENTITIES)
    ]
    blank = np.zeros_like(people[0])
    people += [blank] * (-len(people) % columns)
    rows = [np.hstack(people[k : k + columns]) for k in range(0, len(people), columns)]
    return np.vstack(rows)


def write_png(path: Path, picture: Picture) -> None:
    """Write a sheet, whole or not at all."""
    with atomic_write(path) as beside:
        beside.write_bytes(png(picture))
