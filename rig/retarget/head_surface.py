"""Colours, textures and baked light of a user's head, for `rig.retarget.head_import`."""

import re
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Float64, Int64
from rig.face.head_file import Arrays
from rig.face.mesh import CLOTH, EYE, FINE, HAIR, NO_MAPS, PLAIN, SKIN
from rig.limits import PICTURE_PIXELS
from rig.mesh.glb_reader import GlbParts, Piece
from rig.mesh.trimesh import TriMesh, components
from rig.retarget.morph_head import linear_to_srgb

Picture = NDArray[np.uint8]
SIDE, FIRST, EDGE, MOST_TILES = 2048, 1536, 4, 4
"""Side of the atlas, of its first picture beside others, and of an edge that repeats, texels; how
often a texture may be repeated."""
QUALITY = 88
TONE = (0.80, 0.62, 0.53)
"""Linear colour of skin without one."""
KINDS = (
    (FINE, "brow"),
    (HAIR, "hair|lash|beard|mo?ustache|scalp"),
    (PLAIN, "teeth|tooth|tongue|gum|mouth"),
    (EYE, "eye|iris|cornea|sclera"),
    (CLOTH, "shirt|cloth|outfit|glasses|collar|suit|hat$"),
    (SKIN, "skin|face|head|body"),
)
"""Words in names of material, mesh and node; the first that is found counts."""
GLOSS = {PLAIN: 0.24, SKIN: 0.3, HAIR: 0.25, EYE: 0.9, CLOTH: 0.03, FINE: 0.1}
SOLID, HOLES = 0.97, 0.02
"""Alpha of a whole place, and share of a piece's places from which on it has holes."""
JAW_OPEN, THROUGH_LIPS = 0.6, 0.85
"""Weight at which light falls on what is behind the lips, and share of it at rest."""
PLACE, TURNED = 1e-3, 0.05
"""Steps of places, cm, and of normals, in which vertices of a seam are the same."""


def surface_of(
    read: GlbParts, points: Float64, faces: Int64, order: Int64, deltas: Float32, jaw: int
) -> tuple[Arrays, list[str]]:
    """Arrays of a head file that are not its motion, and what was guessed.

    Parameters
    ----------
    read : Source
        The file.
    points, faces : array
        Of the head, cm.
    order : array [shape=(V,)]
        Vertex of the file's joined mesh of each of the head.
    deltas : array [shape=(K, V, 3)]
        Of its shapes.
    jaw : int
        The shape that opens the jaw.
    """
    from rig.retarget.head_light import occlusion  # compiles

    notes: list[str] = []
    colours, pictures, uv, kinds = [], [], [], []
    for piece in read.pieces:
        picture, places = _texture(read, piece, notes)
        kind = _kinds(read, piece, picture, places)
        if not np.isin(kind, (HAIR, FINE)).any():
            picture = picture.copy()
            picture[..., 3] = 255
        kinds.append(kind)
        colours.append(_colour(read, piece, bool((kind == SKIN).any()), notes))
        pictures.append(picture)
        uv.append(places)
    atlas, placed = _atlas(pictures, uv, [len(piece.faces) for piece in read.pieces])
    kind = np.concatenate(kinds)[order]
    opaque = ~np.isin(kind, (HAIR, FINE))[faces[:, 0]]
    light = occlusion(points, faces, opaque)
    light[kind == FINE] = 1
    # Parts behind the lips also get what comes in through an open mouth.
    parts = components(TriMesh(points, faces))
    is_inner = (parts != np.bincount(parts).argmax()) & np.isin(kind, (PLAIN, SKIN))
    opened = occlusion(points + JAW_OPEN * deltas[jaw], faces, opaque) if is_inner.any() else light
    light[is_inner] = np.maximum(light, THROUGH_LIPS * opened)[is_inner]
    own = [read.column(piece, "NORMAL") for piece in read.pieces]
    normals = [np.zeros((len(p.vertices), 3)) if n is None else n
               for p, n in zip(read.pieces, own, strict=True)]  # fmt: skip
    return {
        "uv": np.round(placed[order] * 65535).astype(np.uint16),
        "weld": _weld(points, deltas, np.concatenate(normals)[order]),
        "colour": _bytes(np.concatenate(colours)[order]),
        "gloss": _bytes([GLOSS[k] for k in kind.tolist()]), "light": _bytes(light),
        "kind": kind.astype(np.uint8), "atlas": _webp(atlas),
        "creases": _webp(NO_MAPS.creases), "pores": _webp(NO_MAPS.pores),
    }, list(dict.fromkeys(notes))  # fmt: skip


