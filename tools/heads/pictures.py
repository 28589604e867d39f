"""Pictures: one of all parts of a person with alpha, and creases and pores for all.

The skins of the npm package have 512 texels a side. They give the large colours; masks of the PyPI
package give sharp lips, and noise of the skin's own scales the rest.
"""

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from rig.face.render.software import Screen, front_faces, nearest_faces, planes
from tools.heads import lips as lips_of
from tools.heads import locks, teeth
from tools.heads.base import eye_of
from tools.heads.parts import EYE_EDGE, IRIS, eye_place
from tools.heads.strands import ROUND_CM, around, cloud, is_ear, over_line, smooth, uneven

SIDE = 2048
PLACES = {
    "skin": (0, 0, 1024, 2048), "hair": (1024, 0, 1024, 1024), "lash": (1024, 1024, 512, 512),
    "teeth": (1536, 1024, 512, 512), "eye": (1024, 1536, 512, 512), "brow": (1536, 1536, 256, 256),
    "tongue": (1792, 1536, 256, 256), "shirt": (1536, 1792, 256, 256),
}  # fmt: skip
"""Left, top, width and height of each part in a person's picture."""
LOW, SIZE = np.array([0.635, 0.0]), np.array([0.365, 0.83])
"""Crop of MakeHuman's picture of the skin."""
MOVED = [
    ((0.209, 0.80, 0.552, 0.974), (0.640, 0.004, 0.750, 0.140)),
    ((0.012, 0.547, 0.077, 0.633), (0.935, 0.010, 0.960, 0.050)),
    ((0.086, 0.547, 0.151, 0.633), (0.965, 0.010, 0.990, 0.050)),
]
"""Chest and sockets of the eyes, which are put into free corners of the crop: from, to."""
CREASES, PORES = 1024, 512


def skin_uv(uv):
    """Places in the crop (v upwards) of MakeHuman's places."""
    out = uv.copy()
    for (a, b, c, d), (e, f, g, h) in MOVED:
        inside = ((uv >= [a - 0.002, b - 0.002]) & (uv <= [c + 0.002, d + 0.002])).all(1)
        share = (uv[inside] - [a, b]) / [c - a, d - b]
        out[inside] = [e, f] + share * [g - e, h - f]
    return (out - LOW) / SIZE


def placed(uv, name):
    """Places in a person's picture (v downwards) of places in the picture of a part (upwards)."""
    left, top, width, height = PLACES[name]
    inset = 0 if name == "skin" else 2
    inner = np.array([width, height]) - 2 * inset
    return (np.array([left, top]) + inset + np.clip(uv, 0, 1) * [1, -1] * inner
            + [0, inner[1]]) / SIDE  # fmt: skip


