"""Emotion weights and intensity over time: labels, mixtures, keyframes, edited curves.

DEITalk §3.1 conditions on one label per clip (ETH-3D: neutral, angry, happy, sad, surprised).
Deviation: here the label becomes weights (T, 9) that may mix and change over time; a label is the
special case of a constant one-hot; four procedural moods follow the five (`rig.emotions`).

Weights are not negative and sum to 1: the rest goes to neutral, so ``happy=0.7`` is 70 % happy and
30 % neutral. K keys.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deitalk.emotions.track_files import (
    TRACK_SUFFIXES,
    Columns,
    Table,
    is_table,
    number,
    read_table,
    table_of,
)
from deitalk.errors import EmotionError
from rig.arrays import Float32, Float64
from rig.curves.rig_curves import with_moods
from rig.emotions import LABELS
from rig.errors import quoted
from rig.files import atomic_write
from rig.files.reading import load_json
from rig.limits import SECONDS
from rig.written_number import number_of

MAX_INTENSITY = 4.0  # 1: as predicted from the voice; above 4 controls reach their limits
ROUNDING = 1e-4  # files round their weights
TAKE_COLUMNS = ("frame", "time", *LABELS, "saliency", "predicted", "intensity")
"""Of a take's ``intensity.csv``."""


def by_emotion(table: Mapping[str, Sequence[float]]) -> Float64:
    """Rows of a table in the order of `LABELS`; zeros for an emotion that it lacks."""
    none = [0.0] * len(next(iter(table.values())))
    return np.array([table.get(name, none) for name in LABELS])


def _numbers(values: npt.ArrayLike, name: str) -> Float64:
    try:
        numbers = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if not np.isfinite(numbers).all():
        raise EmotionError(f"{name} {quoted(values)} must be finite numbers")
    return numbers


def _check_times(times: Float64, rows: Float64) -> None:
    one_each = times.ndim == 1 and rows.ndim and 0 < len(times) == len(rows)
    if not one_each or not (np.diff(times) > 0).all():
        raise EmotionError("times must be seconds that rise, one for each row of values")


@dataclass(frozen=True, eq=False)
class EmotionTrack:
    """Emotion weights over time: linear between keys, held before the first and after the last.

    Attributes
    ----------
    times : array [shape=(K,)]
        Seconds, strictly rising.
    weights : array [shape=(K, 9), range 0 to 1]
        In the order of `LABELS`, or (K, 5) of `EMOTIONS`; each row sums to 1.
    """

    times: Float64
    weights: Float64

    def __post_init__(self) -> None:
        times, weights = _numbers(self.times, "times"), _numbers(self.weights, "weights")
        _check_times(times, weights)
        weights = with_moods(weights)
        if weights.shape != (len(times), len(LABELS)):
            raise EmotionError(f"weights of shape {weights.shape} must be (keys, {len(LABELS)})")
        if weights.min() < 0 or np.abs(weights.sum(axis=1) - 1).max() > ROUNDING:
            raise EmotionError("weights must be 0 to 1, and those of a key sum to 1")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "weights", weights)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, EmotionTrack) and (
            np.array_equal(self.times, other.times) and np.array_equal(self.weights, other.weights)
        )

    def __str__(self) -> str:
        """The text that `parse_emotion` reads: a label, weights, or a table of them."""
        if len(self.times) == 1:
            (row,) = self.weights
            if row.max() == 1:
                return LABELS[int(row.argmax())]
            named = zip(LABELS[1:], row[1:], strict=True)
            return ",".join(f"{name}={weight:.9g}" for name, weight in named if weight)
        return _table_text(("time", *LABELS), np.column_stack((self.times, self.weights)))

    def at(self, times: npt.ArrayLike) -> Float32:
        """Weights [shape=(T, 9)] at `times` [shape=(T,), seconds]."""
        seconds = np.asarray(times, float)
        weights = np.empty((*seconds.shape, len(LABELS)), np.float32)
        if len(self.times) == 1:
            weights[...] = self.weights[0]
            return weights
        for i, column in enumerate(self.weights.T):
            weights[..., i] = np.interp(seconds, self.times, column)
        return weights


