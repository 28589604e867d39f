"""Which emotion, and how strongly, at every moment: labels, mixtures, keyframes, edited curves.

DEITalk §3.1 conditions on one label per clip (ETH-3D: neutral, angry, happy, sad, surprised).
Deviation: here the label becomes weights (T, 5) that may mix and change over time; a label is the
special case of a constant one-hot.

Weights are not negative and sum to 1: what a user leaves open goes to neutral, so ``happy=0.7``
is 70 % happy and 30 % neutral.
"""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deitalk.errors import EmotionError
from rig.files import atomic_write

EMOTIONS = ("neutral", "angry", "happy", "sad", "surprised")
MAX_INTENSITY = 4.0  # 1 is as the voice says; beyond 4 no face is left
MAX_FILE_BYTES = 32 * 1024**2  # three hours of intensity.csv at 30 Hz are 25 MB
TRACK_SUFFIXES = (".csv", ".json", ".yaml", ".yml")

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class EmotionTrack:
    """Emotion weights over time: linear between keys, held before the first and after the last.

    Attributes
    ----------
    times : ndarray (K,) float64
        Seconds, strictly rising.
    weights : ndarray (K, 5) float64
        In the order of `EMOTIONS`; each row is not negative and sums to 1.
    """

    times: Floats
    weights: Floats

    def at(self, times: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Weights (T, 5) float32 at `times` (T,) in seconds."""
        seconds = np.asarray(times, float)
        weights = np.empty((*seconds.shape, len(EMOTIONS)), np.float32)
        for i, column in enumerate(self.weights.T):
            weights[..., i] = np.interp(seconds, self.times, column)
        return weights


@dataclass(frozen=True)
class IntensityCurve:
    """Emotional intensity over time, as written by a take and edited by hand.

    Attributes
    ----------
    times : ndarray (K,) float64
        Seconds, strictly rising.
    values : ndarray (K,) float64
        0 (neutral reading) … 4; 1 is as predicted for the average voice.
    """

    times: Floats
    values: Floats

    def at(self, times: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Intensity (T,) float32 at `times` (T,): linear between keys, held outside."""
        values: npt.NDArray[np.float32] = np.interp(
            np.asarray(times, float), self.times, self.values
        ).astype(np.float32)
        return values


def parse_emotion(emotion: "str | Path | Mapping[str, float] | EmotionTrack") -> EmotionTrack:
    """An emotion in any of its spellings, as a track.

    Parameters
    ----------
    emotion : str, Path, mapping or EmotionTrack
        ``"happy"``; ``"happy=0.7,surprised=0.3"``; ``{"happy": 0.7}``; or the path of a CSV, JSON
        or YAML file of keys ``time`` (seconds), ``emotion``, ``strength`` (0 … 1). Keys at the
        same time mix. A table ``time,<emotion>,…`` of weights, such as a take's
        ``intensity.csv``, is read too.

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
    if isinstance(emotion, Path) or Path(emotion).suffix.lower() in TRACK_SUFFIXES:
        return read_emotion_track(emotion)
    if "=" in emotion:
        return _constant(_weights(_pairs(emotion), f"{emotion!r}"))
    return _constant(_weights({emotion.strip().lower(): 1.0}, f"{emotion!r}"))


def read_emotion_track(path: str | Path) -> EmotionTrack:
    """Read keyframes; see `parse_emotion` for the formats and errors."""
    rows = _read_rows(Path(path))
    wide = not any("emotion" in row for row in rows) and any(set(EMOTIONS) & set(r) for r in rows)
    columns = ("time",) if wide else ("time", "emotion", "strength")
    keys: dict[float, dict[str, float]] = {}
    latest = -np.inf
    for number, row in enumerate(rows, start=1):
        where = f"{path}, key {number}"
        _require(row, columns, where)
        time = _number(row["time"], "time", where)
        if time < latest:
            raise EmotionError(f"{where}: time {time:g} comes after {latest:g}; sort the keys")
        latest = time
        _add_key(keys.setdefault(time, {}), row, where, wide)
    weights = [_weights(key, f"{path}, time {time:g}") for time, key in keys.items()]
    return EmotionTrack(np.array(list(keys)), np.stack(weights))


def read_intensity_curve(path: str | Path) -> IntensityCurve:
    """Read a curve with at least the columns ``time`` (seconds) and ``intensity``.

    Parameters
    ----------
    path : str or Path
        CSV (such as a take's ``intensity.csv``), JSON or YAML.

    Returns
    -------
    IntensityCurve

    Raises
    ------
    EmotionError
        Missing columns, times that do not rise, or intensities outside 0 … 4.
    """
    times: list[float] = []
    values: list[float] = []
    for number, row in enumerate(_read_rows(Path(path)), start=1):
        where = f"{path}, key {number}"
        _require(row, ("time", "intensity"), where)
        time = _number(row["time"], "time", where)
        if times and time <= times[-1]:
            raise EmotionError(f"{where}: time {time:g} must be after {times[-1]:g}; sort the rows")
        times.append(time)
        values.append(check_intensity(_number(row["intensity"], "intensity", where), where))
    return IntensityCurve(np.array(times), np.array(values))


def check_intensity(value: float, where: str = "intensity") -> float:
    """`value` itself if it is a possible intensity (finite, 0 … 4), else EmotionError."""
    if not 0 <= value <= MAX_INTENSITY:
        raise EmotionError(
            f"{where}: intensity {value:g} must be 0 to {MAX_INTENSITY:g}; "
            "0 is neutral, 1 as the voice says"
        )
    return value


def write_intensity_csv(
    path: str | Path,
    *,
    times: npt.ArrayLike,
    weights: npt.ArrayLike,
    saliency: npt.ArrayLike,
    predicted: npt.ArrayLike,
    intensity: npt.ArrayLike,
) -> None:
    """Write ``frame,time,<5 emotions>,saliency,predicted,intensity``, atomically.

    Parameters
    ----------
    path : str or Path
        Replaced if it exists.
    times : array (T,)
        Seconds.
    weights : array (T, 5)
        Emotion weights.
    saliency : array (T,)
        e_sim of DEITalk Eq. 5, 0 … 1.
    predicted : array (T,)
        Intensity from the voice alone.
    intensity : array (T,)
        Intensity as applied; this column is read back by `read_intensity_curve`.
    """
    columns = np.column_stack([times, weights, saliency, predicted, intensity])
    header = ("frame", "time", *EMOTIONS, "saliency", "predicted", "intensity")
    with atomic_write(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for frame, (time, *values) in enumerate(columns.tolist()):
            writer.writerow([frame, f"{time:.6f}", *(f"{value:.6g}" for value in values)])


def _constant(weights: Floats) -> EmotionTrack:
    return EmotionTrack(np.zeros(1), weights[None])


def _weights(strengths: Mapping[str, float], where: str) -> Floats:
    """Weights (5,) that sum to 1 from named strengths; the rest goes to neutral."""
    weights = np.zeros(len(EMOTIONS))
    for name, strength in strengths.items():
        if name not in EMOTIONS:
            raise EmotionError(f"unknown emotion {name!r}; known are {', '.join(EMOTIONS)}")
        value = _number(strength, name, where)
        if value < 0:
            raise EmotionError(f"{where}: {name} is {value:g}; strengths must be 0 to 1")
        weights[EMOTIONS.index(name)] = value
    total = weights.sum()
    if total > 1 + 1e-4:  # files round their weights
        raise EmotionError(
            f"{where}: strengths sum to {total:g}; they must not exceed 1: lower them, or use "
            "the intensity for a stronger emotion"
        )
    weights[0] += max(0.0, 1 - total)
    weights /= weights.sum()
    return weights


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
        strengths[name] = _number(value, name or "strength", repr(text))
    return strengths


def _add_key(key: dict[str, float], row: Mapping[str, Any], where: str, wide: bool) -> None:
    """Add one row's strengths to the weights at its time."""
    if wide:
        new = {name: _number(row[name], name, where) for name in EMOTIONS if name in row}
    else:
        name = str(row["emotion"]).strip().lower()
        new = {name: _number(row["strength"], "strength", where)}
    if doubled := set(key) & set(new):
        raise EmotionError(f"{where}: {sorted(doubled)[0]!r} twice at the same time; keep one")
    key.update(new)


def _require(row: Mapping[str, Any], columns: Sequence[str], where: str) -> None:
    missing = [name for name in columns if row.get(name) in (None, "")]
    if missing:
        raise EmotionError(f"{where}: no {missing[0]!r}; every key needs {', '.join(columns)}")


def _number(value: object, name: str, where: str) -> float:
    try:
        number = float("nan") if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not np.isfinite(number):
        raise EmotionError(f"{where}: {name} is {value!r}; it must be a finite number")
    return number


def _read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of a CSV, or the list of mappings in a JSON or YAML file (alone or as ``keys``)."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise EmotionError(f"{path} is larger than 32 MB; give a track with fewer keys")
        text = path.read_text(encoding="utf-8-sig")
        rows = _parse_rows(text, path)
    except OSError as error:
        raise EmotionError(
            f"cannot read {path}: {error.strerror}; give a {', '.join(TRACK_SUFFIXES)} file, or "
            f"one of {', '.join(EMOTIONS)}"
        ) from error
    except (ValueError, RecursionError, csv.Error) as error:
        if isinstance(error, EmotionError):
            raise
        reason = " ".join(str(error).split())
        raise EmotionError(f"{path} cannot be parsed: {reason}; mend the file") from error
    if not rows or not all(isinstance(row, dict) for row in rows):
        raise EmotionError(f"{path} holds no keys; give a list of keys with a 'time' each")
    return rows


def _parse_rows(text: str, path: Path) -> list[dict[str, Any]]:
    suffix = path.suffix.lower()
    if suffix == ".csv":
        delimiter = ";" if ";" in text.split("\n", 1)[0] else ","
        reader = csv.DictReader(text.splitlines(), delimiter=delimiter, skipinitialspace=True)
        return [{str(k).strip().lower(): v for k, v in row.items() if k} for row in reader]
    if suffix == ".json":
        content = json.loads(text)
    elif suffix in (".yaml", ".yml"):
        content = _load_yaml(text)
    else:
        raise EmotionError(
            f"{path}: suffix {suffix!r} is none of {', '.join(TRACK_SUFFIXES)}; rename or convert"
        )
    if isinstance(content, dict):
        content = content.get("keys")
    return content if isinstance(content, list) else []


def _load_yaml(text: str) -> Any:
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error