def _source(width, height):
    """MakeHuman's places of the texels of the crop."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height)
    out = np.stack([x, y], -1) * SIZE + LOW
    given = out.copy()
    for (a, b, c, d), (e, f, g, h) in MOVED:
        inside = ((given >= [e - 0.003, f - 0.003]) & (given <= [g + 0.003, h + 0.003])).all(-1)
        share = (given[inside] - [e, f]) / [g - e, h - f]
        out[inside] = [a, b] + share * [c - a, d - b]
    return out


def _sampled(picture, order=3):
    values = np.asarray(picture, float)
    values = values if values.ndim == 3 else values[..., None]
    height, width = values.shape[:2]
    source = _source(*PLACES["skin"][2:])
    at = [(1 - source[..., 1]) * height - 0.5, source[..., 0] * width - 0.5]
    return np.stack([map_coordinates(values[..., k], at, order=order, mode="nearest")
                     for k in range(values.shape[2])], -1)  # fmt: skip


def _noise(shape, width, seed):
    field = gaussian_filter(np.random.default_rng(seed).normal(size=shape), width, mode="wrap")
    return field / field.std()


ZONES = (
    (0.0, 0.0, 1.3, 1.5, (1.03, 0.86, 0.85)),
    (1.5, -0.7, 0.7, 0.8, (1.01, 0.92, 0.92)),
    (0.0, 2.4, 0.8, 1.8, (1.0, 0.96, 0.95)),
    (4.0, -0.4, 2.4, 2.0, (1.02, 0.90, 0.89)),
    (5.6, 0.6, 1.6, 1.4, (1.02, 0.93, 0.92)),
    (0.0, -6.8, 1.4, 1.0, (1.01, 0.93, 0.92)),
    (2.3, 2.1, 1.2, 0.6, (0.92, 0.89, 0.93)),
    (3.4, 1.75, 1.7, 0.35, (0.95, 0.92, 0.93)),
    (3.2, 4.25, 1.7, 0.55, (0.94, 0.87, 0.86)),
    (0.0, 7.6, 4.5, 2.0, (1.0, 0.985, 0.95)),
    (0.0, -2.6, 2.2, 0.5, (1.0, 0.94, 0.93)),
    (5.0, -4.8, 1.5, 1.8, (0.99, 0.985, 0.97)),
    (2.6, -1.8, 0.9, 1.2, (1.01, 0.94, 0.92)),
    (3.4, -3.1, 0.9, 1.1, (1.01, 0.95, 0.93)),
    (6.6, 4.0, 1.2, 2.0, (0.97, 0.96, 0.98)),
)
"""Where blood and fat colour the face: x, y, widths in both (cm) and factors of the colour."""
BROAD = 90
"""Texels over which the picture's colours are evened."""
BORDER = 5
"""Texels over which the border of the lips is softened."""
RAW = np.array([0.50, 0.45])
"""Least green and blue of skin, for one of red: the picture's mouth is painted like a wound."""
NECK, NECK_CM = (-3.0, 6.0), 2.0
"""Below and behind which a seam of the skin lies on the neck, and how far each side takes from the
other there, cm."""
SHINE = (
    (0.0, 0.0, 0.9, 1.0, 0.15), (0.0, 2.4, 0.5, 1.8, 0.09), (0.0, 7.2, 3.0, 1.6, 0.08),
    (4.6, 1.0, 1.4, 0.8, 0.09), (0.0, -6.9, 1.2, 0.8, 0.05), (3.2, 4.2, 1.5, 0.5, 0.04),
    (5.6, -3.0, 1.6, 3.0, -0.07), (0.0, -13.0, 9.0, 3.5, -0.10), (0.0, -3.75, 1.8, 0.75, 0.24),
    (3.0, -3.7, 0.9, 1.0, -0.10), (0.0, -4.0, 1.0, 0.35, 0.12),
)  # fmt: skip
"""Where skin is greasier or drier: x, y, widths in both (cm) and what the gloss has more."""


def _zone(place, x, y, wide, high):
    """How much of a zone of the front of the average head places are, 0 to 1."""
    away = np.hypot((np.abs(place[..., 0]) - x) / wide, (place[..., 1] - y) / high)
    return np.exp(-(away**2)) * smooth((place[..., 2] - 3.0) / 3.0)


def shine(points):
    """What the gloss of points of the average head has more than that of all skin."""
    return sum(more * _zone(points, *where) for *where, more in SHINE)


def _drawn(place, lips):
    """How much of the picture's own drawing is kept at places: lids, nostrils, lips, mouth, ears."""
    x, y, z = np.moveaxis(place, -1, 0)
    far = np.abs(x)
    lids = smooth(1.9 - 1.2 * np.hypot((far - 3.2) / 1.9, (y - 3.4) / 0.85))
    nose = smooth(1.9 - 1.2 * np.hypot((far - 0.9) / 0.9, (y + 1.0) / 0.6))
    return np.max([lids, nose, lips, (far < 3.4) & (y < -0.5) & (z < 8.8), is_ear(place)], axis=0)


