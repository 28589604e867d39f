"""Heads: arrays of `rig.face.head_file`, and vertices for the 185 controls.

A pose is: linear shapes with weights of control halves; lids kept out of the eyes; lips brought
together by the seal, and set apart where they cross; lashes and brows with the skin below them;
eyes turned. `Head.motion` has all numbers of it, which the preview page uses as they are.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.arrays import AnyFloat, Bool, Float32, Float64, Int64
from rig.controls import default_controls
from rig.errors import RigError
from rig.face.head_file import (
    GRID,
    PICTURES,
    Arrays,
    embedded,
    embedded_pictures,
    opened,
    read_head,
    small_atlas,
)
from rig.face.identity import Identity, resolve_identity
from rig.face.mesh import Maps, Mesh, smoothstep
from rig.files.reading import rows_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array

UNIT_MM = 10.0
"""The heads are in centimetres."""
GAZE_DEGREES = {"side": 40.0, "up": 30.0, "down": 35.0}
"""Full gaze; a MetaHuman's board has about these."""
UPPER_PART = 0.4
"""Share of the lips' gap by which the upper lip comes down to meet the lower."""
FINISH = (0.5, 0.8)
"""A second seal brings what is left of the gap to nothing between these amounts of the first: lips
that are nearly sealed are shut."""
ALONG = np.array([0.6, 1.0, 1.0], np.float32)
"""Share of the gap that is closed sideways, up and forward."""
LID_CLEARANCE = 1.02
"""Least distance of a lid from the middle of the eye, in radii."""
MOUTH = ("teeth_upper", "teeth_lower", "tongue")
"""Parts in the mouth, in their order."""
MOUTH_LIGHT = 0.45
"""Most baked light of skin in the mouth."""
MOUTH_REACH = np.array([[1.0, 2.5, 4.0], [1.0, 1.8, 0.0]])
"""How far it reaches below and above the box of the parts in it, cm."""
BATCH, FEW, MANY = 64, 16, 16
"""Frames that are posed together; of these, those whose sums of shapes stay in the cache; weights a
shape that are worth the import of sparse matrices."""
STEPS = ("lid_L", "lid_R", "lips", "follow", "eyes", "seam")
"""What a pose does after its shapes, in this order."""
Half = tuple[str, ...]
LID_RAISERS = ("eye_cheekRaise", "eye_squintInner", "eye_eyelidD", "mouth_cornerPull", "nose")
"""Controls that raise the lower lid, which a blink takes back so that lids never cross."""
CORRECTIVES: dict[str, tuple[Half, Half]] = {
    "jaw_half": (("CTRL_C_jaw.ty",), ()),
    **{
        f"blink_{stem}_{s}": ((f"CTRL_{s}_eye_blink.ty",), (f"CTRL_{s}_{stem}.ty",))
        for s in "LR"
        for stem in LID_RAISERS
    },
    **{f"blink_half_{s}": ((f"CTRL_{s}_eye_blink.ty",), ()) for s in "LR"},
    **{
        f"seal_{s}": (
            ("CTRL_C_jaw.ty",),
            (f"CTRL_{s}_mouth_lipsTogetherU.ty", f"CTRL_{s}_mouth_lipsTogetherD.ty"),
        )
        for s in "LR"
    },
    **{
        f"nose_upper_{s}": ((f"CTRL_{s}_nose.ty",), (f"CTRL_{s}_nose_wrinkleUpper.ty_negative",))
        for s in "LR"
    },
}
"""Shapes that several halves of controls drive: the product of the least of each group; one named
``half`` is full where that is 0.5 and gone at 0 and 1."""


