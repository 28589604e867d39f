"""The embedded head: neutral parts, and vertices for any values of the 185 controls."""

import hashlib
import zipfile
from collections.abc import Callable
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.arrays import Float32, Float64, Int64
from rig.controls import default_controls
from rig.errors import RigError
from rig.face.geometry import details, hair
from rig.face.geometry.mesh import MESH_ARRAYS, NO_MAPS, SKIN, Maps, Mesh, join, mirrored
from rig.face.geometry.skin import Skin, build_skin, paint_skin, skin_uv
from rig.face.geometry.topology import EYE_L, EYE_R, FILLER, MOUTH
from rig.face.identity import Identity, resolve_identity
from rig.face.motion.bindings import bindings
from rig.face.motion.rigid import Arch, Jaw, Lids, Seal, Tongue
from rig.files import atomic_write, cache_folder

# Cache of heads on disk: plain arrays in the user's cache folder.

Arrays = dict[str, NDArray[Any]]
MOST_KEPT = 24
"""Entries of a kind, of 15 MB each; an identity is one."""


@lru_cache(maxsize=1)
def _source_key() -> str:
    """Digest of the code and tables that heads and their shapes are built by."""
    digest = hashlib.sha256()
    for folder in ("controls", "face", "retarget"):
        for source in sorted((Path(__file__).parents[1] / folder).rglob("*.*")):
            if source.suffix in (".py", ".csv", ".json"):
                digest.update(source.read_bytes())
    return digest.hexdigest()


def load_or_build(kind: str, identity: Identity, build: Callable[[Identity], Arrays]) -> Arrays:
    """Arrays of a head from the cache, or built and then kept where the folder can be written."""
    key = hashlib.sha256(f"{_source_key()} {astuple(identity)}".encode()).hexdigest()[:20]
    path = cache_folder() / f"{kind}-{key}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, EOFError, ValueError, zipfile.BadZipFile):
        arrays = build(identity)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as beside:
            np.savez(beside, **arrays)  # type: ignore[arg-type]
        kept = sorted(path.parent.glob(f"{kind}-*.npz"), key=lambda old: old.stat().st_mtime)
        for old in kept[:-MOST_KEPT]:  # of former versions, or heads that are not used any more
            old.unlink()
    except OSError:
        pass  # a cache that cannot be written is no error: the head is built again next time
    return arrays


Inputs = dict[str, Float64]
UNIT_MM = 10.0
"""The head is in centimetres."""
GAZE_DEGREES = {"side": 40.0, "up": 30.0, "down": 40.0}
"""Full gaze (MetaHuman's board: 40 degrees sideways and down, 30 up)."""
CONVERGENCE_DEGREES = 3.0
"""Turn of each eye inwards at rest: an adult's eyes meet 57 cm away."""
BATCH = 64


@dataclass(frozen=True)
class _Follow:
    """Vertices attached to the skin: for each, some skin vertices and their weights."""

    near: Int64
    weight: Float64


@dataclass(frozen=True)
class Look:
    """What takes long to make of a head's look: hair, places in the maps, maps, baked light."""

    hair: Mesh
    brow: Mesh
    uv: Float64
    maps: Maps = NO_MAPS
    light: Float64 = field(default_factory=lambda: np.ones(2))