def skin(base, person):
    """Colours (2048, 1024, 3), 0 to 1."""
    look = person.look
    place, known = texels(base, person)
    colour = np.clip(
        _sampled(Image.open(base.npm / "skins" / look["skin"]).convert("RGB")) / 255, 0, 1
    )
    mask = lips_of.outline(base, _sampled)
    lips = gaussian_filter(mask, 1.6)
    drawn = _drawn(place, np.clip(3 * lips, 0, 1))
    # Light, brows and streaks that the picture has are no colour of skin: broad means instead.
    brows = np.exp(-(((place[..., 1] - 5.4) / 1.3) ** 2)) * (place[..., 2] > 4)
    share = known * (1 - drawn) * (1 - 0.97 * brows) * (over_line(place, look) < 0.5) + 1e-4
    plain = gaussian_filter(colour * share[..., None], (BROAD, BROAD, 0))
    plain = plain / gaussian_filter(share, BROAD)[..., None]
    fine = colour - gaussian_filter(colour, (26, 26, 0))
    fine += 0.45 * (colour - gaussian_filter(colour, (9, 9, 0)))
    fine *= look.get("drawing", 0.8)
    fine *= smooth((place[..., 1:2] + 9) / 2)  # the picture of the neck is drawn out
    fine *= 1 - 0.9 * brows[..., None]
    kept = drawn[..., None]
    painted = colour - plain
    painted = np.minimum(painted, 0.1 * np.maximum(painted, 0))  # no lights
    colour = plain + kept * painted + (0.9 * (1 - kept) + 0.45 * kept) * fine
    for *where, tint in ZONES:
        share = look["flush"] * _zone(place, *where) * (1 - lips)
        colour = colour * (1 + share[..., None] * (np.array(tint) - 1))
    ears = (look["flush"] * is_ear(place))[..., None]
    colour = colour * (1 - ears * [0.0, 0.10, 0.09])
    colour = lips_of.painted(colour, plain + 0.3 * fine, mask, place, person)
    soft = gaussian_filter(colour, (BORDER, BORDER, 0))
    border = np.exp(-(((gaussian_filter(mask, BORDER) - 0.4) / 0.3) ** 2)) * (place[..., 2] > 8.8)
    colour = colour + border[..., None] * (soft - colour)
    shape = colour.shape[:2]
    bare = (1 - 0.9 * lips) * look["mottle"]
    broad = look.get("patches", 1)
    detail = sum(a * cloud(place, w, s) for a, w, s in
                 ((0.018, 0.07, 2), (0.010, 0.2, 3), (0.010 * broad, 0.45, 11)))  # fmt: skip
    blood = sum(a * cloud(place, w, s) for a, w, s in
                ((0.010, 0.06, 5), (0.010, 0.12, 6), (0.022 * broad, 0.32, 8), (0.020 * broad, 0.8, 9),
                 (0.008, 2.0, 10)))  # fmt: skip
    spots = 0.20 * np.clip(cloud(place, 0.07, 7) - 2.5, 0, 1) * (1 - lips) * look["freckles"]
    colour = colour * (1 + (detail * bare)[..., None])
    colour = colour * (1 + (blood * bare)[..., None] * np.array([0.35, -0.8, -0.7]))
    colour = colour * (1 - spots[..., None] * np.array([0.5, 0.8, 0.95]))
    grey = colour.mean(-1, keepdims=True)
    colour = grey + (colour - grey) * (1 + (look["saturation"] - 1) * (1 - lips[..., None]))
    for _, (left, low, right, high) in MOVED[1:]:  # sockets: pale flesh at the corners of the eyes
        (x0, y0), (x1, y1) = (
            ((np.array(p) - LOW) / SIZE).clip(0, 1) for p in ((left, low), (right, high))
        )
        where = np.s_[round((1 - y1) * shape[0]) : round((1 - y0) * shape[0]),
                      round(x0 * shape[1]) : round(x1 * shape[1])]  # fmt: skip
        colour[where] = 0.15 * colour[where] + 0.85 * np.array(
            look.get("flesh", (0.77, 0.675, 0.625))
        )
    colour = colour * _lids(base, person, place)
    colour = _joined(base, person, np.clip(colour, 0, 1))
    colour[..., 1:] = np.maximum(colour[..., 1:], colour[..., :1] * RAW)
    return colour ** look["gain"]


LID_EDGES = {"upper": 1.25, "lower": 1.19}
"""Distance of the edges of the average head's lids from the middle of the eye, in radii."""


def _lids(base, person, place):
    """Factors of the colour of skin at the edges of lids: roots of lashes, and wet flesh."""
    center, radius = eye_of(person.shapes.average, base, "l")
    off = place * np.where(place[..., :1] < 0, [-1, 1, 1], 1) - center
    away = np.linalg.norm(off, axis=-1) / radius
    away = np.where(off[..., 2] > 0, away, 9)
    upper = smooth((off[..., 1] + 0.15) / 0.3)
    roots = [np.exp(-(((away - LID_EDGES[lid]) / 0.05) ** 2)) for lid in ("upper", "lower")]
    dark = 0.3 + 0.45 * person.look["lashes"]
    dark = dark * (upper * roots[0] + 0.35 * (1 - upper) * roots[1])[..., None]
    flesh = np.exp(-(((away - 1.08) / 0.08) ** 2))[..., None] * (1 - dark)
    return (1 - dark * [0.80, 0.85, 0.88]) * (1 - flesh * [0.01, 0.09, 0.08])