@dataclass(frozen=True)
class Lip:
    """What the seal moves of one lip.

    `rim` (n,) vertices touch the other lip, by `weight` (P, n) at each of P columns; `reach` (m,)
    vertices move with column `column` (m,), a fraction between two of them, by `share` (m,).
    """

    rim: Int64
    weight: Float32
    reach: Int64
    column: Float32
    share: Float32

    @cached_property
    def spread(self) -> Float32:
        """Movement of each vertex of `reach` (m, P) by those of the columns, but for `ALONG`."""
        count, rows = len(self.weight), np.arange(len(self.reach))
        low = np.minimum(self.column.astype(np.int64), count - 2)
        part = self.column - low
        found = np.zeros((len(rows), count), np.float32)
        found[rows, low], found[rows, low + 1] = self.share * (1 - part), self.share * part
        return found

    @cached_property
    def fed_back(self) -> Float32:
        """Movement of the columns' own means (P, P) by movements of the columns."""
        place = {int(vertex): row for row, vertex in enumerate(self.reach)}
        moved = np.zeros((len(self.rim), len(self.weight)), np.float32)
        for row, vertex in enumerate(self.rim):
            if int(vertex) in place:
                moved[row] = self.spread[place[int(vertex)]]
        return self.weight @ moved

    def along(self, move: Float32) -> Float32:
        """Movement (T, m, 3) of `reach` of movements of the columns (T, P, 3)."""
        return np.moveaxis(np.tensordot(self.spread, move, (1, 1)), 0, 1) * ALONG

    def within(self, count: int) -> "Lip":
        """The lip's part of the first `count` vertices."""
        rim, reach = self.rim < count, self.reach < count
        weight = self.weight[:, rim] + np.float32(1e-12)
        return Lip(self.rim[rim], weight / weight.sum(1, keepdims=True), self.reach[reach],
                   self.column[reach], self.share[reach])  # fmt: skip


class EmbeddedMaps(Maps):
    """Maps of an embedded head, which take longer to decode than all else: when wanted."""

    name: str

    def __init__(self, name: str) -> None:
        vars(self)["name"] = name

    def __getattr__(self, name: str) -> NDArray[np.uint8]:
        if name not in PICTURES:
            raise AttributeError(name)
        picture = np.asarray(opened(embedded_pictures(self.name)[name], name))
        vars(self)[name] = picture
        return picture

    @cached_property
    def _small(self) -> NDArray[np.uint8]:
        return np.asarray(opened(small_atlas(self.name), "atlas"))

    def atlas_for(self, side: float) -> NDArray[np.uint8]:
        """The atlas, or that of half its side where this is enough."""
        return self._small if side < 2 * len(self._small) else self.atlas


@dataclass(frozen=True)
class Motion:
    """All numbers of a pose, of H halves of controls, K shapes and P columns of the lips.

    Attributes
    ----------
    names : tuple of str
        Of the shapes: a half of a control, or one of `CORRECTIVES`.
    drivers : ndarray [shape=(K, 2, 2)]
        Halves of each shape: the product of the least of each pair. Control c is half c towards
        its maximum and C + c towards its minimum; 2 C is always 1.
    is_peak : array of bool [shape=(K,)]
    gain : ndarray [shape=(K,)]
        Of the person.
    starts : ndarray [shape=(K + 1,)]
        Where each shape's entries begin in `vertex` and `delta`.
    vertex : ndarray [shape=(E,)]
    delta : ndarray of int16 [shape=(E, 3)]
        Displacements, in steps of `step`, cm.
    inputs : tuple of str
        Of ``bindings.csv``, for seal and creases.
    bind : ndarray [shape=(H, J)]
        Inputs of halves.
    lips : tuple of Lip
        Upper and lower.
    profiles : tuple of ndarray [shape=(J, P)]
        How far each input seals the upper and the lower lip at each column.
    fade : ndarray [shape=(P,)]
    """

    names: tuple[str, ...]
    drivers: Int64
    is_peak: Bool
    gain: Float32
    starts: Int64
    vertex: Int64
    delta: NDArray[np.int16]
    step: float
    inputs: tuple[str, ...]
    bind: Float32
    lips: tuple[Lip, Lip]
    profiles: tuple[Float32, Float32]
    fade: Float32

    def halves(self, values: Float64) -> Float64:
        """Travel (T, 2 C + 1) of each half of each control, 0 to 1; the last column is 1."""
        controls = default_controls()
        rest, moved = controls.rest, values - controls.rest
        up, down = controls.maximum - rest, rest - controls.minimum
        return np.concatenate(
            [np.clip(moved / np.where(up > 0, up, np.inf), 0, 1),
             np.clip(-moved / np.where(down > 0, down, np.inf), 0, 1), np.ones((len(values), 1))], 1
        )  # fmt: skip

    def weights(self, halves: Float64) -> Float64:
        """Weights (T, K) of the shapes."""
        product = halves[:, self.drivers].min(-1).prod(-1)
        peak = 1 - np.abs(2 * product - 1)
        return np.asarray(np.where(self.is_peak, peak, product) * self.gain)

    def shape(self, k: int) -> tuple[Int64, Float32]:
        """Vertices (n,) that shape k moves, and their displacements (n, 3), cm, without gain."""
        part = slice(self.starts[k], self.starts[k + 1])
        return self.vertex[part], self.delta[part] * np.float32(self.step)


