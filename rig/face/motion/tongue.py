"""The tongue: bent by its controls, stopped by palate, teeth and lips."""

import numpy as np

from rig.arrays import Float64
from rig.face.geometry import details
from rig.face.geometry.mesh import smoothstep

Inputs = dict[str, Float64]
SINK_CM = 0.50
"""How far the tongue lowers in the open jaw, so that the lower teeth stay in sight."""


class Tongue:
    """Poses the tongue's vertices.

    Parameters
    ----------
    rest : ndarray [shape=(n, 3)]
        The tongue at rest, cm.
    place : ndarray [shape=(n,)]
        0 at the tip, 1 at the root.
    mouth_y, lip_z : float
        Where the lips meet.
    """

    def __init__(self, rest: Float64, place: Float64, mouth_y: float, lip_z: float) -> None:
        self._rest, self._s = rest, place
        rows = rest.reshape(details.TONGUE_ROWS, details.TONGUE_COLUMNS, 3)
        self._axis = np.repeat(rows.mean(1), details.TONGUE_COLUMNS, 0)
        half = np.abs(rows[..., 0]).max(1)
        self._across = rest[:, 0] / np.repeat(half, details.TONGUE_COLUMNS)
        self._upper_edge = mouth_y + details.UPPER_EDGE
        self._lower_edge = mouth_y + details.LOWER_EDGE
        self._teeth_z = lip_z - details.UPPER_BACK
        self._behind_z = lip_z - details.LOWER_BACK - 0.29
        self.jaw_share = 0.70 + 0.27 * (1 - place)

    def shape(self, inputs: Inputs) -> Float64:
        """The tongue bent by its own controls (T, n, 3), before the jaw takes it along."""
        get = {k: inputs[f"tongue.{k}"][:, None] for k in (
            "in", "out", "up", "left", "press", "wide", "bend", "twist", "roll", "tipUp",
            "tipLeft", "thick")}  # fmt: skip
        s = self._s
        front, tip = np.clip(1 - s, 0, 1), np.clip(1 - s / 0.5, 0, 1) ** 1.5
        body = np.sin(np.pi * np.clip(0.12 + 0.8 * s, 0, 1))
        offset = self._rest - self._axis
        wide = 1 + 0.26 * get["wide"] * (1 - 0.5 * s)
        thick = 1 + 0.35 * get["thick"] - 0.12 * get["wide"]
        turn = np.radians(28) * get["twist"] * front
        x = offset[:, 0] * wide
        y = offset[:, 1] * thick
        dx, dy = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
        x = self._axis[:, 0] + dx + 0.85 * get["left"] * front**0.8 + 0.75 * get["tipLeft"] * tip
        lift = 0.95 * get["up"] * body + 0.80 * get["press"] * body + 1.35 * get["tipUp"] * tip
        lift = lift + 0.75 * get["bend"] * (tip - 0.35 * body) + 0.60 * get["out"] * front**0.6
        sunk = np.clip(inputs["jaw.open"], 0, 1)[:, None] * np.clip(
            1 - get["out"] - get["tipUp"], 0, 1
        )
        lift = lift - SINK_CM * sunk * front**0.5
        y = self._axis[:, 1] + dy + lift + 0.42 * get["roll"] * self._across**2 * front
        reach = 2.5 * get["out"] * front**0.9 - 1.3 * get["in"] * front
        reach = reach - 0.22 * get["tipUp"] * tip - 0.30 * get["bend"] * tip
        z = self._axis[:, 2] + offset[:, 2] + reach
        return np.stack(np.broadcast_arrays(x, y, z), -1)

    def settle(
        self, points: Float64, lower_edge: Float64, lip_low: Float64, lip_high: Float64
    ) -> Float64:
        """Keep the tongue (T, n, 3) under palate and upper teeth, over lower teeth and lip.

        `lower_edge`, `lip_low` and `lip_high` (T, 2) are y and z of the lower incisors' edge and
        of the lips' rims in the middle, in the pose at hand. Contact is exact: a tongue that
        would pass through touches instead, and one that has no room stays behind the teeth.
        """
        points = points.copy()
        edge_y = lower_edge[:, :1]
        shut = self._upper_edge - edge_y < 0.16
        points[..., 2] = np.where(shut, np.minimum(points[..., 2], self._behind_z), points[..., 2])
        z, x = points[..., 2], points[..., 0]
        behind = np.maximum(self._teeth_z - 0.30 - z, 0)
        vault = np.interp(behind, [0, 0.12, 0.5, 1.6, 3.5, 5.5], [0, 0.32, 0.85, 1.35, 1.4, 1.1])
        ceiling = self._upper_edge - 0.02 + vault * np.clip(1 - 0.18 * x**2, 0.3, 1)
        past = smoothstep((z - self._behind_z) / 0.2)
        floor = edge_y + 0.02 - 3.0 * (1 - past)
        outside = smoothstep((z - (lip_low[:, 1:] - 0.75)) / 0.5)
        floor = floor + np.maximum(lip_low[:, :1] + 0.02 - floor, 0) * outside
        outside_high = smoothstep((z - (lip_high[:, 1:] - 0.6)) / 0.4)
        ceiling = ceiling - np.maximum(ceiling - lip_high[:, :1] + 0.02, 0) * outside_high
        y = np.minimum(points[..., 1], ceiling)
        y = np.where(floor < ceiling, np.maximum(y, floor), np.where(past > 0.5, ceiling, y))
        points[..., 1] = y
        return points
