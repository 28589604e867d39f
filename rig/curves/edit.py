"""Edits of curves: smoothing, gain and offset, clamping to the ranges."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Float64
from rig.controls import ControlSet, default_controls
from rig.curves import RigCurves
from rig.errors import CurveError, quoted
from rig.written_number import number_of

CLOSURE_CONTROLS = (
    "CTRL_C_jaw.ty",
    "CTRL_L_mouth_lipsTogetherU.ty",
    "CTRL_R_mouth_lipsTogetherU.ty",
    "CTRL_L_mouth_lipsTogetherD.ty",
    "CTRL_R_mouth_lipsTogetherD.ty",
)
"""Controls whose extremes are the lip closures of p, b and m."""

MAX_FACTOR = 1e6
"""Largest gain or offset; the result stays finite in float32."""
ROWS_AT_ONCE = 4096
"""Frames whose ranges are checked at once."""
MAX_SMOOTHING_SECONDS = 60.0
"""Longest deviation of a smoothing kernel."""


@dataclass(frozen=True)
class Clipped:
    """Effect of clamping on one control.

    Parameters
    ----------
    name : str
    n_frames : int
        Frames that were outside the range.
    worst_excess : float
        Greatest distance outside the range, in the control's own unit.
    """

    name: str
    n_frames: int
    worst_excess: float


@dataclass(frozen=True)
class ClampReport:
    """The clamped controls; empty if none. As text it is one line."""

    clipped: tuple[Clipped, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.clipped)

    def __str__(self) -> str:
        if not self.clipped:
            return "all values are within their ranges"
        worst = max(self.clipped, key=lambda item: item.worst_excess)
        frames = sum(item.n_frames for item in self.clipped)
        return (
            f"{frames} values of {len(self.clipped)} controls were clamped to their ranges; "
            f"worst {worst.name} by {worst.worst_excess:.4g}"
        )


def clamp(
    curves: RigCurves, controls: ControlSet | None = None, *, tolerance: float = 1e-6
) -> tuple[RigCurves, ClampReport]:
    """Clamp values to the ranges of their controls, and report what was changed.

    Parameters
    ----------
    curves : RigCurves
        Any values.
    controls : ControlSet, optional
        Source of the ranges; the default board.
    tolerance : float
        Excess (in the controls' unit) that is clamped but not worth reporting: rounding.

    Returns
    -------
    clamped : RigCurves
        Within range; the same object if nothing was outside.
    report : ClampReport
        In the order of the controls.
    """
    controls = controls or default_controls()
    places = controls.indices(curves.names)
    low, high = controls.minimum[places], controls.maximum[places]
    starts = range(0, len(curves), ROWS_AT_ONCE)
    blocks = (curves.values[k : k + ROWS_AT_ONCE] for k in starts)  # an hour is not copied
    if all(((rows >= low) & (rows <= high)).all() for rows in blocks):
        return curves, ClampReport()
    clamped = np.clip(curves.values, low, high)
    excess = np.abs(curves.values - clamped)
    clipped = [
        Clipped(curves.names[i], int((excess[:, i] > tolerance).sum()), float(excess[:, i].max()))
        for i in np.flatnonzero((excess > tolerance).any(axis=0))
    ]
    return replace(curves, values=clamped), ClampReport(tuple(clipped))


def parse_gains(gains: str | Mapping[str, float] | None, what: str = "gain") -> dict[str, float]:
    """Factors (or offsets) by control or set, of a mapping or of a text: ``jaw=1.2,brow=50%``.

    Raises
    ------
    CurveError
        If a part of the text is something else or names one twice, or a factor is not finite or
        beyond ±1e6.
    """
    if gains is None or isinstance(gains, Mapping):
        found = dict(gains or {})
    else:
        found = {}
        for part in str(gains).split(","):
            name, _, text = part.partition("=")
            name, factor = name.strip(), number_of(text)
            if math.isnan(factor):
                raise CurveError(
                    f"{what} {quoted(part)} must be NAME=NUMBER of a control or region: brow=0.5"
                )
            if name in found:
                raise CurveError(
                    f"{what} of {name} is given twice in {quoted(gains)}; give it once"
                )
            found[name] = factor
    return {name: _finite(factor, f"{what} of {name}") for name, factor in found.items()}


def gain(
    curves: RigCurves,
    gains: Mapping[str, float] | None = None,
    offsets: Mapping[str, float] | None = None,
    controls: ControlSet | None = None,
) -> RigCurves:
    """Scale each control's distance from rest, then add an offset.

    ``value = rest + gain * (value - rest) + offset``; not clamped, see `clamp`.

    Parameters
    ----------
    curves : RigCurves
        Any values.
    gains, offsets : mapping of str to float, optional
        Keys are controls (any spelling) or sets (``mouth``, ``upper_face``, ``left`` …). Gains of a
        control that is named more than once multiply, offsets add.
    controls : ControlSet, optional
        Source of rest values and sets; the default board.

    Raises
    ------
    CurveError
        If a number is not finite, or beyond ±1e6.
    ControlError
        If a key is neither a set nor a control.
    """
    controls = controls or default_controls()
    scale = gain_factors(controls, gains or {})
    shift = np.zeros(len(controls), np.float32)
    for key, number in (offsets or {}).items():
        shift[members(controls, key)] += _finite(number, f"offset of {key}")
    places = controls.indices(curves.names)
    rest = controls.rest[places]
    return replace(curves, values=rest + (curves.values - rest) * scale[places] + shift[places])


def gain_factors(controls: ControlSet, gains: Mapping[str, float]) -> Float32:
    """Factor of every control [shape=(C,)]; arguments and errors are those of `gain`."""
    scale = np.ones(len(controls), np.float32)
    for key, number in gains.items():
        scale[members(controls, key)] *= _finite(number, f"gain of {key}")
    return scale


def smooth(
    curves: RigCurves,
    seconds: float,
    *,
    names: Iterable[str] | None = None,
    keep_closures: bool = True,
) -> RigCurves:
    """Smooth over time with a Gaussian; the ends hold their first and last value.

    A plain low pass opens the lips of a short p, b or m. With `keep_closures` the smoothed jaw and
    lips-together curves are drawn back to the unsmoothed ones around each closure: their weight is
    a Gaussian of half the width, so that the closure frame is exact and no step appears. A closure
    is the lowest jaw (below a quarter of its 95th percentile) or the highest lips-together value
    (above half of it) within one deviation, where the curve moves by more than 0.05.

    Parameters
    ----------
    curves : RigCurves
        Any values.
    seconds : float
        Standard deviation of the Gaussian, seconds; 0 returns the curves unchanged. 0.02 to 0.05
        removes jitter.
    names : iterable of str, optional
        Controls or sets to smooth; all by default.
    keep_closures : bool
        Whether closures keep their depth.

    Raises
    ------
    CurveError
        If `seconds` is negative, not finite or above 60.
    """
    if not (math.isfinite(seconds) and 0 <= seconds <= MAX_SMOOTHING_SECONDS):
        raise CurveError(
            f"smoothing over {seconds:g} s must be a finite time of 0 or more, up to "
            f"{MAX_SMOOTHING_SECONDS:g} s"
        )
    sigma = seconds * curves.fps
    if sigma < 1e-3 or len(curves) < 2:  # the next frame would weigh nothing
        return curves
    values = curves.values.copy()
    if names is None:
        chosen = np.arange(len(curves.names))
    else:
        controls = default_controls()
        wanted = {controls.names[i] for name in names for i in members(controls, name)}
        chosen = np.array(
            [i for i, name in enumerate(curves.names) if name in wanted], dtype=np.intp
        )
    from scipy.ndimage import (  # slow to import
        distance_transform_edt,
        gaussian_filter1d,
        maximum_filter1d,
        minimum_filter1d,
    )

    smoothed = gaussian_filter1d(values[:, chosen], sigma, axis=0, mode="nearest")
    values[:, chosen] = smoothed
    if keep_closures:
        present = set(chosen.tolist())
        for name in CLOSURE_CONTROLS:
            if name not in curves.names or (column := curves.index(name)) not in present:
                continue
            original = curves.values[:, column]
            # Return the frames where a moving curve is deepest in its neighbourhood, and deep.
            is_jaw = name == "CTRL_C_jaw.ty"
            size = 2 * math.ceil(sigma) + 1
            lowest, highest = minimum_filter1d(original, size), maximum_filter1d(original, size)
            reach = float(np.percentile(original, 95))
            is_deep = original <= 0.25 * reach if is_jaw else original >= max(0.5 * reach, 0.1)
            is_extreme = original == (lowest if is_jaw else highest)
            closed = np.asarray(is_extreme & is_deep & (highest - lowest > 0.05))
            if closed.any():
                # 1 on closed frames, falling as a Gaussian to 0 away from them.
                distance = distance_transform_edt(~closed)
                weight = np.exp(-0.5 * (distance / max(sigma / 2, 1e-6)) ** 2)
                weight[distance > max(1, math.ceil(3 * sigma))] = 0.0
                values[:, column] = weight * original + (1 - weight) * values[:, column]
    return replace(curves, values=values)


def members(controls: ControlSet, key: str) -> NDArray[np.intp]:
    """Return the columns of a set, or of one control.

    Raises
    ------
    ControlError
        If there is neither.
    """
    if key in controls.subset_names:
        return controls.subset(key)
    return controls.indices([key])


def _finite(number: float, what: str) -> float:
    if isinstance(number, bool) or not isinstance(number, Real):
        raise CurveError(f"{what} is {quoted(number)}; it must be a number")
    if not (math.isfinite(number) and abs(number) <= MAX_FACTOR):
        raise CurveError(f"{what} is {number:g}; it must be finite and within ±{MAX_FACTOR:g}")
    return number


def hermite(times: Float64, rows: Float64, arrive: Float64, leave: Float64, at: Float64) -> Float64:
    """Values of cubic curves with two slopes a key.

    Parameters
    ----------
    times : array [shape=(K,)]
        Rising.
    rows, arrive, leave : array [shape=(K, C)]
        Values, and slopes per unit of time before and after each key.
    at : array [shape=(T,)]
        Times; beyond the keys the curves are constant.

    Returns
    -------
    array [shape=(T, C)]
    """
    if len(times) == 1:
        return np.repeat(rows, len(at), axis=0)
    i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    gap = (times[i + 1] - times[i])[:, None]
    t = np.clip((at - times[i])[:, None] / gap, 0, 1)
    slopes = t * (1 - t) ** 2 * leave[i] - t * t * (1 - t) * arrive[i + 1]
    values: Float64 = rows[i] + t * t * (3 - 2 * t) * (rows[i + 1] - rows[i]) + gap * slopes
    return values