class Head:
    """A head of one identity.

    Attributes
    ----------
    identity : Identity
    skin : Mesh
        The skin alone, neutral.
    parts : dict of str to Mesh
        Every part, neutral, in the order of the joined mesh.
    mesh : Mesh
        All parts joined; `pose` returns its vertices.
    slices : dict of str to slice
        Where each part's vertices are in the joined mesh.
    features : Skin
        The skin's loops and anatomy, for landmarks and checks.
    """

    def __init__(
        self, identity: Identity, features: Skin, shapes: dict[str, Float64], look: Look
    ) -> None:
        self.identity, self.features, self._look = identity, features, look
        place = features.anatomy
        self._lip_z = float(features.vertices[features.loop(MOUTH, 0)[13], 2])
        self.parts = self._make_parts()
        self.mesh = replace(join(list(self.parts.values())), maps=look.maps, light=look.light)
        counts = np.cumsum([0] + [len(p.vertices) for p in self.parts.values()])
        self.slices = {
            name: slice(int(a), int(b))
            for name, a, b in zip(self.parts, counts, counts[1:], strict=False)
        }
        self.skin = self.parts["skin"]
        self.jaw = Jaw(features, shapes["jawWeights"][:, 0])
        self._names = tuple(name for name in shapes if name != "jawWeights")
        stack = np.stack([shapes[name] for name in self._names]).astype(np.float32)
        self._moving = np.flatnonzero(np.abs(stack).max((0, 2)) > 1e-4)
        self._shapes = stack[:, self._moving].reshape(len(stack), -1)
        self._lids, self._seal = Lids(features), Seal(features)
        self._arches = self._make_arches()
        self._tongue = Tongue(
            self.parts["tongue"].vertices, self._tongue_place, place.mouth_y, self._lip_z
        )
        rim, lip = features.loop(MOUTH, 0), len(features.loop(MOUTH, 0)) // 4
        self._rim_middle = rim[lip], rim[3 * lip]

    def _make_parts(self) -> dict[str, Mesh]:
        i, skin = self.identity, self.features
        colors, gloss = paint_skin(skin, i)
        place = skin.anatomy
        eye, self._pupil = details.eyeball(i, place.eye_radius)
        self._eye_rest = eye.vertices
        uv = self._look.uv
        parts = {"skin": Mesh(skin.vertices, skin.faces, colors, gloss, uv, kind=np.array(SKIN))}
        for name, side in (("eye_L", 1), ("eye_R", -1)):
            turned = (
                eye.vertices
                @ _gaze_matrix(np.array([0.0]), np.array([-side * CONVERGENCE_DEGREES]))[0].T
            )
            parts[name] = replace(eye, vertices=turned + place.eye * [side, 1, 1])
        self._lash_root, self._lash_along = {}, {}
        for s, kind in (("L", EYE_L), ("R", EYE_R)):
            mesh, root, along = details.lashes(skin, kind, i)
            parts[f"lash_{s}"] = mesh
            self._lash_root[s], self._lash_along[s] = root, along
        parts["teeth_upper"] = details.dental_arch(place.mouth_y, self._lip_z, is_upper=True)
        parts["teeth_lower"] = details.dental_arch(place.mouth_y, self._lip_z, is_upper=False)
        parts["tongue"], self._tongue_place = details.tongue(place.mouth_y, self._lip_z)
        parts["brow_L"] = self._look.brow
        parts["brow_R"] = mirrored(parts["brow_L"])
        parts["ear_L"] = details.ear(i)
        parts["ear_R"] = mirrored(parts["ear_L"])
        parts["hair"] = self._look.hair
        parts["bust"] = details.bust(i)
        return parts

    def _make_arches(self) -> dict[str, Arch]:
        y = self.features.anatomy.mouth_y
        arches = {}
        for name, width, depth, back, edge, up in (
            ("upper", 2.06, 4.2, details.UPPER_BACK, details.UPPER_EDGE, 1),
            ("lower", 1.94, 4.1, details.LIP_BACK, details.LIP_EDGE, -1),
        ):
            center_z = self._lip_z - back - depth
            arches[name] = Arch(self.features, width, depth, center_z, y + edge, up)
        return arches

    @cached_property
    def _brows(self) -> dict[str, _Follow]:
        return {s: self._follow(self.parts[f"brow_{s}"].vertices) for s in "LR"}

    def _follow(self, vertices: Float64, count: int = 16, reach_cm: float = 0.45) -> _Follow:
        from scipy.spatial import cKDTree

        skin = self.features
        ids = np.flatnonzero((skin.kind == FILLER) | (skin.ring >= 3))
        distance, near = cKDTree(skin.vertices[ids]).query(vertices, k=count)
        weight = np.exp(-((np.asarray(distance) / reach_cm) ** 2)) + 1e-9
        return _Follow(ids[near], weight / weight.sum(1, keepdims=True))

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
        out = np.concatenate(
            [self._pose(frames[k : k + BATCH]) for k in range(0, max(len(frames), 1), BATCH)]
        )
        return out[0] if table.ndim == 1 else out

    def _pose(self, frames: Float64) -> Float32:
        inputs = bindings()(frames)
        inputs["larynxUp"] = inputs["larynxUp"] + np.interp(
            inputs["swallow"], [0, 0.2, 0.4, 0.6, 0.8, 1], [0, 0.4, 1, 1, 0.4, 0]
        )
        vertices = np.repeat(self.mesh.vertices[None], len(frames), 0)
        skin = vertices[:, self.slices["skin"]]
        weights = np.stack([inputs[name] for name in self._names], 1).astype(np.float32)
        shift = weights @ self._shapes
        skin[:, self._moving] += shift.reshape(len(frames), -1, 3)
        self.jaw.pose(skin, inputs)
        upper, lower = self._arches["upper"], self._arches["lower"]
        skin[:, upper.ids] += upper.push(skin[:, upper.ids] - _teeth_shift(inputs, "upper"))
        in_jaw = self.jaw.undo(skin[:, lower.ids], inputs)
        moved = in_jaw + lower.push(in_jaw - _teeth_shift(inputs, "lower"))
        skin[:, lower.ids] += self.jaw.ride(moved, inputs) - self.jaw.ride(in_jaw, inputs)
        turns = self._lids.pose(skin, inputs)
        self._seal.pose(skin, inputs)
        self._pose_mouth(vertices, inputs)
        self._pose_eyes(vertices, inputs, turns)
        self._pose_rest(vertices, inputs)
        return vertices.astype(np.float32)

    def _pose_mouth(self, vertices: Float64, inputs: Inputs) -> None:
        vertices[:, self.slices["teeth_upper"]] += _teeth_shift(inputs, "upper")
        lower_shift = _teeth_shift(inputs, "lower")
        lower = vertices[:, self.slices["teeth_lower"]] + lower_shift
        vertices[:, self.slices["teeth_lower"]] = self.jaw.ride(lower, inputs)
        tongue = self.jaw.ride(self._tongue.shape(inputs), inputs, self._tongue.jaw_share)
        edge = np.array([[[0, self.features.anatomy.mouth_y + details.LOWER_EDGE,
                           self._lip_z - details.LOWER_BACK]]])  # fmt: skip
        edge = self.jaw.ride(np.repeat(edge, len(vertices), 0) + lower_shift, inputs)
        skin = vertices[:, self.slices["skin"]]
        high, low = (skin[:, k, 1:] for k in self._rim_middle)
        vertices[:, self.slices["tongue"]] = self._tongue.settle(tongue, edge[:, 0, 1:], low, high)

    def _pose_eyes(self, vertices: Float64, inputs: Inputs, turns: dict[str, Float64]) -> None:
        gaze_x = {s: np.clip(inputs[f"gaze.x_{s}"], -1, 1) for s in "LR"}
        gaze_y = {s: np.clip(inputs[f"gaze.y_{s}"], -1, 1) for s in "LR"}
        parallel = np.clip(inputs["gaze.parallel"], 0, 1)
        for s, side in (("L", 1), ("R", -1)):
            x = gaze_x[s] + parallel * (0.5 * (gaze_x["L"] + gaze_x["R"]) - gaze_x[s])
            y = gaze_y[s] + parallel * (0.5 * (gaze_y["L"] + gaze_y["R"]) - gaze_y[s])
            pitch = np.where(y > 0, GAZE_DEGREES["up"], GAZE_DEGREES["down"]) * y
            yaw = GAZE_DEGREES["side"] * x - side * CONVERGENCE_DEGREES * (1 - parallel)
            turn = _gaze_matrix(pitch, yaw)
            ball = self._eye_rest + inputs[f"pupil_{s}"][:, None, None] * self._pupil
            ball *= self.features.anatomy.eye_radius / np.linalg.norm(ball, axis=-1, keepdims=True)
            center = self.features.anatomy.eye * [side, 1, 1]
            vertices[:, self.slices[f"eye_{s}"]] = ball @ turn.transpose(0, 2, 1) + center
            self._pose_lashes(vertices, inputs, s, turns[s])

    def _pose_lashes(self, vertices: Float64, inputs: Inputs, s: str, turn: Float64) -> None:
        part, root = self.slices[f"lash_{s}"], self._lash_root[s]
        skin = vertices[:, self.slices["skin"]]
        neutral = self.features.vertices[root]
        offset = self.parts[f"lash_{s}"].vertices - neutral
        rim = self.features.loop(EYE_L if s == "L" else EYE_R, 0)
        slot = {int(v): k for k, v in enumerate(rim)}
        angle = turn[:, [slot[int(v)] for v in root]] * 0.8
        along = self._lash_along[s]
        angle = angle + 0.35 * inputs[f"lash.in_{s}"][:, None] * np.clip(1 - 2 * along, 0, 1)
        angle = angle + 0.35 * inputs[f"lash.out_{s}"][:, None] * np.clip(2 * along - 1, 0, 1)
        cos, sin = np.cos(angle), np.sin(angle)
        y = cos * offset[:, 1] + sin * offset[:, 2]
        z = cos * offset[:, 2] - sin * offset[:, 1]
        moved = np.stack(np.broadcast_arrays(offset[:, 0], y, z), -1)
        vertices[:, part] = skin[:, root] + moved

    def _pose_rest(self, vertices: Float64, inputs: Inputs) -> None:
        skin = vertices[:, self.slices["skin"]]
        for s, side in (("L", 1), ("R", -1)):
            ride = self._brows[s]
            shift = skin[:, ride.near] - self.features.vertices[ride.near]
            vertices[:, self.slices[f"brow_{s}"]] += np.einsum("tvkc,vk->tvc", shift, ride.weight)
            lift = inputs[f"ear_{s}"][:, None, None] * np.array([0.06 * side, 0.32, -0.05])
            vertices[:, self.slices[f"ear_{s}"]] += lift