def _joined(base, person, colour):
    """Colours that are equal on both sides of the seam of the neck, where the picture is cut."""
    place, known = texels(base, person)
    ends = np.stack([base.skin_faces.ravel(), base.uv_triangles.ravel()], 1)
    point, at = np.unique(ends, axis=0).T
    skin = person.shapes.average[: base.n_skin]
    is_seam = (
        (np.bincount(point)[point] > 1) & (skin[point, 1] < NECK[0]) & (skin[point, 2] < NECK[1])
    )
    point, at = point[is_seam], at[is_seam]
    seam = SIDE * placed(skin_uv(base.uv[at]), "skin")
    weighed = gaussian_filter(np.dstack([colour * known[..., None], known]), (8, 8, 0))
    row, column = (
        np.clip(seam[:, 1], 0, colour.shape[0] - 1),
        np.clip(seam[:, 0], 0, colour.shape[1] - 1),
    )
    own = weighed[row.astype(int), column.astype(int)]
    own = own[:, :3] / (own[:, 3:] + 1e-4)
    total = np.stack([np.bincount(point, own[:, k]) for k in range(3)], 1)
    lacks = total[point] / np.bincount(point)[point, None] - own
    rows, columns = np.nonzero(known)
    far, near = cKDTree(seam).query(np.stack([columns, rows], 1), k=6)
    away = np.linalg.norm(place[rows, columns] - skin[point[near[:, 0]]], axis=1)
    weight = 1 / (far**2 + 9)
    missing = np.einsum("nk,nkc->nc", weight, lacks[near]) / weight.sum(1, keepdims=True)
    out = colour.copy()
    out[rows, columns] += missing * np.exp(-((away / NECK_CM) ** 2))[:, None]
    return np.clip(out, 0, 1)


def texels(base, person):
    """Points of the average head that the texels of the skin show, and which show any."""
    if not hasattr(base, "texels"):
        uv = placed(skin_uv(base.uv), "skin")
        average = person.shapes.average[: base.n_skin]
        place, known = surface(average, base.skin_faces, uv, base.uv_triangles, SIDE)
        width = PLACES["skin"][2]
        base.texels = place[:, :width], known[:, :width]
    return base.texels


def paint_scalp(picture, base, person):
    """Draw roots on the picture of the skin: strokes across the hairline, full within it."""
    look, width = person.look, PLACES["skin"][2]
    place, known = texels(base, person)
    known = known & (place[..., 1] > -6) & (place[..., 2] < 14)
    at = place[known]
    within = over_line(at, look) + look.get("uneven", 1) * uneven(at)
    noise = np.random.default_rng(3).random((64, 4096))
    noise = gaussian_filter(noise, (0, 0.7), mode="wrap")
    noise = (noise - noise.min()) / np.ptp(noise)
    soft = look["soft"]
    if "edges" in look:
        soft = soft * np.interp(around(at), *np.transpose(look["edges"]))
    turn = np.sign(at[:, 0]) * around(at) / 180 * np.pi * ROUND_CM
    turn = turn - look["slant"] * np.sign(at[:, 0] - look.get("parting", 0)) * within
    across = [(within / 0.6 + 9) % 64, (turn / 0.022) % 4096]  # strokes are .02 cm wide
    stroke = map_coordinates(noise, across, order=1, mode="wrap")
    if look["style"] == "coils":
        stroke = 0.55 + 0.15 * cloud(at, 0.05, 44)
    share = np.zeros(known.shape)
    share[known] = smooth((within + look.get("roots", 0)) / soft + 0.8 * (stroke - 0.55))
    share *= look["scalp"]
    if look["style"] == "long":  # the parting is lighter
        line = place[..., 0] - look["parting"] - 0.07 * cloud(place, 0.4, 43)
        line = np.exp(-((line / 0.12) ** 2)) * (place[..., 1] > 8.5)
        line[known] *= smooth(within / 2.0)
        share *= 1 - look["part_share"] * line * (place[..., 2] > -4)
    share = gaussian_filter(share, 0.6)[..., None]
    colour = np.array(look.get("root_colour", look["hair_colour"])) * 0.9 * look["root"]
    if look["style"] == "long":  # strands lie across the parting
        colour = colour * (1 + 0.14 * cloud(place * [0.1, 0.5, 1], 0.05, 45))[..., None]
    skin = picture[:, :width, :3]
    picture[:, :width, :3] = np.round(skin * (1 - share) + colour * share)


