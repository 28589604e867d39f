"""Shapes and seal of the head, over the state of `Base`: the same for every person.

Most shapes were carried from this project's former procedural head to the new skin
(`former_shapes.npz`, made once by `rig.retarget.methods.carry_shapes`). Face units replace or join
them where they look better (`MIX`); ``flesh.csv`` adds mounds, folds and lids that go with a muscle
(half of a control, which lip or both, place and radii on the average head, cm, displacement, share
kept at the lips); formulas move tongue, lower teeth and ears.
"""

from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import gaussian_filter1d
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from rig.face.head import CORRECTIVES, LID_RAISERS
from rig.files.reading import rows_of
from tools.heads.base import CM, Base, eye_of

SHARE = {
    "brow_lateral": 1.1, "mouth_cornerPull": 0.55, "sharpCornerPull": 0.7, "cheekRaise": 0.6,
    "mouth_purse": 0.58, "mouth_funnel": 0.55, "upperLipRaise": 0.3, "lowerLipDepress": 0.5,
    "brow_down": 0.4, "brow_raiseIn": 0.5, "brow_raiseOut": 0.4, "eye_blink": 0, "blink_half": 0,
    "eye_eyelidU": 0, "squintInner": 0.4, "_nose.ty": 0.6, "cornerDepress": 0.4, "eye_eyelidD": 0.3, "eye.t": 0,
}  # fmt: skip
"""Share of the carried shape that is kept, by a part of its name; 1 for the others."""
MIX = {
    "mouth_lipBiteD.ty": ("rollD_@:.35 closeD_@:.12 mouthUpperUp_@:.28", ""),
    "mouth_cornerPull.ty": ("mouthSmile_@:.42 mouthUpperUp_@:.12", ""),
    "mouth_sharpCornerPull.ty": ("mouthSmile_@:.25 mouthDimple_@:.2", ""),
    "eye_cheekRaise.ty": ("cheekSquint_@:.65 eyeSquint_@:.2", ""),
    "mouth_purseU.ty": ("puckerU_@:.38", ""),
    "mouth_purseD.ty": ("puckerD_@:.38", ""),
    "mouth_funnelU.ty": ("funnelU_@:.5", ""),
    "mouth_funnelD.ty": ("funnelD_@:.5", ""),
    "mouth_upperLipRaise.ty": ("mouthUpperUp_@:.8", ""),
    "mouth_lowerLipDepress.ty": ("mouthLowerDown_@:.55", ""),
    "brow_down.ty": ("browDown_@:.7", ""),
    "brow_raiseIn.ty": ("browInnerUp_@:1.3", ""),
    "brow_raiseOut.ty": ("browOuterUp_@:1", ""),
    "eye_blink.ty": ("eyeBlink_@:1", "eyeWide_@:.85"),
    "eye_eyelidU.ty": ("lidU_@:.4", "eyeWide_@:.8"),
    "eye_squintInner.ty": ("eyeSquint_@:.8", ""),
    "eye_eyelidD.ty": ("lidD_@:.8", "lidD_@:-.35"),
    "nose.ty": ("noseSneer_@:.7", ""),
    "eye.ty": ("eyeLookUp_@:1.2", "eyeLookDown_@:1.5"),
    "mouth_dimple.ty": ("mouthDimple_@:.3", ""),
    "mouth_cornerDepress.ty": ("mouthFrown_@:.5", ""),
}
"""Face units of the positive and the negative half of ``CTRL_@_`` controls, with factors."""
LID_EDGE = {
    "eye_cheekRaise.ty": 0.5, "eye_squintInner.ty": 0.6, "eye_eyelidD.ty": 0.8, "mouth_cornerPull.ty": 0.75,
}  # fmt: skip
"""Share of the rise of the lower lid's edge that is kept: the flesh below it rises and swells."""
COLUMNS = np.linspace(-2.6, 2.6, 53)
"""Places along the lips at which they are sealed, cm of the average head."""
CORNERS = np.array([(2.56, -3.63, 9.49), (-2.56, -3.63, 9.49)])
"""Corners of the average mouth, left first, cm."""
LIMIT_X = 2.75
DEPTH = 1.5
"""Radius forwards of what ``flesh.csv`` moves, cm."""
TONGUE_UP = 1.0
_BROW = (("raiseIn", 1.1, 5.1, 0.27), ("raiseIn", 5.2, 5.0, -0.14), ("raiseOut", 1.1, 5.1, -0.11),
         ("raiseOut", 3.0, 5.5, 0.34))  # fmt: skip