def _teeth_shift(inputs: Inputs, jaw: str) -> Float64:
    """How far (T, 1, 3) the teeth of one jaw are moved by their own controls, cm."""
    return 0.25 * np.stack([inputs[f"teeth.{jaw}_{axis}"] for axis in "xyz"], -1)[:, None]


def _gaze_matrix(pitch_degrees: Float64, yaw_degrees: Float64) -> Float64:
    """Rotations (T, 3, 3): first up by pitch, then to the character's left by yaw."""
    p, w = np.radians(pitch_degrees), np.radians(yaw_degrees)
    zero, one = np.zeros_like(p), np.ones_like(p)
    tilt = np.stack([one, zero, zero, zero, np.cos(p), np.sin(p), zero, -np.sin(p), np.cos(p)], -1)
    turn = np.stack([np.cos(w), zero, np.sin(w), zero, one, zero, -np.sin(w), zero, np.cos(w)], -1)
    return np.asarray(turn.reshape(-1, 3, 3) @ tilt.reshape(-1, 3, 3))


def _build(identity: Identity) -> Arrays:
    """Neutral skin and every linear shape of one identity, as plain arrays."""
    from rig.face.motion.shape_list import FACE_SHAPES, MOUTH_SHAPES, neck_shapes, side_shapes
    from rig.face.motion.shapes import ShapeMaker

    skin = build_skin(identity)
    maker = ShapeMaker(skin)
    shapes: dict[str, Float64] = {}
    for shape in (*MOUTH_SHAPES, *FACE_SHAPES):
        shapes |= maker.make(shape)
    shapes |= side_shapes(maker) | neck_shapes(maker)
    weights = Jaw.weights(maker)
    return {
        "vertices": skin.vertices, "faces": skin.faces, "kind": skin.kind, "ring": skin.ring,
        "slot": skin.slot, "mirror": skin.mirror,
        **{f"shape.{name}": shape.astype(np.float32) for name, shape in shapes.items()},
        "shape.jawWeights": weights[:, None],
        **_build_look(identity, skin, shapes | {"jawWeights": weights[:, None]}),
    }  # fmt: skip