def paint_beard(picture, base, person):
    """Darken upper lip, jaw and chin by shaved hair."""
    look, width = person.look, PLACES["skin"][2]
    if "beard" not in look:
        return
    place, known = texels(base, person)
    x, y, z = np.moveaxis(place, -1, 0)
    far = np.abs(x)
    top = np.interp(
        far, [0, 1.3, 2.6, 3.6, 5.0, 6.2, 7.0], [-1.7, -1.75, -2.3, -4.2, -3.6, -1.8, 0.6]
    )
    jaw = (
        smooth((top - y) / 0.9)
        * smooth((y + 10.2 - 0.25 * (z - 6)) / 2.0)
        * smooth((z + 0.2) / 1.5)
    )
    lips = gaussian_filter(lips_of.outline(base, _sampled), 3)
    below = 1 - 0.35 * np.exp(-((np.hypot((far - 1.7) / 0.9, (y + 5.0) / 0.9)) ** 2))  # thin there
    share = jaw * below * np.clip(1 - 1.6 * lips, 0, 1) * known
    share = gaussian_filter(share, 12) / (gaussian_filter(known * 1.0, 12) + 1e-3)
    hairs = 0.85 + 0.15 * np.clip(_noise(share.shape, 0.6, 31), -1.5, 1.5)
    share = (look["beard"] * share * hairs)[..., None]
    skin = picture[:, :width, :3] / 255
    dark = skin * np.array([0.50, 0.54, 0.60])
    picture[:, :width, :3] = np.round(255 * (skin * (1 - share) + dark * share))


LID_SHADOW = 0.20
"""How much darker the white is below the upper lid than in the middle."""


def _eye(look, side=512):
    """Ball with iris, pupil, ring at the iris's rim and veins."""
    y, x = (np.indices((side, side)) + 0.5) / side * 2 - 1
    far, turn = np.hypot(x, y), np.arctan2(y, x)
    angle = EYE_EDGE * np.clip(far, 0, 1) ** (1 / 0.7)
    share = angle / IRIS
    assert abs(eye_place(IRIS) - (IRIS / EYE_EDGE) ** 0.7) < 1e-9
    veins = gaussian_filter(np.random.default_rng(2).normal(size=(side, side)), 5)
    veins = np.exp(-((veins / veins.std()) ** 2) * 60) * np.clip((share - 1.4) / 1.5, 0, 1)
    corner = smooth((share - 1.15) / 1.1)[..., None]
    white = np.array(look.get("white", (0.80, 0.742, 0.692))) * (1 - corner * [0.26, 0.38, 0.41])
    white = white * (1 - (0.1 + 0.35 * corner) * veins[..., None] * [0.2, 1, 1])
    white = white * (1 - LID_SHADOW * smooth(-0.1 - 1.6 * y)[..., None] * [0.8, 1.0, 1.1])
    spots = gaussian_filter(np.random.default_rng(4).normal(size=(side, side)), 12)
    white = white * (1 + 0.035 * (spots / spots.std())[..., None] * [0.2, 1, 1.3])
    rng = np.random.default_rng(3)

    def drawn(along, across):  # unit noise of (share, turn), smooth over so much of both
        field = gaussian_filter(rng.normal(size=(64, 2048)), (along, across), mode="wrap")
        at = [np.clip(share, 0, 1) * 63, (bent / (2 * np.pi) % 1) * 2047]
        return map_coordinates(field / field.std(), at, order=1, mode="wrap")

    bent = turn
    bent = turn + 0.05 * drawn(6, 30)  # no fibre is straight
    fibres = drawn(10, 5) + 0.7 * drawn(5, 1.6) - 1.1 * np.clip(drawn(5, 22) - 0.8, 0, 1.5)
    iris = np.array(look["iris"]) / 255 * (1 + 0.07 * drawn(30, 90))[..., None]
    inner = iris * [1.29, 1.13, 0.90]
    depth = 0.95 + 0.5 * np.clip(y / (far + 1e-6), -1, 1) * np.clip(share * 2 - 0.6, 0, 1)
    zone = share + 0.05 * drawn(20, 14)  # around the pupil, to a ragged collarette
    blend = np.clip((zone - 0.48) / 0.2, 0, 1)[..., None]
    collar = 0.16 * np.exp(-(((zone - 0.55) / 0.07) ** 2))
    colour = inner * (1 - blend) + iris * blend
    colour = colour * (1 + collar + 0.15 * fibres)[..., None]
    colour = colour * depth[..., None]  # light from above gathers in the lower half
    ring = smooth((share + 0.05 * drawn(30, 60) - 0.70) / 0.32) * (0.58 + 0.08 * drawn(30, 60))
    colour = colour * (1 - ring[..., None])
    pupil = np.clip((share - 0.31) / 0.07, 0, 1)[..., None]
    colour = colour * pupil + 0.012 * (1 - pupil)
    edge = smooth((share - 0.84) / 0.34)[..., None]
    return np.clip(colour * (1 - edge) + white * edge, 0, 1)