@dataclass(frozen=True, eq=False)
class IntensityCurve:
    """Emotional intensity over time, as written by a take and edited by hand.

    Attributes
    ----------
    times : array [shape=(K,)]
        Seconds, strictly rising.
    values : array [shape=(K,), range 0 to 4]
        0 gives the neutral reading.
    """

    times: Float64
    values: Float64

    def __post_init__(self) -> None:
        times, values = _numbers(self.times, "times"), _numbers(self.values, "values")
        _check_times(times, values)
        if values.ndim > 1 or values.min() < 0 or values.max() > MAX_INTENSITY:
            raise EmotionError(f"values must be intensities, 0 to {MAX_INTENSITY:g}, one per time")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IntensityCurve) and (
            np.array_equal(self.times, other.times) and np.array_equal(self.values, other.values)
        )

    def __str__(self) -> str:
        """The text that `parse_intensity_curve` reads."""
        return _table_text(("time", "intensity"), np.column_stack((self.times, self.values)))

    def at(self, times: npt.ArrayLike) -> Float32:
        """Intensity [shape=(T,)] at `times` [seconds]: linear between keys, held outside."""
        values: Float32 = np.interp(np.asarray(times, float), self.times, self.values).astype(
            np.float32
        )
        return values


def parse_emotion(emotion: "str | Path | Mapping[str, float] | EmotionTrack") -> EmotionTrack:
    """Parse an emotion in any of its spellings.

    Parameters
    ----------
    emotion : str, Path, mapping or EmotionTrack
        ``"happy"``; ``"happy=0.7,surprised=0.3"``; ``{"happy": 0.7}``; or the path of a CSV, JSON
        or YAML file of keys ``time`` (seconds), ``emotion``, ``strength`` (0 … 1, which may be
        left out), or the text of a CSV or JSON. Keys at the same time mix. A table
        ``time,<emotion>,…`` of weights, such as a take's ``intensity.csv``, is read too; columns
        other than those of that file may hold notes, no numbers.

    Returns
    -------
    EmotionTrack

    Raises
    ------
    EmotionError
        Unknown emotion, weights that are negative, not finite or above 1 together, or a file
        that is missing or malformed.
    """
    if isinstance(emotion, EmotionTrack):
        return emotion
    if isinstance(emotion, Mapping):
        return _constant(_weights(emotion, "emotion weights"))
    if names_track(emotion):
        return read_emotion_track(emotion)
    assert isinstance(emotion, str)
    if is_table(emotion):
        content = load_json(emotion, "emotion", error=EmotionError) if "{" in emotion else emotion
        if isinstance(content, dict) and "keys" not in content:
            return _constant(_weights(content, "emotion weights"))
        return _track(table_of(content, "emotion"))
    if "=" in emotion:
        return _constant(_weights(_pairs(emotion), f"{emotion!r}"))
    return _constant(_weights({emotion.strip().lower(): 1.0}, f"{emotion!r}"))


def names_track(given: str | Path) -> bool:
    """Whether an emotion or an intensity curve is given as the path of a file."""
    if isinstance(given, Path):
        return True
    return not is_table(given) and given.strip().lower().endswith(TRACK_SUFFIXES)


def read_emotion_track(path: str | Path) -> EmotionTrack:
    """Read keyframes; see `parse_emotion` for the formats and errors."""
    return _track(read_table(Path(path)))