def _bytes(values: Any) -> Picture:
    return np.asarray(np.round(255 * np.clip(values, 0, 1)), np.uint8)


def _webp(picture: Picture) -> Picture:
    from PIL import Image

    stream = BytesIO()
    small = len(picture) < SIDE
    Image.fromarray(picture).save(stream, "WEBP", quality=QUALITY, lossless=small, exact=True)
    return np.frombuffer(stream.getvalue(), np.uint8)


def _weld(points: Float64, deltas: Float32, normals: Float64) -> NDArray[np.uint16]:
    """First vertex (V,) at the same place, that moves and looks the same way."""
    signs = np.random.default_rng(0).standard_normal(len(deltas)).astype(np.float32)
    moved = np.tensordot(signs, deltas, 1)
    rows = np.column_stack([points / PLACE, moved / PLACE, normals / TURNED])
    _, first, which = np.unique(
        np.round(rows).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    return first[which.reshape(-1)].astype(np.uint16)


def _kinds(read: GlbParts, piece: Piece, picture: Picture, uv: Float64) -> Int64:
    """Materials of `rig.face.mesh` (V,): by names, and hair where the surface has holes."""
    material = read.material(piece)
    words = [(kind, words) for name in reversed(read.names(piece)) for kind, words in KINDS
             if re.search(words, name.lower())]  # fmt: skip
    moves = any(delta.any() for delta in piece.deltas)
    kind = words[0][0] if words else SKIN if moves else PLAIN
    kinds = np.full(len(piece.vertices), kind)
    if material.get("alphaMode", "OPAQUE") == "OPAQUE" or kind == FINE:
        return kinds
    if _factor(material)[3] < SOLID:
        return np.full(len(kinds), HAIR)
    corners = np.concatenate([uv[piece.faces], uv[piece.faces].mean(1, keepdims=True)], 1)
    height, width = picture.shape[:2]
    x, y = np.clip(corners * (width, height), 0, (width - 1, height - 1)).astype(int).T
    holes = (picture[y, x, 3] < 255 * SOLID).mean(0)  # of each face
    parts = components(TriMesh(piece.vertices, piece.faces))
    of_face, count = parts[piece.faces[:, 0]], int(parts.max()) + 1
    found = np.bincount(of_face, holes, count)
    share = found / np.maximum(np.bincount(of_face, minlength=count), 1)
    return np.where(share[parts] > HOLES, HAIR, kinds)


def _base(material: dict[str, Any]) -> dict[str, Any]:
    """Factor and texture of a material's colour, of either workflow."""
    older = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
    if older is None:
        rough = material.get("pbrMetallicRoughness", {})
        return {"factor": rough.get("baseColorFactor"), "texture": rough.get("baseColorTexture")}
    return {"factor": older.get("diffuseFactor"), "texture": older.get("diffuseTexture")}


def _factor(material: dict[str, Any]) -> Float64:
    given = _base(material)["factor"]
    factor = np.ones(4) if given is None else np.array(given, np.float64).reshape(4)
    return np.clip(np.nan_to_num(factor), 0, 1)


def _colour(read: GlbParts, piece: Piece, is_skin: bool, notes: list[str]) -> Float64:
    """SRGB colours (V, 3) by which the texture is multiplied."""
    material, painted = read.material(piece), read.column(piece, "COLOR_0")
    base = _base(material)
    factor = _factor(material)[:3]
    if painted is None and base["factor"] is None and base["texture"] is None and is_skin:
        notes.append("a mesh has no colours: a tone of skin is guessed")
        factor = np.array(TONE)
    light = factor if painted is None else factor * np.clip(painted[:, :3], 0, 1)
    return np.broadcast_to(linear_to_srgb(light), (len(piece.vertices), 3))


def _texture(read: GlbParts, piece: Piece, notes: list[str]) -> tuple[Picture, Float64]:
    """Picture of the base colour, RGBA, and places (V, 2) in it, 0..1; white without one."""
    count, texture = len(piece.vertices), _base(read.material(piece))["texture"]
    white, nowhere = np.full((2, 2, 4), 255, np.uint8), np.full((count, 2), 0.5)
    if texture is None:
        return white, nowhere
    change = texture.get("extensions", {}).get("KHR_texture_transform", {})
    uv = read.column(piece, f"TEXCOORD_{change.get('texCoord', texture.get('texCoord', 0))}")
    picture = _picture(read, texture["index"], notes)
    if picture is None or uv is None:
        return white, nowhere
    angle = -float(change.get("rotation", 0))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    uv = uv[:, :2] * change.get("scale", (1, 1)) @ turn.T + change.get("offset", (0, 0))
    uv = uv - np.floor(uv.min(0, initial=np.inf) + 1e-4)
    tiles = np.ceil(uv.max(0, initial=0) - 1e-4).clip(1, None)
    if tiles.max() > MOST_TILES:
        notes.append("a texture that repeats too often is one colour: its mean")
        mean = np.round(picture.mean((0, 1), keepdims=True)).astype(np.uint8)
        return np.repeat(np.repeat(mean, 2, 0), 2, 1), nowhere
    columns, rows = tiles.astype(int)
    return np.tile(picture, (rows, columns, 1)), np.clip(uv / tiles, 0, 1)


def _picture(read: GlbParts, index: int, notes: list[str]) -> Picture | None:
    """A texture's picture (h, w, 4), at most `SIDE` texels a side; none if it cannot be read."""
    from PIL import Image

    texture = read.document["textures"][index]
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
    image = read.document["images"][webp.get("source", texture.get("source"))]
    if "bufferView" not in image:
        notes.append("a texture lies in another file: left out; export one .glb with textures")
        return None
    view = read.document["bufferViews"][image["bufferView"]]
    start = view.get("byteOffset", 0)
    data = read.binary[start : start + view["byteLength"]]
    try:
        with Image.open(BytesIO(data), formats=("PNG", "JPEG", "WEBP")) as opened:
            if opened.width * opened.height > PICTURE_PIXELS:
                notes.append(
                    f"a texture of {opened.width} x {opened.height} is left out: too large"
                )
                return None
            opened.draft("RGB", (SIDE, SIDE))
            opened.thumbnail((SIDE, SIDE))
            return np.asarray(opened.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        notes.append("a texture cannot be read: left out")
        return None


def _atlas(pictures: list[Picture], uv: list[Float64], faces: list[int]) -> tuple[Picture, Float64]:
    """One picture of all, and the places (V, 2) in it; that with most faces is the largest."""
    from PIL import Image

    known: dict[bytes, int] = {}
    which = [known.setdefault(p.tobytes(), len(known)) for p in pictures]
    different = [pictures[which.index(k)] for k in range(len(known))]
    shares = np.bincount(which, faces)
    is_large = [picture.shape[0] * picture.shape[1] > 4 for picture in different]
    ranked = sorted(range(len(different)), key=lambda k: (not is_large[k], -shares[k]))
    cells = _cells(len(ranked))
    atlas = np.full((SIDE, SIDE, 4), 255, np.uint8)
    boxes = np.zeros((len(ranked), 3))
    for (x, y, side), k in zip(cells, ranked, strict=True):
        inner = side - 2 * EDGE
        picture = Image.fromarray(different[k])
        resized = np.asarray(picture.resize((inner, inner), Image.Resampling.BICUBIC))
        atlas[y : y + side, x : x + side] = np.pad(resized, ((EDGE,) * 2,) * 2 + ((0, 0),), "edge")
        boxes[k] = x + EDGE, y + EDGE, inner
    placed = [(boxes[k][:2] + places * boxes[k][2]) / SIDE
              for k, places in zip(which, uv, strict=True)]  # fmt: skip
    return atlas, np.concatenate(placed)


def _cells(count: int) -> list[tuple[int, int, int]]:
    """Left, top and side of `count` squares in the atlas."""
    if count == 1:
        return [(0, 0, SIDE)]
    small = SIDE - FIRST
    beside = [(FIRST, small * k, small) for k in range(4)]
    below = [(small * k, FIRST, small) for k in range(3)]
    if count <= 8:
        return [(0, 0, FIRST), *beside, *below][:count]
    across = int(np.ceil(np.sqrt(count)))
    side = SIDE // across
    return [(side * (k % across), side * (k // across), side) for k in range(count)]