THICK_FROM = 0.9
"""Distance from its inner end at which a brow is as thick as it gets, cm."""


def brow_crop(person):
    """Least and greatest places of both brows in their own picture (v upwards)."""
    uv = np.concatenate([person.parts[name].uv for name in ("brow_L", "brow_R")])
    return uv.min(0), uv.max(0)


def _brow(base, person, side=512):
    """Hairs of both brows (512, 512, 4), and the soft ground of them (512, 512), to the rim of their mesh."""
    look = person.look
    path = "proxies/eyebrows/eyebrow{0}/textures/eyebrow{0}.png".format(look["brow"])
    alpha = np.asarray(Image.open(base.npm / path).convert("RGBA").getchannel("A"), float) / 255
    low, high = brow_crop(person)
    grid = (np.arange(side) + 0.5) / side
    x, y = low[0] + grid * (high[0] - low[0]), 1 - (high[1] - grid * (high[1] - low[1]))
    rows, columns = np.meshgrid(y * len(alpha) - 0.5, x * alpha.shape[1] - 0.5, indexing="ij")
    hairs = map_coordinates(alpha, [rows, columns], order=1, mode="nearest")
    inside, thick = np.zeros((side, side), bool), np.ones((side, side))
    for name in ("brow_L", "brow_R"):
        part, own = person.parts[name], Image.new("L", (side, side))
        corners = side * (part.uv - low) / (high - low)
        corners[:, 1] = side - corners[:, 1]
        for face in part.faces:
            ImageDraw.Draw(own).polygon([tuple(corners[v]) for v in face], 255, 255)
        out = np.abs(part.points[part.drawn, 0])  # from the middle of the face, about linear in uv
        plane = np.linalg.lstsq(np.insert(corners, 2, 1, axis=1), out, rcond=None)[0]
        own = np.asarray(own) > 0
        far = plane @ np.array([*np.nonzero(own)[::-1], np.ones(own.sum())])
        thick[own], inside = smooth((far - out.min()) / THICK_FROM), inside | own
    rim = smooth(distance_transform_edt(inside) / (0.05 * side))
    dense, ground = look["brow_hairs"]
    share = rim * (0.35 + 0.65 * thick)
    colour = np.array(look["brow_colour"]) / 255 * (1.25 - 0.4 * hairs[..., None])
    alpha = np.clip(dense * hairs, 0, 1) * share
    return np.dstack([colour, alpha]), ground * gaussian_filter(hairs * share, (9, 7))


BROW_CM = 0.4
"""How far from a brow's mesh the skin is of its ground."""


def paint_brows(picture, base, person):
    """Draw the ground of brows on the picture of the skin below them."""
    look, width = person.look, PLACES["skin"][2]
    _, ground = _brow(base, person)
    low, high = brow_crop(person)
    weights = np.array([(a, b, 8 - a - b) for a in range(9) for b in range(9 - a)]) / 8
    points, places = [], []
    for name in ("brow_L", "brow_R"):
        part = person.parts[name]
        points.append((weights @ part.points[part.drawn[part.faces]]).reshape(-1, 3))
        places.append((weights @ ((part.uv - low) / (high - low))[part.faces]).reshape(-1, 2))
    points, places = np.concatenate(points), np.concatenate(places)
    at = [(1 - places[:, 1]) * len(ground) - 0.5, places[:, 0] * len(ground) - 0.5]
    value = map_coordinates(ground, at, order=1, mode="nearest")
    uv = placed(skin_uv(base.uv), "skin")
    place, known = surface(person.skin, base.skin_faces, uv, base.uv_triangles, SIDE)
    place, known = place[:, :width], known[:, :width]
    inside = (place > points.min(0) - BROW_CM) & (place < points.max(0) + BROW_CM)
    rows, columns = np.nonzero(known & inside.all(-1))
    away, near = cKDTree(points).query(place[rows, columns], k=4)
    share = value[near].mean(1) * smooth((BROW_CM - away[:, 0]) / 0.2)
    skin = picture[rows, columns, :3]
    mixed = skin + share[:, None] * (np.array(look["brow_colour"]) - skin)
    picture[rows, columns, :3] = np.round(mixed)