def _track(table: Table) -> EmotionTrack:
    is_wide = "emotion" not in table.names and bool(set(LABELS) & table.names)
    if is_wide:
        return _from_weights(table)
    others = table.names - {"time", "emotion", ""}
    full = {} if others and "strength" not in others else {"strength": 1.0}  # nothing else is meant
    keys = table.columns(("time", "strength"), ("emotion",), **full)
    times = _checked_times(keys)
    # Place of each name in `LABELS`.
    names = keys.texts["emotion"]
    place = {name: i for i, name in enumerate(LABELS)}
    codes = np.array([place.get(name, -1) for name in names], np.int64)
    keys.refuse(codes < 0, lambda k: _unknown(names[k]))
    first = np.concatenate([[True], np.diff(times) > 0])
    moment = np.cumsum(first) - 1  # keys at one time mix
    again = np.ones(len(codes), bool)
    again[np.unique(moment * len(LABELS) + codes, return_index=True)[1]] = False
    keys.refuse(again, lambda k: f"{LABELS[codes[k]]!r} twice at the same time; keep one")
    weights = np.zeros((int(moment[-1]) + 1, len(LABELS)))
    weights[moment, codes] = keys.numbers["strength"]
    return EmotionTrack(times[first], _distributions(table.path, times[first], weights))


def _from_weights(table: Table) -> EmotionTrack:
    """A table of weights, one row for each time."""
    present = [name for name in LABELS if name in table.names]
    notes = sorted(table.names - {"", *TAKE_COLUMNS})
    table = replace(table, keys=_without_numbers(table, notes))
    keys = table.columns(("time", *present))
    times = _checked_times(keys)
    still = np.diff(times, prepend=-1.0) <= 0
    keys.refuse(still, lambda k: f"{present[0]!r} twice at the same time; keep one")
    weights = np.zeros((len(times), len(LABELS)))
    for name in present:
        weights[:, LABELS.index(name)] = keys.numbers[name]
    return EmotionTrack(times, _distributions(table.path, times, weights))


def _without_numbers(table: Table, names: Sequence[str]) -> Iterator[tuple[int, Any]]:
    """Keys of a table; EmotionError at the first number in columns that can only hold notes."""
    for row, key in table.keys:
        for name in names:
            if np.isfinite(number_of(key.get(name))):
                raise EmotionError(
                    f"{table.path}, key {row}: {quoted(name)} is {quoted(key[name])} and no "
                    f"emotion; known are {', '.join(LABELS)}; other columns hold no numbers"
                )
        yield row, key


def _checked_times(keys: Columns) -> Float64:
    """Times of keys, checked to be within a clip and not to fall."""
    times = keys.numbers["time"]
    keys.refuse(
        np.abs(times) > SECONDS,
        lambda k: (
            f"time {times[k]:g} s is beyond {SECONDS:g} s, the longest clip; times are seconds"
        ),
    )
    keys.refuse(times[:1] < 0, lambda k: f"time {times[k]:g} s is before the recording; begin at 0")
    keys.refuse(
        np.diff(times, prepend=times[0]) < 0,
        lambda k: f"time {times[k]:g} comes after {times[k - 1]:g}; sort the keys",
    )
    return times


def _distributions(path: object, times: Float64, weights: Float64) -> Float64:
    """Rows that sum to 1, as `_weights` makes them; EmotionError names the first that cannot."""
    total = weights.sum(axis=1)
    bad = (weights < 0).any(axis=1) | (total > 1 + ROUNDING)
    if bad.any():
        row = int(np.argmax(bad))
        named = dict(zip(LABELS, weights[row].tolist(), strict=True))
        _weights(named, f"{path}, time {times[row]:g}")  # raises the error
    whole = weights.copy()
    whole[:, 0] += np.maximum(0.0, 1 - total)
    whole /= whole.sum(axis=1, keepdims=True)
    return whole


def read_intensity_curve(path: str | Path) -> IntensityCurve:
    """Read a curve with at least the columns ``time`` (seconds) and ``intensity``.

    Parameters
    ----------
    path : str or Path
        CSV of any spreadsheet (such as a take's ``intensity.csv``), JSON or YAML.

    Returns
    -------
    IntensityCurve

    Raises
    ------
    EmotionError
        Missing columns, times that do not rise, or intensities outside 0 … 4.
    """
    return _curve(read_table(Path(path)))