def _bind() -> tuple[tuple[str, ...], Float32]:
    controls = default_controls()
    rows = [
        {name: cell.replace("@", s) for name, cell in row.items()}
        for row in rows_of("face/bindings.csv")
        for s in ("LR" if "@" in row["control"] else "C")
    ]
    inputs = tuple(dict.fromkeys(row["input"] for row in rows))
    table = np.zeros((2 * len(controls.names) + 1, len(inputs)), np.float32)
    for row in rows:
        table[controls.index(row["control"]), inputs.index(row["input"])] += float(row["gain"])
    return inputs, table


def _profiles(inputs: tuple[str, ...], columns: Float32) -> tuple[Float32, Float32]:
    """How far each input seals each lip (J, P): whole, outer, inner or central, of one side."""
    left, far = smoothstep(columns.astype(np.float64) / 1.2 + 0.5), np.abs(columns) / 2.5
    spread = {
        "": np.ones_like(far), "inner": np.exp(-(((far - 0.45) / 0.28) ** 2)),
        "outer": smoothstep((far - 0.55) / 0.3), "center": np.exp(-((far / 0.35) ** 2)),
    }  # fmt: skip
    found = np.zeros((2, len(inputs), len(columns)), np.float32)
    for j, name in enumerate(inputs):
        kind, _, side = name.removeprefix("seal.").partition("_")
        for lip, word in enumerate(("upper", "lower")):
            if name.startswith("seal.") and kind.lower().endswith(word):
                share = spread[kind.lower().removesuffix(word)]
                found[lip, j] = share * {"L": left, "R": 1 - left, "": 1}[side]
    return found[0], found[1]


def _motion(stored: Arrays) -> Motion:
    names = tuple(map(str, stored["names"]))
    starts = np.concatenate([[0], np.cumsum(stored["count"])])
    # Columns are stored as differences within each shape.
    total = np.cumsum(stored["columns"].astype(np.int64))
    before = np.concatenate([[0], total])[starts[:-1]]
    vertex, delta = total - np.repeat(before, stored["count"]), stored["values"].T
    purse = np.array(["mouth_purse" in name or "mouth_towards" in name for name in names])
    blink = np.array([name.endswith("eye_blink.ty") or "blink_half" in name for name in names])
    gain = stored["size"] * np.where(purse, stored["purse"], np.where(blink, stored["blink"], 1))
    lips = [
        Lip(stored[f"rim_{k}"].astype(np.int64), stored[f"rim_{k}_weight"],
            stored[f"reach_{k}"].astype(np.int64), stored[f"reach_{k}_column"],
            stored[f"reach_{k}_share"])
        for k in ("upper", "lower")
    ]  # fmt: skip
    inputs, bind = _bind()
    is_peak = np.array(["_half" in name for name in names])
    controls = default_controls()
    count = len(controls.names)
    place = {name: k for k, name in enumerate(controls.names)}
    place |= {f"{name}_negative": count + k for k, name in enumerate(controls.names)}
    found = np.full((len(names), 2, 2), 2 * count)
    for k, name in enumerate(names):
        for group, halves in enumerate(CORRECTIVES.get(name, ((name,), ()))):
            for slot, half in enumerate(halves):
                found[k, group, slot] = place[half]
    return Motion(
        names, found, is_peak, gain.astype(np.float32), starts, vertex,
        np.ascontiguousarray(delta), float(stored["step"]), inputs, bind,
        (lips[0], lips[1]), _profiles(inputs, stored["lip_columns"]), stored["lip_fade"],
    )  # fmt: skip