def atlas(base, person):
    """One picture of all parts (2048, 2048, 4) uint8."""
    look = person.look
    out = np.ones((SIDE, SIDE, 4))

    def put(name, values):
        left, top, width, height = PLACES[name]
        values = np.asarray(values)
        if values.shape[:2] != (height, width):
            image = Image.fromarray(np.round(255 * values).astype(np.uint8))
            values = np.asarray(image.resize((width, height), Image.LANCZOS), float) / 255
        out[top : top + height, left : left + width, : values.shape[2]] = values

    proxies = base.npm / "proxies"
    put("skin", skin(base, person))
    put("hair", locks.hair(look))
    put("eye", _eye(look))
    put("brow", _brow(base, person)[0])
    put("teeth", teeth.picture(look))
    tongue = Image.open(proxies / "tongue/tongue01/textures/tongue01_diffuse.png").convert("RGB")
    put("tongue", np.asarray(tongue, float) / 255 * [0.80, 0.66, 0.64])
    lash = Image.open(proxies / "eyelashes/eyelashes02/textures/eyelashes02.png").convert("RGBA")
    alpha = np.asarray(lash.getchannel("A"), float) / 255
    alpha = np.minimum(1.2 * gaussian_filter(alpha, 0.7), 1) * (0.3 + 0.7 * look["lashes"])
    put("lash", np.dstack([np.full((*alpha.shape, 3), (0.085, 0.055, 0.04)), alpha]))
    cloth = 1 + 0.015 * _noise((256, 256), 9, 4)
    put("shirt", np.clip(0.93 * cloth, 0, 1)[..., None].repeat(3, 2))
    return np.round(255 * np.clip(out, 0, 1)).astype(np.uint8)


def pores():
    """Shade and tilt (512, 512, 3) of a square that repeats; 128 changes nothing."""
    shape = (PORES, PORES)
    pits = np.clip((_noise(shape, 3.4, 19) - 1.0) / 1.2, 0, 1)
    high = -1.0 * pits + sum(
        share * _noise(shape, width, 20 + k)
        for k, (width, share) in enumerate(((2.6, 0.12), (5.0, 0.22), (10.0, 0.22), (20.0, 0.08)))
    )
    # The picture's first row is the left ear's, its first column the crown's: to x and y.
    slope = [np.roll(high, -1, axis) - np.roll(high, 1, axis) for axis in (0, 1)]
    tilt = [0.26 * part / part.std() for part in slope]
    tone = sum(share * _noise(shape, width, 30 + k)
               for k, (width, share) in enumerate(((4.0, 0.5), (9.0, 0.45), (18.0, 0.25))))  # fmt: skip
    shade = (high - high.mean()) / high.std() + tone / tone.std()
    coded = np.stack([127.5 * (1 + part) for part in (0.22 * shade / shade.std(), *tilt)], -1)
    return np.clip(np.round(coded), 0, 255).astype(np.uint8)


def surface(points, faces, uv, uv_faces, side):
    """Points (side, side, 3) that the texels of a picture show, and which show any."""
    x, y = (side * uv.T).astype(np.float32)
    screen = Screen(side, side, x, y, np.zeros(len(uv), np.float32))
    place = np.zeros((len(uv), 3), np.float32)
    place[uv_faces.ravel()] = points[faces.ravel()]
    kept = front_faces(screen, uv_faces)
    if len(kept) < 0.4 * len(uv_faces):
        kept = front_faces(screen, uv_faces[:, ::-1])
    nearest, _ = nearest_faces(screen, kept)
    first, per_x, per_y = planes(screen, kept, place)
    row, column = np.indices((side, side)) + 0.5
    corner = kept[nearest, 0]
    at = first[nearest] + per_x[nearest] * (column - x[corner])[..., None]
    return at + per_y[nearest] * (row - y[corner])[..., None], nearest >= 0