def parse_intensity_curve(curve: "str | Path | IntensityCurve") -> IntensityCurve:
    """A curve of a file (`read_intensity_curve`), or of the text of a CSV or JSON."""
    if isinstance(curve, IntensityCurve):
        return curve
    if isinstance(curve, Path) or not is_table(curve):
        return read_intensity_curve(curve)
    return _curve(table_of(curve, "intensity_curve"))


def _curve(table: Table) -> IntensityCurve:
    keys = table.columns(("time", "intensity"))
    times, values = _checked_times(keys), keys.numbers["intensity"]
    keys.refuse(
        np.diff(times, prepend=-1.0) <= 0,
        lambda k: f"time {times[k]:g} must be after {times[k - 1]:g}; sort the rows",
    )
    outside = ~((values >= 0) & (values <= MAX_INTENSITY))
    keys.refuse(
        outside,
        lambda k: (
            f"intensity {values[k]:g} must be 0 to {MAX_INTENSITY:g}; "
            "0 gives the neutral reading, 1 the intensity of the voice"
        ),
    )
    return IntensityCurve(times, values)


def write_intensity_csv(
    path: str | Path,
    *,
    times: npt.ArrayLike,
    weights: npt.ArrayLike,
    saliency: npt.ArrayLike,
    predicted: npt.ArrayLike,
    intensity: npt.ArrayLike,
) -> None:
    """Write ``frame,time,<9 emotions>,saliency,predicted,intensity``, atomically.

    Parameters
    ----------
    path : str or Path
        Replaced if it exists.
    times : array [shape=(T,)]
        Seconds.
    weights : array [shape=(T, 9)]
        Emotion weights.
    saliency : array [shape=(T,), range -1 to 1]
        e_sim of DEITalk Eq. 5.
    predicted : array [shape=(T,), range 0 to 1]
        Intensity predicted from the voice.
    intensity : array [shape=(T,), range 0 to 4]
        Intensity applied; `read_intensity_curve` reads this column back.
    """
    columns = np.column_stack([times, weights, saliency, predicted, intensity])
    with atomic_write(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(TAKE_COLUMNS)
        for frame, (time, *values) in enumerate(row.tolist() for row in columns):
            writer.writerow([frame, f"{time:.6f}", *(f"{value:.6g}" for value in values)])


def _table_text(header: Sequence[str], rows: Float64) -> str:
    lines = (",".join(f"{value:.9g}" for value in row) for row in rows.tolist())
    return "\n".join((",".join(header), *lines)) + "\n"


def _constant(weights: Float64) -> EmotionTrack:
    return EmotionTrack(np.zeros(1), weights[None])


def _weights(strengths: Mapping[str, float], where: str) -> Float64:
    """Weights (9,) that sum to 1 from named strengths; the rest goes to neutral."""
    weights = np.zeros(len(LABELS))
    for name, strength in strengths.items():
        if name not in LABELS:
            raise EmotionError(_unknown(name))
        value = number(strength, name, where)
        if value < 0:
            raise EmotionError(f"{where}: {name} is {value:g}; strengths must be 0 to 1")
        weights[LABELS.index(name)] = value
    total = weights.sum()
    if total > 1 + ROUNDING:
        raise EmotionError(
            f"{where}: strengths sum to {total:g}; they must not exceed 1: lower them, or use "
            "the intensity for a stronger emotion"
        )
    weights[0] += max(0.0, 1 - total)
    weights /= weights.sum()
    return weights


def _unknown(name: str) -> str:
    return f"unknown emotion {quoted(name)}; known are {', '.join(LABELS)}"


def _pairs(text: str) -> dict[str, float]:
    """``"happy=0.7, sad=0.1"`` -> {"happy": 0.7, "sad": 0.1}."""
    strengths: dict[str, float] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        name = name.lower()
        if not equals:
            raise EmotionError(f"{part.strip()!r} in {text!r} must be written <emotion>=<strength>")
        if name in strengths:
            raise EmotionError(f"{name!r} is given twice in {text!r}; give each emotion once")
        strengths[name] = number(value, name or "strength", repr(text))
    return strengths
