"""Eyelids: loops that turn about the eyeball."""

from dataclasses import dataclass

import numpy as np

from rig.arrays import Float64, Int64
from rig.face.geometry import loops
from rig.face.geometry.skin import LID_SHARE, Skin
from rig.face.geometry.topology import EYE_L, EYE_R

_MEET = 0.16
"""Where closed lids meet, as a share of the way from the lower to the upper rim."""
WIDEN, UPPER_UP, LOOK_UP = 0.24, 0.20, 0.28
"""Turn of the upper lid's rim by each full input, radians."""
Inputs = dict[str, Float64]


@dataclass(frozen=True)
class _Eye:
    ids: Int64
    slot: Int64
    share: Float64
    center: Float64
    rim: Int64
    upper: Float64
    arch: Float64


class Lids:
    """Poses both eyes' lids; `turn` after a call holds each rim vertex's angle."""

    def __init__(self, skin: Skin) -> None:
        self._least = skin.anatomy.eye_radius + 0.012
        t = loops.angles(loops.EYE_COUNT)
        self._opposite = (loops.EYE_COUNT - np.arange(loops.EYE_COUNT)) % loops.EYE_COUNT
        self._eyes = {}
        for name, kind, side in (("L", EYE_L, 1), ("R", EYE_R, -1)):
            ids = np.flatnonzero(skin.kind == kind)
            ring = skin.ring[ids]
            share = np.where(ring < 0, 1.0, LID_SHARE[np.maximum(ring, 0)])
            self._eyes[name] = _Eye(
                ids, skin.slot[ids], share, skin.anatomy.eye * [side, 1, 1], skin.loop(kind, 0),
                (np.sin(t) > 1e-6).astype(float), np.abs(np.sin(t)),
            )  # fmt: skip

    def pose(self, vertices: Float64, inputs: Inputs) -> dict[str, Float64]:
        """Turn the lids in place (T, V, 3); returns each rim's turn (T, EYE_COUNT), radians."""
        return {name: self._pose_eye(vertices, inputs, name) for name in self._eyes}

    def _pose_eye(self, vertices: Float64, inputs: Inputs, name: str) -> Float64:
        eye = self._eyes[name]
        rim = vertices[:, eye.rim] - eye.center
        angle = np.arctan2(rim[..., 1], rim[..., 2])
        turn = self._rim_turn(angle, eye, inputs, name)
        around = vertices[:, eye.ids] - eye.center
        by = turn[:, eye.slot] * eye.share
        cos, sin = np.cos(by), np.sin(by)
        y, z = around[..., 1].copy(), around[..., 2].copy()
        around[..., 1], around[..., 2] = cos * y + sin * z, cos * z - sin * y
        length = np.sqrt((around**2).sum(-1, keepdims=True))
        vertices[:, eye.ids] = eye.center + around * np.maximum(self._least / length, 1)
        return turn

    def _rim_turn(self, angle: Float64, eye: _Eye, inputs: Inputs, name: str) -> Float64:
        """Upward turn of every rim vertex; opposite rims meet and never cross."""
        opposite = angle[:, self._opposite]
        gap = np.where(eye.upper > 0, angle - opposite, opposite - angle)
        gap = np.maximum(gap, 0)
        close, raise_ = _lid_shares(inputs, name)
        widen, dip, ride = (angle[:, None] * eye.arch for angle in _lid_angles(inputs, name))
        close = close + 0.30 * np.clip(inputs[f"lid.frown_{name}"], 0, 1)[:, None] * _inner(eye)
        up = -(1 - _MEET) * np.clip(close, 0, 1) * gap + widen - ride
        room = 1 - (1 - _MEET) * np.clip(close, 0, 1)
        low = np.minimum(np.clip(np.maximum(raise_, _MEET * (close >= 1)), 0, 1), room) * gap
        low = low - dip * (1 - np.clip(close, 0, 1)) - ride
        turn = np.where(eye.upper > 0, up, low)
        return turn * (eye.arch > 1e-6)


def _inner(eye: _Eye) -> Float64:
    """1 towards the nose, 0 at the outer corner: where a frown presses the lid."""
    t = loops.angles(loops.EYE_COUNT)
    return np.asarray(0.5 - 0.5 * np.cos(t))


def _lid_shares(inputs: Inputs, name: str) -> tuple[Float64, Float64]:
    """Shares (T, 1) of the opening that the upper lid closes and the lower lid rises."""
    get = {k: inputs[f"lid.{k}_{name}"] for k in ("close", "upper", "lower", "lookDown")}
    blink = np.clip(get["close"], 0, 1)
    open_ = 1 - blink
    upper = blink + open_ * (
        0.85 * np.clip(get["upper"], 0, 1) + 0.60 * np.clip(get["lookDown"], 0, 1)
    )
    lower = open_ * np.clip(get["lower"], 0, 1) * 0.8 + blink * _MEET
    return upper[:, None], lower[:, None]


def _lid_angles(inputs: Inputs, name: str) -> tuple[Float64, Float64, Float64]:
    """Extra turns (T,), radians: upper lid up, lower lid down, and both down with the gaze."""
    get = {k: np.clip(inputs[f"lid.{k}_{name}"], 0, 1)
           for k in ("widen", "upperUp", "lowerDown", "lookUp", "lookDown", "close")}  # fmt: skip
    open_ = 1 - get["close"]
    widen = (WIDEN * get["widen"] + UPPER_UP * get["upperUp"] + LOOK_UP * get["lookUp"]) * open_
    dip = 0.06 * get["widen"] + 0.16 * get["lowerDown"]
    ride = 0.30 * get["lookDown"] - 0.10 * get["lookUp"] * open_
    return np.minimum(widen, 0.36), np.minimum(dip, 0.26), ride