# Creases of the average head at their full depth: forehead, glabella, crow's feet, nasolabial fold.


def creases(points, faces, uv, uv_faces, marks):
    """Tilt of the normals (128: none) and shade (255: none) of a picture of the skin.

    Parameters
    ----------
    points, faces : arrays
        Skin of the average head, cm.
    uv, uv_faces : arrays
        Its places in a person's picture.
    marks : dict
        `eye` (x, y), `mouth_y`, `wing` (x, y), `corner` (x, y), `brow_y`, cm.
    """
    at, known = surface(points, faces, uv, uv_faces, CREASES)
    far, high, deep = np.abs(at[..., 0]), at[..., 1], at[..., 2]
    step = 0.02
    height = _grooves(far, high, marks)
    along_x = (_grooves(far + step, high, marks) - height) / step
    along_y = (_grooves(far, high + step, marks) - height) / step
    tilt = np.stack([-along_x * np.sign(at[..., 0]), -along_y, 0 * far], -1)
    tilt *= 0.9 / np.maximum(np.linalg.norm(tilt, axis=-1, keepdims=True), 0.9)
    shade = 1 - 0.42 * np.clip(-height / 0.11, 0, 1)
    coded = np.concatenate([127.5 * (1 + tilt), 255 * shade[..., None]], -1)
    coded[~known | (deep < marks["deep"])] = (127.5, 127.5, 127.5, 255)
    return np.round(coded).astype(np.uint8)


def _smooth(x):
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def _groove(away, width, fade):
    bottom = np.exp(-((away / width) ** 2))
    ridges = np.exp(-(((np.abs(away) - 2.1 * width) / (1.1 * width)) ** 2))
    return fade * width * (0.15 * ridges - 0.7 * bottom)


def _grooves(x, y, marks):
    eye_x, eye_y = marks["eye"]
    brow_y = marks["brow_y"]
    height = np.zeros_like(x)
    for k, base in enumerate((1.1, 2.05, 2.95, 3.75)):  # forehead
        line = brow_y + base + 0.2 * np.cos(0.9 * x) - 0.02 * x**2 + 0.06 * np.cos(2.3 * x + k)
        height += _groove(y - line, 0.15, _smooth((4.6 - 0.25 * k - x) / 1.6) * (0.7 - 0.08 * k))
    knit = 0.58 + 0.16 * np.maximum(y - brow_y + 0.3, 0)  # glabella
    fade = _smooth((y - brow_y + 1.1) / 0.6) * _smooth((brow_y + 1.4 - y) / 0.8)
    height += _groove(x - knit, 0.16, 0.7 * fade)
    outer = x - eye_x - 1.75  # crow's feet
    for slope in (0.62, 0.18, -0.22, -0.62):
        fade = _smooth(outer / 0.35) * _smooth((1.75 - outer) / 0.7)
        height += _groove(y - eye_y - slope * (outer + 0.35) - 0.05, 0.085, 0.55 * fade)
    bag = eye_y - 1.45 + 0.16 * (x - eye_x) ** 2  # under the lower lid
    height += _groove(y - bag, 0.10, 0.7 * _smooth((1.7 - np.abs(x - eye_x)) / 0.9))
    (wing_x, wing_y), (corner_x, corner_y) = marks["wing"], marks["corner"]
    down = np.clip((wing_y + 0.45 - y) / (wing_y + 0.45 - corner_y), 0, 1.3)  # nasolabial
    near, out = wing_x + 0.22, corner_x + 0.95
    away = x - near - (out - near) * np.sin(0.5 * np.pi * down)
    away *= np.interp(down, [0, 0.6, 1], [0.55, 0.8, 1])  # across the fold, which lies aslant
    fade = _smooth(down / 0.3) * _smooth((1.3 - down) / 0.5)
    bottom = np.exp(-((away / np.where(away < 0, 0.42, 0.24)) ** 2))  # the cheek hangs over it
    cheek = np.exp(-(((away - 0.62) / 0.4) ** 2))
    return height + fade * (0.05 * cheek - 0.085 * bottom)
