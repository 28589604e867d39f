"""A clip for Unreal: its file, its rate and its names; used by ``deitalk_unreal.py`` beside it."""

from __future__ import annotations

import json
import os
from bisect import bisect_right
from fractions import Fraction
from functools import cache
from math import asin, atan2, cos, degrees, gcd, lcm, radians, sin
from typing import Any

SCHEMA = "deitalk.unreal/2"
SCHEMAS = (SCHEMA, "deitalk.unreal/1")
RATES = [Fraction(fps) for fps in (24, 25, 30, 48, 50, 60, 120)]
RATES += [Fraction(fps, 1001) for fps in (24000, 30000, 60000)]
"""Frames per second that clips of an odd rate, such as a phone's 10000/167, are put on."""


class DeitalkError(RuntimeError):
    """An error that the user can correct; the message says how."""


TURNS = ("HeadYaw", "HeadPitch", "HeadRoll")
"""Curves of the head's turn, degrees in the axes of its bone (up, forward, right): for small turns
minus pitch, roll, minus yaw of a head track."""
SHIFTS = {
    "HeadTranslationX": ("z", -1.0),
    "HeadTranslationY": ("x", 1.0),
    "HeadTranslationZ": ("y", 1.0),
}
"""Curves of its shift, cm, from columns of a head track: Epic's mesh of a face looks along -x."""
ANGLES = ("yaw", "pitch", "roll")


VERSIONS = {"MHFDSVersion": 1.0, "DisableFaceOverride": 1.0}
"""Constant curves of MetaHuman Animator's sequences and subjects since 5.6."""


def load(path: str) -> dict[str, Any]:
    """Read and check a ``*.unreal.json``.

    Raw curves become numbers, a head track becomes curves of `TURNS` and `SHIFTS`; `VERSIONS` are
    added.
    """
    try:
        with open(path, encoding="utf-8") as stream:
            data = json.load(stream)
    except (OSError, ValueError) as error:
        raise DeitalkError(f"cannot read {path}: {error}") from error
    if not isinstance(data, dict) or data.get("schema") not in SCHEMAS:
        raise DeitalkError(f"{path} is not of schema {SCHEMA}; write it with deitalk convert")
    n_frames, rate = data.get("n_frames"), data.get("frame_rate")
    if type(n_frames) is not int or n_frames < 1:
        raise DeitalkError(f"{path}: n_frames is {n_frames!r}; it must be 1 or more")
    if not isinstance(rate, list) or [type(n) for n in rate] != [int, int] or min(rate) < 1:
        raise DeitalkError(f"{path}: frame_rate is {rate!r}; it must be two whole numbers above 0")
    try:
        raw = {name: raw_values(curve, data["board"]) for name, curve in data["raw"].items()}
        data["raw"] = {**raw, **VERSIONS, **head_curves(data.get("head"))}
        channels = [*data["raw"].values()]
        channels += [values for axes in data["board"].values() for values in axes.values()]
        lists = [values if isinstance(values, list) else [values] for values in channels]
        finite = all(-1e9 < value < 1e9 for values in lists for value in values)
    except (KeyError, AttributeError, TypeError, ValueError, IndexError) as error:
        raise DeitalkError(f"{path}: raw or board is damaged; write it again") from error
    lengths = {len(values) for values in channels if isinstance(values, list)} - {n_frames}
    if lengths or not finite:
        what = f"{min(lengths)} values, not {n_frames}" if lengths else "NaN or a huge number"
        raise DeitalkError(f"{path}: a curve has {what}; write it again")
    return data


def raw_values(curve: Any, board: dict[str, Any]) -> Any:
    """Return the numbers of a raw curve: its own, or a function of channels of the board.

    ``of`` are the channels, as ``control.axis``; their sum, within -1 to 1, is put into the
    piecewise linear function with the ``knots``, which is constant beyond them.
    """
    if not isinstance(curve, dict):
        return curve
    channels = [board[control][axis] for control, axis in (o.split(".") for o in curve["of"])]
    places, levels = zip(*curve["knots"])  # noqa: B905  (Python 3.9)

    def value(parts: Any) -> float:
        return interpolated(places, levels, min(max(sum(parts), -1.0), 1.0))

    lists = [values for values in channels if isinstance(values, list)]
    if not lists:
        return value(channels)
    columns = [v if isinstance(v, list) else [v] * len(lists[0]) for v in channels]
    return [value(row) for row in zip(*columns)]  # noqa: B905


def interpolated(places: Any, values: Any, at: float) -> float:
    """Return a value at a place, linear between rising places and constant beyond them."""
    if at <= places[0] or at >= places[-1]:
        return float(values[0] if at <= places[0] else values[-1])
    i = bisect_right(places, at)
    share = (at - places[i - 1]) / (places[i] - places[i - 1])
    return float(values[i - 1] + share * (values[i] - values[i - 1]))