def _build_look(identity: Identity, skin: Skin, shapes: dict[str, Float64]) -> Arrays:
    """Hair, maps and baked light of a head, as plain arrays."""
    from rig.face.maps import build_maps, occlusion

    locks, brow, uv = hair.hair(identity), hair.brow(identity), skin_uv(skin)
    maps = build_maps(skin, uv, identity)
    bare = Head(identity, skin, shapes, Look(locks, brow, uv))
    solid = [bare.parts[name] for name in ("skin", "ear_L", "ear_R", "hair", "bust")]
    baked = np.split(occlusion(join(solid)), np.cumsum([len(p.vertices) for p in solid])[:-1])
    light = np.ones((len(bare.mesh.vertices), 2))
    for name, part in zip(("skin", "ear_L", "ear_R", "hair", "bust"), baked, strict=True):
        light[bare.slices[name]] = part
    light[bare.slices["skin"]][skin.ring < 0] = 1  # the mouth is painted dark, and opens
    return {
        **{f"hair.{name}": getattr(locks, name) for name in MESH_ARRAYS},
        **{f"brow.{name}": getattr(brow, name) for name in MESH_ARRAYS},
        **{f"maps.{name}": value for name, value in vars(maps).items()},
        "uv": uv, "light": light.astype(np.float32),
    }  # fmt: skip


def build_head(identity: int | str | Identity = 0) -> Head:
    """Build the head of an identity, or take it from the user's cache.

    Parameters
    ----------
    identity : int, str or Identity, optional
        One of `rig.face.IDENTITIES` by number or name, or other proportions.

    Raises
    ------
    RigError
        For an unknown identity.
    """
    return _head(resolve_identity(identity))


@lru_cache(maxsize=16)
def _head(identity: Identity) -> Head:
    from rig.face.geometry.topology import anatomy

    arrays = load_or_build("head", identity, _build)
    skin = Skin(
        arrays["vertices"], arrays["faces"].astype(np.int64), arrays["kind"], arrays["ring"],
        arrays["slot"], arrays["mirror"], anatomy(identity),
    )  # fmt: skip
    shapes = {k.removeprefix("shape."): v for k, v in arrays.items() if k.startswith("shape.")}
    locks, brow = (
        Mesh(**{name: arrays[f"{part}.{name}"] for name in MESH_ARRAYS})  # type: ignore[arg-type]
        for part in ("hair", "brow")
    )
    maps = Maps(**{name: arrays[f"maps.{name}"] for name in ("atlas", "creases", "pores")})
    return Head(identity, skin, shapes, Look(locks, brow, arrays["uv"], maps, arrays["light"]))