class Head:
    """A head of one person.

    Attributes
    ----------
    identity : Identity
    slices : dict of str to slice
        Where each part's vertices are in the joined mesh; ``cage`` are the first of the skin's.
    motion : Motion
    straight : ndarray [shape=(V, 3)]
        The points at rest before lids, seal and convergence of the eyes, cm.
    eyes : ndarray [shape=(2, 4)]
        Centre and radius of both eyes, left first.
    convergence : float
        Turn of each eye inwards at rest, degrees.
    landmarks : dict of str to int
        The 26 of `rig.retarget.landmarks.LANDMARKS`, vertices of the cage; none of a user's head.
    creases : ndarray [shape=(10, V of the skin)]
        Share of each region's depth that the skin takes; left regions first.
    """

    def __init__(self, identity: Identity) -> None:
        file = identity.file
        self._stored = stored = embedded(identity.name) if file is None else read_head(file)
        self.identity, self.motion = identity, _motion(stored)
        names, stops = map(str, stored["parts"]), [*map(int, stored["stops"])]
        self.slices = {n: slice(a, b) for n, a, b in zip(names, [0, *stops], stops, strict=False)}
        if "cage_faces" in stored:
            self.slices["cage"] = slice(0, int(stored["cage_faces"].max()) + 1)
        self.straight = stored["points"] / GRID
        self.eyes = stored["eyes"].astype(np.float64)
        self.convergence = float(stored["convergence"])
        marks = zip(stored["landmarks"], stored["landmark_points"], strict=True)
        self.landmarks = {str(name): int(point) for name, point in marks}
        self.creases = stored["crease_mask"] * np.float32(stored["creases"] / 255)
        self.follow, self.near = (stored[key].astype(np.int64) for key in ("follow", "near"))
        self.near_weight = stored["weight"].astype(np.float32)
        self.near_weight /= self.near_weight.sum(1, keepdims=True)
        self.lids = [stored[f"lid_{s}"].astype(np.int64) for s in "LR"]
        self.seam = stored["weld"][self.slices["seam"]].astype(np.int64)
        self.lid_rims = [stored[f"lid_rim_{s}"].astype(np.int64) for s in "LR"]
        self.lid_least = [
            np.minimum(np.linalg.norm(self.straight[ids] - eye[:3], axis=1), LID_CLEARANCE * eye[3])
            for ids, eye in zip(self.lids, self.eyes, strict=True)
        ]
        self._rest = self.straight.astype(np.float32)

    @cached_property
    def mesh(self) -> Mesh:
        """All parts joined, neutral; `pose` returns its vertices."""
        stored, name = self._stored, self.identity.name
        maps = (
            Maps(*(np.asarray(opened(self.pictures[key], key)) for key in PICTURES))
            if self.identity.file
            else EmbeddedMaps(name)
        )
        return Mesh(
            self.neutral, stored["faces"].astype(np.int64), stored["colour"] / 255,
            stored["gloss"] / 255, stored["uv"] / 65535, stored["light"] / 255,
            stored["kind"].astype(np.int64), maps,
            stored["weld"].astype(np.int64),
        )  # fmt: skip

    @cached_property
    def pictures(self) -> dict[str, bytes]:
        """Files of `rig.face.head_file.PICTURES`."""
        if self.identity.file is None:
            return embedded_pictures(self.identity.name)
        return {name: self._stored[f"picture.{name}"].tobytes() for name in PICTURES}

    @cached_property
    def neutral(self) -> Float64:
        """Vertices (V, 3) of the controls at rest."""
        return self.pose(default_controls().rest).astype(np.float64)

    @cached_property
    def skin(self) -> Mesh:
        """The skin alone, neutral, without seams."""
        return Mesh(self.neutral[self.slices["skin"]], self._stored["skin_faces"].astype(np.int64))

    @cached_property
    def teeth(self) -> slice:
        """Vertices of the parts in the mouth, `MOUTH`; none of a user's head."""
        parts = [self.slices[name] for name in MOUTH if name in self.slices] or [slice(0, 0)]
        return slice(parts[0].start, parts[-1].stop)

    @cached_property
    def mouth(self) -> Int64:
        """Vertices of the skin inside the mouth: dark at rest, and about the teeth."""
        if not self.teeth.stop:
            return np.zeros(0, np.int64)
        teeth = self.straight[self.teeth]
        skin, low, high = self.straight[self.slices["skin"]], teeth.min(0), teeth.max(0)
        is_near = (skin > low - MOUTH_REACH[0]) & (skin < high + MOUTH_REACH[1])
        is_dark = self._stored["light"][self.slices["skin"], 0] < 255 * MOUTH_LIGHT
        chosen = is_near.all(1) & is_dark
        faces = self._stored["skin_faces"]
        faces = faces[chosen[faces].all(1)]
        found = np.zeros(len(skin), bool)
        corners = faces.ravel()
        found[corners[np.argmax(skin[corners, 2])]] = True
        while True:  # from behind the lips on: a shadow on the neck is none of it
            more = faces[found[faces].any(1)]
            if found[more].all():
                return np.flatnonzero(found)
            found[more] = True

    @cached_property
    def cage(self) -> Mesh:
        """A quarter of the skin's vertices, neutral, for uses that need no finer mesh."""
        return Mesh(self.neutral[self.slices["cage"]], self._stored["cage_faces"].astype(np.int64))

    @cached_property
    def lip_rims(self) -> tuple[Int64, Int64]:
        """Vertices of the cage that face one another across the closed mouth, right to left."""
        columns = self._stored["lip_columns"]
        chosen = np.flatnonzero(np.abs(columns) < 2.2)[::2]
        upper, lower = (lip.within(self.slices["cage"].stop).rim for lip in self.motion.lips)
        a, b = self.straight[upper], self.straight[lower]
        apart = np.linalg.norm(a[:, None] - b, axis=-1)
        across = np.abs(0.5 * (a[:, None, 0] + b[:, 0]) - columns[chosen, None, None])
        pairs = (apart + across).reshape(len(chosen), -1).argmin(1)
        found = np.stack([upper[pairs // len(lower)], lower[pairs % len(lower)]])
        _, first = np.unique(found, axis=1, return_index=True)
        kept = found[:, np.sort(first)]
        return kept[0], kept[1]

    def lip_gaps(self, poses: AnyFloat) -> Float64:
        """Height of the gap between the lips at each column (T, P), cm, of poses (T, V, 3)."""
        upper, lower = self.lip_columns(poses)
        return np.asarray(np.maximum((upper - lower)[..., 1] * self.motion.fade, 0), np.float64)

    def lip_columns(self, poses: AnyFloat) -> list[AnyFloat]:
        """Means of the rims of the upper and the lower lip at each column (T, P, 3)."""
        return [lip.weight @ poses[:, lip.rim] for lip in self.motion.lips]

    def pose(self, values: ArrayLike) -> Float32:
        """Vertices of the joined mesh for control values.

        Parameters
        ----------
        values : array [shape=(185,) or (T, 185)]
            Values of `rig.default_controls()`, within their ranges.

        Returns
        -------
        vertices : ndarray [shape=(V, 3) or (T, V, 3)], cm

        Raises
        ------
        RigError
            If the last axis is not 185 or a value is not finite.
        """
        table = np.asarray(values, dtype=np.float64)
        count = len(default_controls().names)
        if table.ndim not in (1, 2) or table.shape[-1] != count:
            raise RigError(f"values have shape {table.shape}; a pose needs (T, {count})")
        if not np.isfinite(table).all():
            raise RigError("values contain NaN or infinity; a pose needs finite numbers")
        frames = np.atleast_2d(table)
        out = np.empty((len(frames), *self.straight.shape), np.float32)
        for k in range(0, len(frames), BATCH):
            self.pose_into(frames[k : k + BATCH], out[k : k + BATCH])
        return out[0] if table.ndim == 1 else out

    def pose_into(self, frames: Float64, out: Float32, steps: tuple[str, ...] = STEPS) -> None:
        """Write vertices (T, V, 3) of control values (T, 185) into `out`, by some steps of `STEPS`.

        A step that is left out must move nothing in these poses (`rig.face.moves`).
        """
        motion = self.motion
        halves = motion.halves(frames)
        weights = motion.weights(halves).astype(np.float32)
        out[:] = self._rest
        if np.count_nonzero(weights) < MANY * len(motion.names):
            for k in np.flatnonzero(weights.any(axis=0)):
                at = np.flatnonzero(weights[:, k])
                vertex, delta = motion.shape(int(k))
                out[at[:, None], vertex] += weights[at, k, None, None] * delta
        else:
            used = np.flatnonzero(weights.any(axis=0))
            table = self._displacements[used]
            for start in range(0, len(out), FEW):
                few = slice(start, start + FEW)
                out[few] += (weights[few, used] @ table).reshape(-1, *out.shape[1:])
        self._clear_eyes(out, steps)
        if "lips" in steps:
            seal_lips(out, motion.lips, self.sealed(halves), motion.fade)
        if "follow" in steps:
            shift = np.take(out, self.near, axis=1) - self._rest[self.near]
            out[:, self.follow] += np.einsum("tvkc,vk->tvc", shift, self.near_weight)
        if "eyes" in steps:
            pitch, yaw = gaze_degrees(frames, self.convergence)
            for place, side in enumerate("LR"):
                part, center = self.slices[f"eye_{side}"], self.eyes[place, :3]
                turn = _gaze_matrix(pitch[:, place], yaw[:, place])
                out[:, part] = (out[:, part] - center) @ turn.transpose(0, 2, 1) + center
        if "seam" in steps:
            out[:, self.slices["seam"]] = out[:, self.seam]

    def _clear_eyes(self, out: Float32, steps: tuple[str, ...]) -> None:
        """Keep lids out of the eyes."""
        for s, ids, eye, least in zip("LR", self.lids, self.eyes, self.lid_least, strict=True):
            if f"lid_{s}" not in steps:
                continue
            away = np.take(out, ids, axis=1) - eye[:3].astype(np.float32)
            far = np.sqrt(np.einsum("tvc,tvc->tv", away, away))
            frame, n = np.nonzero(far < least)
            out[frame, ids[n]] += away[frame, n] * (least[n] / far[frame, n] - 1)[:, None]

    @cached_property
    def _displacements(self) -> "csr_array":
        """Displacements (K, 3 V) of all shapes, cm, without gain."""
        from scipy.sparse import csr_array

        motion = self.motion
        columns = (3 * motion.vertex[:, None] + np.arange(3)).ravel()
        size = len(motion.names), 3 * len(self.straight)
        values = motion.delta.ravel() * np.float32(motion.step)
        return csr_array((values, columns, 3 * motion.starts), shape=size)

    def sealed(self, halves: Float64) -> tuple[Float64, Float64]:
        """How far (T, P) the upper and the lower lip are brought to the other, 0 to 1."""
        inputs = halves @ self.motion.bind
        upper, lower = (np.clip(inputs @ profile, 0, 1) for profile in self.motion.profiles)
        return upper, lower


def seal_lips(
    out: Float32, lips: tuple[Lip, Lip], sealed: tuple[Float64, Float64], fade: Float32
) -> None:
    """Bring lips together in place, and set them apart where they cross.

    Parameters
    ----------
    out : array [shape=(T, V, 3)]
        Changed.
    lips : tuple of Lip
        Upper and lower.
    sealed : tuple of array [shape=(T, P), range 0 to 1]
        How far each lip goes; see `FINISH`.
    fade : array [shape=(P,)]
        Share of all this at each column.
    """
    columns = [lip.weight @ np.take(out, lip.rim, axis=1) for lip in lips]
    moves = [np.zeros_like(column) for column in columns]
    first, last = FINISH
    finished = [smoothstep((s - first) / (last - first)) for s in sealed]
    for amounts in (sealed, finished, (0 * sealed[0], 0 * sealed[1])):  # the last: crossings alone
        upper, lower = (
            (share * s).astype(np.float32)
            for share, s in zip((UPPER_PART, 1 - UPPER_PART), amounts, strict=True)
        )
        gap = columns[0] - columns[1]
        crossed = np.zeros_like(gap)
        crossed[..., 1] = 0.5 * np.minimum(gap[..., 1], 0) * (1 - upper - lower)
        for k, part in enumerate((-upper, lower)):
            move = (gap * part[..., None] + (crossed if k else -crossed)) * fade[:, None]
            moves[k] += move
            columns[k] += lips[k].fed_back @ move * ALONG
    for lip, move in zip(lips, moves, strict=True):
        out[:, lip.reach] += lip.along(move)


def gaze_degrees(frames: Float64, convergence: float) -> tuple[Float64, Float64]:
    """Pitch up and yaw to the character's left (T, 2) of the left and the right eye."""
    index = default_controls().index
    x, y = (
        np.clip(
            np.stack([frames[:, index(f"CTRL_{s}_eye.{axis}")] for s in "LR"], 1)
            + frames[:, index(f"CTRL_C_eye.{axis}"), None], -1, 1
        )
        for axis in ("tx", "ty")
    )  # fmt: skip
    parallel = np.clip(frames[:, index("CTRL_C_eye_parallelLook.ty"), None], 0, 1)
    x = x + parallel * (x.mean(1, keepdims=True) - x)
    y = y + parallel * (y.mean(1, keepdims=True) - y)
    inwards = convergence * (1 - parallel) * np.array([-1, 1])
    pitch = np.where(y > 0, GAZE_DEGREES["up"], GAZE_DEGREES["down"]) * y
    return pitch, GAZE_DEGREES["side"] * x + inwards


def _gaze_matrix(pitch_degrees: Float64, yaw_degrees: Float64) -> Float64:
    """Rotations (T, 3, 3): first up by pitch, then to the character's left by yaw."""
    p, w = np.radians(pitch_degrees), np.radians(yaw_degrees)
    zero, one = np.zeros_like(p), np.ones_like(p)
    tilt = np.stack([one, zero, zero, zero, np.cos(p), np.sin(p), zero, -np.sin(p), np.cos(p)], -1)
    turn = np.stack([np.cos(w), zero, np.sin(w), zero, one, zero, -np.sin(w), zero, np.cos(w)], -1)
    return np.asarray(turn.reshape(-1, 3, 3) @ tilt.reshape(-1, 3, 3))


def build_head(identity: int | str | Identity = 0) -> Head:
    """Load the head of an identity.

    Parameters
    ----------
    identity : int, str or Identity, optional
        One of `rig.face.IDENTITIES` by number or name, or a role; or of a head file.

    Raises
    ------
    RigError
        For an unknown identity, or a file that is no head.
    """
    return _head(resolve_identity(identity))


@lru_cache(maxsize=8)
def _head(identity: Identity) -> Head:
    return Head(identity)