def head_curves(head: Any) -> dict[str, Any]:
    """Return curves of a head track and the switch that lets them turn it, if there is one."""
    if head is None:
        return {}
    curves = {"HeadControlSwitch": 1.0, **turned([head[name] for name in ANGLES], TURNS, _in_bone)}
    for curve, (column, sign) in SHIFTS.items():
        curves[curve] = scaled(head[column], sign)
    return curves


def head_of_curves(curves: dict[str, Any]) -> dict[str, Any]:
    """Return the head track of curves of Unreal; those that are absent are 0."""
    track = turned([curves.get(name, 0.0) for name in TURNS], ANGLES, _of_bone)
    for curve, (column, sign) in SHIFTS.items():
        track[column] = scaled(curves.get(curve, 0.0), sign)
    return track


def scaled(values: Any, factor: float) -> Any:
    """Return a list of numbers, or one, times a factor."""
    return [factor * v for v in values] if isinstance(values, list) else factor * values


def turned(columns: list[Any], names: tuple[str, ...], change: Any) -> dict[str, Any]:
    """Return three named columns of angles made of three by `change`, each a list or one number."""
    size = max((len(values) for values in columns if isinstance(values, list)), default=0)
    lists = [values if isinstance(values, list) else [values] * (size or 1) for values in columns]
    rows = [change(*(radians(angle) for angle in row)) for row in zip(*lists)]  # noqa: B905
    found = {name: [degrees(row[i]) + 0.0 for row in rows] for i, name in enumerate(names)}
    return found if size else {name: values[0] for name, values in found.items()}


def _in_bone(yaw: float, pitch: float, roll: float) -> tuple[float, float, float]:
    """Yaw, pitch and roll of Unreal's rotator in the head bone's axes, of a head track's; radians.

    A head track rolls, then pitches, then yaws; of the bone's axes the first turn is about the
    upright one, then the forward and the sideways one.
    """
    sin_yaw, cos_yaw, sin_roll, cos_roll = sin(yaw), cos(yaw), sin(roll), cos(roll)
    up, level = sin(pitch), cos(pitch)
    tilt = cos_yaw * sin_roll - sin_yaw * up * cos_roll
    nod = atan2(-sin_yaw * sin_roll - cos_yaw * up * cos_roll, level * cos_roll)
    side = atan2(-sin_yaw * level, cos_yaw * cos_roll + sin_yaw * up * sin_roll)
    return nod, asin(max(-1.0, min(1.0, tilt))), side


def _of_bone(yaw: float, pitch: float, roll: float) -> tuple[float, float, float]:
    """The inverse of `_in_bone`."""
    sin_nod, cos_nod, sin_side, cos_side = sin(yaw), cos(yaw), sin(roll), cos(roll)
    tilt, level = sin(pitch), cos(pitch)
    up = cos_nod * tilt * sin_side - sin_nod * cos_side
    around = atan2(-level * sin_side, sin_nod * tilt * sin_side + cos_nod * cos_side)
    over = atan2(cos_nod * tilt * cos_side + sin_nod * sin_side, cos_nod * level)
    return around, asin(max(-1.0, min(1.0, up))), over


def asset_name(path: str) -> str:
    """Return the file's name as an asset name: letters, digits and underscores."""
    stem = os.path.basename(path).split(".")[0]
    return "".join(c if c.isalnum() or c == "_" else "_" for c in stem)


def subject_of(path: str) -> str:
    """Return the Live Link subject that Unreal's importer takes from a file name.

    ``_cal``, ``_raw`` or ``_neutral`` at the end are left out. More than three words between
    underscores: those after the first number that is not the first word; else the whole name.
    """
    stem = os.path.basename(path).rsplit(".", 1)[0]
    for ending in ("_cal", "_raw", "_neutral"):
        stem = stem[: -len(ending)] if stem.endswith(ending) else stem
    words = stem.split("_")
    numbers = [i for i, word in enumerate(words) if i and word.isdigit()]
    rest = words[numbers[0] + 1 :] if len(words) > 3 and numbers else []
    return "_".join(rest) or stem


def start_of_take(path: str) -> float:
    """Return the time of day of the first frame of a Live Link Face CSV, seconds.

    As Unreal's importer: FF counts sixtieths if one of the file exceeds 30.0, else thirtieths.
    """
    try:
        with open(path, encoding="utf-8-sig") as stream:
            codes = [line.split(",", 1)[0].split(":") for line in stream][1:]
        fields = [[float(part) for part in code] for code in codes if len(code) == 4]
        hours, minutes, seconds, frames = fields[0]
    except (OSError, ValueError, IndexError) as error:
        raise DeitalkError(f"{path} has no time codes: {error}; run: deitalk validate") from error
    rate = 60 if max(field[3] for field in fields) > 30.0 else 30
    return hours * 3600 + minutes * 60 + seconds + frames / rate


def standard_rate(data: dict[str, Any]) -> Fraction:
    """Return the frames per second of a clip, or the nearest of `RATES` if it is an odd rate."""
    own = Fraction(*data["frame_rate"])
    if own.denominator in (1, 1001):
        return own
    return min(RATES, key=lambda rate: abs(rate / own - 1))