"""Half of a control of the brow, where (x, y) and how far up it moves the skin besides, cm."""
TEETH_AWAY = (0, -0.95, -0.6)
"""What an open jaw moves its front teeth beside its turn, cm: back as the skin goes, and behind the
lower lip, which covers all but their edges."""


def _sigmoid(x):
    return 1 / (1 + np.exp(-x))


class Shapes:
    """Shapes over the state of a base, and the lips' seal."""

    def __init__(self, base: Base) -> None:
        self.base = base
        n = self.n = base.n_skin
        self.average = CM * base.state(base.average) - base.origin(base.average)
        skin = self.average[:n]
        units = base.face_units()
        front = (skin[:, 2] > 9.2) & (np.abs(skin[:, 0]) < 1.6)
        roll = {k: np.linalg.norm(units[f"mouthRoll{k}"][:n], axis=1) for k in ("Upper", "Lower")}
        self.away = [self.along(np.flatnonzero((roll[k] > least) & front))
                     for k, least in (("Upper", 0.75), ("Lower", 0.45))]  # fmt: skip
        self.left = _sigmoid(self.average[:, 0] / 0.42)
        self.upper = np.full(len(self.average), 0.5)
        self.upper[:n] = _sigmoid((self.away[1] - self.away[0]) / 0.25)
        for name, share in (("upper-teeth", 1), ("lower-teeth", 0), ("tongue", 0)):
            self.upper[base.at(f"helper-{name}")] = share
        self._find_rims()
        self.relax = self._relaxation()
        self.rest = self.rest_of(base.average)
        self.units = self._derived(units)

    def inside(self):
        """Points of the skin in the mouth: those that lips and corners cut off from the face."""
        skin, faces = self.average[: self.n], self.base.skin_faces
        corners = [np.argmin(np.linalg.norm(skin - at, axis=1)) for at in CORNERS]
        free = (self.along(np.concatenate(self.rims)) > 0.1) & (self.along(corners) > 0.4)
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
        edges = edges[free[edges].all(1)]
        graph = sp.coo_matrix((np.ones(len(edges)), tuple(edges.T)), shape=(self.n, self.n))
        piece = connected_components(graph, directed=False)[1]
        return piece == piece[cKDTree(skin).query([0, -3.6, 8.0])[1]]

    def along(self, seeds):
        """Distance along the average skin from points."""
        points, faces = self.average[: self.n], self.base.skin_faces
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        graph = sp.coo_matrix((length, tuple(edges.T)), shape=(self.n, self.n)).tocsr()
        return dijkstra(graph.maximum(graph.T), indices=seeds, min_only=True)

    def _find_rims(self):
        """Where the lips touch, weights of those points at each column, and what follows them."""
        skin = self.average[: self.n]
        up, low = self.away
        near = (np.minimum(up, low) < 2.2) & (skin[:, 2] > 9.2)
        above, below = np.flatnonzero(near & (up < low)), np.flatnonzero(near & (low <= up))
        touch = [a[cKDTree(skin[b]).query(skin[a])[0] < 0.22]
                 for a, b in ((above, below), (below, above))]  # fmt: skip
        self.rims = [ids[skin[ids, 2] > skin[ids, 2].max() - 1.6] for ids in touch]
        self.rim_weights = []
        for ids in self.rims:
            weights = np.exp(-(((skin[ids, 0] - COLUMNS[:, None]) / 0.12) ** 2)) + 1e-9
            weights[weights < 0.02 * weights.max(1, keepdims=True)] = 0
            self.rim_weights.append(weights / weights.sum(1, keepdims=True))
        self.reach, self.reach_share = [], []
        for ids, one, other in ((self.rims[0], up, low), (self.rims[1], low, up)):
            is_own = (one < other) if ids is self.rims[0] else (one <= other)
            reach = np.flatnonzero(is_own & (one < 3.2) & (skin[:, 2] > 7.5))
            share = np.exp(-((self.along(ids)[reach] / 0.75) ** 2))
            self.reach.append(reach[share > 0.004])
            self.reach_share.append(share[share > 0.004])
        self.fade = np.clip((LIMIT_X - np.abs(COLUMNS)) / 0.35, 0, 1)

    def sealed(self, state, amount=1.0, parts=(0.5, 0.5)):
        """A state whose lips are brought together; where they cross they are set apart."""
        out = state.copy()
        gap = self.rim_weights[0] @ state[self.rims[0]] - self.rim_weights[1] @ state[self.rims[1]]
        gap = gap * self.fade[:, None] * np.where(gap[:, 1] < 0, 1, amount)[:, None]
        for ids, share, part in zip(
            self.reach, self.reach_share, (-parts[0], parts[1]), strict=True
        ):
            move = np.stack([np.interp(self.average[ids, 0], COLUMNS, g) for g in gap.T], 1)
            out[ids] += part * move * share[:, None] * [0.6, 1, 1]
        return out

    def rest_of(self, points):
        """State of a person at rest, cm, lips closed."""
        state = CM * self.base.state(points) - self.base.origin(points)
        for _ in range(4):
            state = self.sealed(state)
        state[: self.n] = self.relax @ state[: self.n]
        return self.sealed(self._parted(self.sealed(state)))

    def _parted(self, state):
        """A state whose lips meet along one smooth line: neither reaches beyond it in front."""
        rows = [w @ state[ids, 1] for w, ids in zip(self.rim_weights, self.rims, strict=True)]
        out, across, soft = state.copy(), self.average[: self.n, 0], 0.012
        seam = np.interp(across, COLUMNS, gaussian_filter1d(np.mean(rows, 0), 2.0))
        front = state[self.rims[0], 2].max() - 1.6
        up, low = self.away
        near = (
            (np.minimum(up, low) < 1.6) & (np.abs(across) < LIMIT_X) & (state[: self.n, 2] > front)
        )
        for is_own, sign in ((up < low, 1), (low <= up, -1)):
            ids = np.flatnonzero(near & is_own)
            over = sign * (state[ids, 1] - seam[ids])
            share = np.interp(np.abs(across[ids]), [LIMIT_X - 0.6, LIMIT_X], [1, 0])
            away = 0.5 * (over + np.sqrt(over**2 + soft**2)) - over
            out[ids, 1] += sign * share * away
        return out

    def _relaxation(self):
        """Matrix (skin, skin) that smooths the corners of the mouth, where the lips fold."""
        corners = [np.argmin(np.linalg.norm(self.average[: self.n] - at, axis=1)) for at in CORNERS]
        share = np.exp(-((self.along(corners) / 0.45) ** 2))
        share[share < 0.02] = 0
        a, b = self.base.quads, np.roll(self.base.quads, -1, 1)
        ends = np.concatenate([a.ravel(), b.ravel()]), np.concatenate([b.ravel(), a.ravel()])
        beside = sp.coo_matrix((np.ones(len(ends[0])), ends), shape=(self.n, self.n)).tocsr()
        mean = sp.diags(1 / np.maximum(np.asarray(beside.sum(1)).ravel(), 1)) @ beside
        return (sp.diags(1 - share) + sp.diags(share) @ mean) ** 6

    def _derived(self, units):
        """Face units, split by side and lip, and what else `MIX` names."""

        def side(delta, s):
            return delta * (self.left if s == "L" else 1 - self.left)[:, None]

        inside = (np.abs(self.average[:, 0]) < 1.85) & (self.average[:, 2] < 7.7)  # of the nose
        found = {
            name: delta * ~inside[:, None] if name[:3] in ("eye", "bro", "che", "nos") else delta
            for name, delta in units.items()
        }
        lips = {"U": self.upper, "D": 1 - self.upper}
        for name in ("browInnerUp", "cheekPuff"):
            for s in "LR":
                found[f"{name}_{s}"] = side(units[name], s)
        for s, word in (("L", "l"), ("R", "r")):
            for u, row in lips.items():
                for name, source in (("pucker", "mouthPucker"), ("funnel", "mouthFunnel")):
                    found[f"{name}{u}_{s}"] = side(units[source] * row[:, None], s)
                source = "mouthRollUpper" if u == "U" else "mouthRollLower"
                found[f"roll{u}_{s}"] = side(units[source], s)
            found[f"closeD_{s}"] = side(units["mouthClose"] * lips["D"][:, None], s)
            eye = self.average[self.base.at(f"helper-{word}-eye")].mean(0)
            high = _sigmoid((self.average[:, 1] - eye[1] + 0.15) / 0.12)[:, None]
            found[f"lidU_{s}"] = found[f"eyeBlink_{s}"] * high
            found[f"lidD_{s}"] = found[f"eyeSquint_{s}"] * (1 - high)
        return found

    def merged(self, controls):
        """Names and displacements (K, state, 3) of all shapes."""
        with np.load(Path(__file__).with_name("former_shapes.npz")) as stored:
            names = [str(name) for name in stored["names"]]
            deltas = np.zeros((len(names), len(self.average), 3), np.float32)
            deltas[stored["shape"], stored["point"]] = stored["delta"] * stored["step"]
        for k, name in enumerate(names):
            deltas[k] *= next((v for part, v in SHARE.items() if part in name), 1.0)
        place = {name: k for k, name in enumerate(names)}
        for control, halves in MIX.items():
            for s in "LR":
                for text, end in zip(halves, ("", "_negative"), strict=True):
                    for word in text.replace("@", s).split():
                        unit, _, gain = word.partition(":")
                        k = place[f"CTRL_{s}_{control}{end}"]
                        deltas[k] += float(gain) * self.units[unit].astype(np.float32)
        for s in "LR":
            for end in ("", "_negative"):
                deltas[place[f"CTRL_C_eye.ty{end}"]] += deltas[place[f"CTRL_{s}_eye.ty{end}"]]
        for s in "LR":  # lids go a little with a look aside
            for end, way in (("", "Out" if s == "L" else "In"),
                             ("_negative", "In" if s == "L" else "Out")):  # fmt: skip
                look = 0.7 * self.units[f"eyeLook{way}_{s}"].astype(np.float32)
                deltas[place[f"CTRL_{s}_eye.tx{end}"]] += look
                deltas[place[f"CTRL_C_eye.tx{end}"]] += look
        for name, delta in self._flesh().items():
            deltas[place[name]] += delta.astype(np.float32)
        for s in "LR":
            lids = self._lids(s, 0.55)[:, None]
            for control, share in LID_EDGE.items():
                deltas[place[f"CTRL_{s}_{control}"]][: self.n] *= 1 - (1 - share) * lids
        added = self._mouth(deltas[place["CTRL_C_jaw.ty"]]) | self._more(deltas, place)
        for name, delta in added.items():
            if name not in place:
                place[name] = len(names)
                names.append(name)
                deltas = np.concatenate([deltas, np.zeros_like(deltas[:1])])
            deltas[place[name]] += delta.astype(np.float32)
        for s in "lr":
            deltas[:, self.base.at(f"helper-{s}-eye")] = 0
        deltas = self._symmetric(names, deltas)
        for delta in deltas:
            delta[: self.n] = self.relax @ delta[: self.n]
        known = {half for name in controls.names for half in (name, f"{name}_negative")}
        known |= {*CORRECTIVES, "seal"}
        assert not (wrong := set(names) - known), wrong
        return names, deltas

    def _lids(self, s, reach=0.3):
        """How near to the edges of one eye's lids (L or R) points of the skin are, 0 to 1."""
        center, radius = eye_of(self.average, self.base, s.lower())
        above = np.linalg.norm(self.average[: self.n] - center, axis=1) / radius - 1.1
        return np.exp(-((np.maximum(above, 0) / reach) ** 2))

    def _flesh(self):
        """What goes with the muscles: mounds, folds and lids of ``flesh.csv``, of both sides."""
        lips = np.exp(-((np.minimum(*self.away) / 0.55) ** 2))
        skin, found = self.average[: self.n], {}
        upper = self.upper[: self.n]
        of = {"both": 1, "upper": upper, "lower": 1 - upper}
        for row in rows_of(Path(__file__).with_name("flesh.csv")):
            what = {key: float(row[key]) for key in list(row)[3:]}
            size = np.array([what["across"], what["high"], DEPTH])
            for s, sign in (("L", 1), ("R", -1)):
                middle = np.array([sign * what["x"], what["y"], what["z"]])
                share = np.exp(-((((skin - middle) / size) ** 2).sum(1)))
                share *= of[row["lip"]] * (1 - (1 - what["lips"]) * lips)
                moved = np.outer(share, [sign * what["dx"], what["dy"], what["dz"]])
                half = row["half"] if "CTRL" in row["half"] else f"CTRL_{s}_{row['half']}"
                found.setdefault(half, np.zeros_like(self.average))[: self.n] += moved
        return found

    def _symmetric(self, names, deltas):
        """Shapes whose left and right, or ends to the left and right, are mirrored."""
        x = self.average
        mirror = np.concatenate(
            [
                a + cKDTree(x[a:b]).query(x[a:b] * [-1, 1, 1])[1]
                for a, b in ((0, self.n), (self.n, len(x)))
            ]
        )
        out = deltas.copy()
        for k, name in enumerate(names):
            other = name
            if "CTRL_L_" in name or name.endswith("_L"):
                other = name.replace("CTRL_L_", "CTRL_R_").removesuffix(
                    "_L"
                ) + "_R" * name.endswith("_L")
            elif "CTRL_R_" in name or name.endswith("_R"):
                other = name.replace("CTRL_R_", "CTRL_L_").removesuffix(
                    "_R"
                ) + "_L" * name.endswith("_R")
            if "lipShift" in name or (".tx" in name and ("CTRL_C_" in name or "_eye.tx" in name)):
                ends = (other.removesuffix("_negative"), other + "_negative")
                other = ends[0] if other.endswith("_negative") else ends[1]
            if other in names:
                out[k] = 0.5 * (deltas[k] + deltas[names.index(other)][mirror] * [-1, 1, 1])
        return out

    def _mouth(self, jaw):
        """Lower teeth and tongue by the jaw, both rows of teeth, and the tongue by its controls."""
        base, x, found = self.base, self.average, {}
        low = np.concatenate([base.at("helper-lower-teeth"), base.at("helper-tongue")])
        chin = np.argmin(np.linalg.norm(x[: self.n] - [0, -7.0, 9.9], axis=1))
        share = jaw[chin, 1] / self.units["jawOpen"][chin, 1]
        for name, unit, gain in (
            ("CTRL_C_jaw.ty", "jawOpen", share), ("CTRL_C_jaw_openExtreme.ty", "jawOpen", 0.35 * share),
            ("CTRL_C_jaw.tx", "jawRight", 0.8), ("CTRL_C_jaw.tx_negative", "jawLeft", 0.8),
            ("CTRL_C_jaw_fwdBack.ty", "jawForward", -0.6),
            ("CTRL_C_jaw_fwdBack.ty_negative", "jawForward", 0.6),
        ):  # fmt: skip
            found[name] = np.zeros_like(x)
            found[name][low] = gain * self.units[unit][low]
        front = np.clip((x[low, 2] - 3) / 4, 0, 1)
        found["CTRL_C_jaw.ty"][low] += np.outer(front, TEETH_AWAY)
        for row, letter in (("upper", "U"), ("lower", "D")):
            teeth = base.at(f"helper-{row}-teeth")
            for control, move in ((f"teeth{letter}.ty", [0, 1, 0]), (f"teeth{letter}.tx", [1, 0, 0]),
                                  (f"teeth_fwdBack{letter}.ty", [0, 0, -1])):  # fmt: skip
                for end, sign in (("", 0.25), ("_negative", -0.25)):
                    found[f"CTRL_C_{control}{end}"] = np.zeros_like(x)
                    found[f"CTRL_C_{control}{end}"][teeth] = sign * np.array(move)
        for name, moved in self._tongue().items():
            found.setdefault(name, np.zeros_like(x))[base.at("helper-tongue")] += moved
        return found

    def _tongue(self):
        """Displacements of the tongue's points by halves of its controls."""
        x = self.average[self.base.at("helper-tongue")]
        back = (x[:, 2].max() - x[:, 2]) / np.ptp(x[:, 2])
        front, tip = 1 - back, np.clip(1 - back / 0.5, 0, 1) ** 1.5
        body = np.sin(np.pi * np.clip(0.12 + 0.8 * back, 0, 1))
        hold = np.clip(front * 3, 0, 1)
        zero, across = np.zeros_like(back), x[:, 0]
        tall = x[:, 1] - np.median(x[:, 1])

        def both(control, move, negative=None):
            move, negative = np.stack(move, 1), -np.stack(negative or move, 1)
            return {f"CTRL_C_tongue_{control}": move * hold[:, None],
                    f"CTRL_C_tongue_{control}_negative": negative * hold[:, None]}  # fmt: skip

        def turn(s):
            return [-tall * s * front, across * s * front, zero]

        up = [zero, TONGUE_UP * body, 0.1 * body]
        return {
            **both("inOut.ty", [zero, zero, -1.3 * front], [zero, -0.5 * front**0.6, -3.3 * front**0.9]),
            **both("move.ty", up, [zero, 0.6 * TONGUE_UP * body, zero]),
            **both("move.tx", [0.85 * front**0.8, zero, zero]),
            **both("tipMove.ty", [zero, 0.8 * tip, 0.15 * tip]),
            **both("tipMove.tx", [0.75 * tip, zero, zero]),
            **both("bendTwist.ty", [zero, 0.75 * (tip - 0.35 * body), zero]),
            **both("bendTwist.tx", turn(0.5)),
            **both("wideNarrow.ty", [0.22 * across * (1 - 0.5 * back), -0.1 * tall, zero]),
            **both("thickThin.ty", [zero, 0.35 * tall, zero]),
            "CTRL_C_tongue_press.ty": np.stack([zero, 0.6 * body, zero], 1) * hold[:, None],
            "CTRL_C_tongue_roll.ty": np.stack(
                [-0.2 * across * front, 0.42 * (across / 1.6) ** 2 * front, zero], 1
            ) * hold[:, None],
            "CTRL_C_jaw.ty": np.stack(
                [0.45 * across * front, (0.22 + 0.3 * (across / 1.6) ** 2) * front + 0.08 * body, 0.35 * front], 1
            ) * hold[:, None],
        }  # fmt: skip

    def _more(self, deltas, place):
        """Ears, swallowing, the nose's upper wrinkle: what the former shapes lack."""
        x, found = self.average, {}
        for s, sign in (("L", 1), ("R", -1)):
            ear = _sigmoid((sign * x[:, 0] - 7.05) / 0.2) * np.exp(-(((x[:, 1] - 1.5) / 4.5) ** 4))
            ear = ear * (np.arange(len(x)) < self.n)
            found[f"CTRL_{s}_ear_up.ty"] = np.outer(ear, [0.06 * sign, 0.32, -0.05])
            for half, across, high, up in _BROW:
                at = np.array([sign * across, high, 9.8])
                share = np.exp(-(((x - at) / [1.3, 1.4, 2.4]) ** 2).sum(1))
                half = f"CTRL_{s}_brow_{half}.ty"
                found[half] = found.get(half, 0) + np.outer(share, [0, up, 0])
            knit = np.exp(-(((x - [0.9 * sign, 3.9, 10.6]) / [0.8, 0.8, 1.2]) ** 2).sum(1))
            knit = np.outer(knit, [-0.06 * sign, -0.16, 0.08])
            found[f"CTRL_{s}_nose.ty"], found[f"nose_upper_{s}"] = knit, -knit
            lids = self._lids(s)[:, None]
            for stem in LID_RAISERS:
                moved = found[f"blink_{stem}_{s}"] = np.zeros_like(x)
                moved[: self.n] = -lids * deltas[place[f"CTRL_{s}_{stem}.ty"]][: self.n]
        up = deltas[place["CTRL_neck_throatUpDown.ty"]]
        down = deltas[place["CTRL_neck_digastricUpDown.ty"]]
        found["CTRL_C_neck_swallow.ty"] = 1.1 * up + 0.5 * down
        return found