def frame_count(data: dict[str, Any], fps: Fraction) -> int:
    """Return the number of frames of a clip at another rate."""
    return int((data["n_frames"] - 1) * fps / Fraction(*data["frame_rate"])) + 1


def resampled(data: dict[str, Any], values: Any, fps: Fraction) -> list[float]:
    """Return values at another rate, linear between frames; one number stays one."""
    own = Fraction(*data["frame_rate"])
    if not isinstance(values, list) or own == fps:
        return [float(v) for v in (values if isinstance(values, list) else [values])]
    step, places = float(own / fps), range(len(values))
    return [interpolated(places, values, i * step) for i in range(frame_count(data, fps))]


def rate_steps(current: Fraction, wanted: Fraction) -> list[Fraction]:
    """Return the rates to set one after the other.

    Unreal refuses a rate that is neither a multiple nor a factor of the present one, so others go
    through a common multiple: from 30 to 24 through 120.
    """
    if 1 in ((current / wanted).denominator, (wanted / current).denominator):
        return [wanted]
    common = lcm(current.numerator, wanted.numerator)
    return [Fraction(common, gcd(current.denominator, wanted.denominator)), wanted]


def key_frames(values: list[float]) -> list[int]:
    """Return the frames that need linear keys: all but those within a run of one value."""
    last = len(values) - 1
    around = [values[max(i - 1, 0) : i + 2] for i in range(len(values))]
    return [i for i in range(len(values)) if i in (0, last) or min(around[i]) < max(around[i])]


def curve_keys(values: list[float], tolerance: float) -> list[list[Any]]:
    """Return few keys whose cubic segments stay within a tolerance of all values.

    Each is [frame, arriving slope, leaving slope], slopes per frame; its value is that of the
    frame. First and last frame of every run at the highest value are keyed: lips that meet do so
    at their frame. A curve that moves less than the tolerance has one key.
    """
    top, last = max(values), len(values) - 1
    if top - min(values) <= tolerance:
        return [[0, 0.0, 0.0]]
    held = [value >= top - 1e-6 for value in values] + [False]
    ends = [i for i in range(1, last) if held[i] and not (held[i - 1] and held[i + 1])] + [last]
    return split_curve(ends, tolerance, lambda first, end: fit_segment(values, first, end))


def split_curve(ends: list[int], tolerance: float, fit: Any) -> list[list[Any]]:
    """Return keys from frame 0 to the last of `ends`, all of which have one.

    Segments are as long as they can be, one after the other. `fit` takes two frames and returns
    the largest error of a cubic between them and its two slopes.
    """
    keys: list[list[Any]] = [[0, 0.0, 0.0]]
    for end in ends:
        while keys[-1][0] < end:
            first = keys[-1][0]
            near, far = first + 1, min(end, first + 96) + 1
            step, best = 1, fit(first, first + 1)
            while near + 1 < far:
                middle = min(near + step, far - 1)
                found = fit(first, middle)
                if found[0] <= tolerance:
                    near, best, step = middle, found, 2 * step
                else:
                    far, step = middle, max((middle - near) // 2, 1)
            keys[-1][2] = best[1]
            keys.append([near, best[2], 0.0])
    return keys


def cubic_basis(frames: int) -> tuple[list[float], list[float], float, float, float, float]:
    """Return what slopes of 1 at either end add between them, and the normal equations.

    The small weight keeps the slopes near the line where frames are few.
    """
    n = float(frames)
    left = [i * (1 - i / n) ** 2 for i in range(1, frames)]
    right = [-i * (i / n) * (1 - i / n) for i in range(1, frames)]
    aa = sum([a * a for a in left]) + 1e-6
    bb = sum([b * b for b in right]) + 1e-6
    ab = sum([a * b for a, b in zip(left, right)])  # noqa: B905
    return left, right, aa, bb, ab, aa * bb - ab * ab


def fit_segment(values: list[float], first: int, last: int) -> tuple[float, float, float]:
    """Return the largest error of a cubic through two frames' values, and its slopes per frame."""
    left, right, aa, bb, ab, det = cubic_basis(last - first)
    slope = (values[last] - values[first]) / float(last - first)
    off = [values[first + i] - values[first] - slope * i for i in range(1, last - first)]
    ra = sum([a * r for a, r in zip(left, off)])  # noqa: B905
    rb = sum([b * r for b, r in zip(right, off)])  # noqa: B905
    a, b = (ra * bb - rb * ab) / det, (rb * aa - ra * ab) / det
    errors = [abs(r - a * p - b * q) for r, p, q in zip(off, left, right)]  # noqa: B905
    return max(errors or [0.0]), slope + a, slope + b


KEYS = (key_frames, curve_keys, split_curve, fit_segment, cubic_basis)
"""Functions that scripts for other programs have as text, without what follows."""
cubic_basis = cache(cubic_basis)


def describe(values: Any) -> str:
    """Return a line on a curve."""
    if isinstance(values, list) and len(values) > 1:
        return f"{len(values)} keys, {min(values):g} to {max(values):g}"
    return f"constant {values[0] if isinstance(values, list) else values:g}"
