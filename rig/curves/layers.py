"""Layers: edits of curves by hand that are kept in a file and applied again after every run.

A layer is a list of edits. An edit changes one control, the members of a region, or one part of
the head, within a span of time: it adds its curve (``offset``), scales the distance from rest by
it (``scale``), or replaces the value (``own``). Its curve is cubic between keys with a slope on
either side, and its weight rises from 0 at the start of the span within the ease in, and falls to
0 at the end within the ease out.

::

    {"schema": "deitalk.edit/1", "name": "fixes", "edits": [
      {"target": "CTRL_L_brow_raiseOut.ty", "mode": "offset", "span": [1.2, 2.0],
       "ease": [0.1, 0.1], "keys": [[1.2, 0], [1.6, 0.4], [2.0, 0, -0.5, 0]]}]}

A key is ``[time, value]``, with slopes of 0, or ``[time, value, arriving, leaving]`` with slopes
per second. Optional fields of a layer: ``muted``, and what it was made on: ``sound`` (length and
levels), ``words`` and ``phones`` with their times, by which it follows another recording.
Optional fields of an edit: ``span`` (else that of the keys), ``ease`` (else 0), ``owns`` (lips may
be parted by it) and ``words`` (the words within the span, for readers of the file).
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from rig import limits
from rig.arrays import Bool, Float32, Float64
from rig.controls import ControlSet, default_controls
from rig.curves.edit import MAX_FACTOR, hermite, members
from rig.curves.rig_curves import HEAD, RigCurves
from rig.errors import CurveError, listed, quoted
from rig.files.reading import load_json, read_text

SCHEMA: Final = "deitalk.edit/1"
SUFFIX: Final = ".edit.json"
MODES = ("offset", "scale", "own")
HEAD_TARGETS = tuple(f"head.{part}" for part in HEAD)
"""Targets that are parts of the head: degrees and cm, see `rig.curves.HEAD`."""
MOST_EDITS = 20_000
"""Edits of one layer, and of all layers of a file."""
MOST_LAYERS = 256
DECIMALS = 5
"""Of times, values and slopes, in files and in what is read."""
SLACK = 1e-3
"""Seconds by which a frame may lie outside of a span: times of files are rounded."""
SEEN = 0.01
"""Least difference of a value that is reported."""
LEVELS_PER_SECOND = 10
_LEVELS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
_QUIET = _LEVELS[: len(_LEVELS) // 2]
"""Levels 30 dB under the loudest, which are not compared."""
_KEY_LENGTHS = (2, 4)


@dataclass(frozen=True)
class Edit:
    """A change of one control, region or part of the head within a span.

    Parameters
    ----------
    target : str
        A control in any spelling, a region or named set, or one of `HEAD_TARGETS`.
    keys : tuple of (float, float, float, float)
        Time (seconds, rising), value, slope before and slope after the key (per second). Before
        the first and after the last key the curve is constant.
    mode : str
        ``offset``, ``scale`` or ``own``.
    span : (float, float)
        First and last second of the change.
    ease : (float, float)
        Seconds in which the change begins, and ends, within the span.
    owns : bool
        Whether lips that met before may be parted by it; an edit of mode ``own`` always may.
    words : str
        Words within the span.
    """

    target: str
    keys: tuple[tuple[float, float, float, float], ...]
    mode: str = "offset"
    span: tuple[float, float] = (0.0, 0.0)
    ease: tuple[float, float] = (0.0, 0.0)
    owns: bool = False
    words: str = ""

    @cached_property
    def _table(self) -> Float64:
        return np.array(self.keys, float)

    def curve(self, times: Float64) -> Float64:
        """The curve through the keys at times [shape=(T,), seconds]."""
        time, value, arrive, leave = self._table.T
        return hermite(time, value[:, None], arrive[:, None], leave[:, None], times)[:, 0]

    def weight(self, times: Float64) -> Float64:
        """Share of the change at times [shape=(T,), range 0 to 1]."""
        (start, end), (before, after) = self.span, self.ease
        rise = np.clip((times - start) / before, 0, 1) if before > 0 else np.ones(len(times))
        fall = np.clip((end - times) / after, 0, 1) if after > 0 else np.ones(len(times))
        inside = (times >= start - SLACK) & (times <= end + SLACK)
        weight: Float64 = inside * _smooth(rise) * _smooth(fall)
        return weight

    def tree(self) -> dict[str, Any]:
        """What a file holds of it."""
        flat = all(arrive == leave == 0 for _, _, arrive, leave in self.keys)
        found: dict[str, Any] = {
            "target": self.target,
            "mode": self.mode,
            "span": [_rounded(time) for time in self.span],
            "keys": [[_rounded(number) for number in key[: 2 if flat else 4]] for key in self.keys],
        }
        found |= {"ease": [_rounded(time) for time in self.ease]} if any(self.ease) else {}
        found |= {"owns": True} if self.owns else {}
        return found | ({"words": self.words} if self.words else {})


def _smooth(share: Float64) -> Float64:
    return share * share * (3 - 2 * share)


def _rounded(number: float) -> float:
    """A time or value as files hold it."""
    short = round(number, DECIMALS)
    return int(short) if short == int(short) else short


@dataclass(frozen=True)
class Sound:
    """By what the recording is known that a layer was made on.

    Parameters
    ----------
    seconds : float
        Its length.
    levels : str
        A letter for each tenth of a second: 61 steps of 1 dB, the loudest is ``z``.
    """

    seconds: float
    levels: str

    @classmethod
    def of(cls, samples: Float32, rate: int) -> "Sound":
        """Measure samples [shape=(S,)] at a rate (Hz)."""
        size = rate // LEVELS_PER_SECOND
        rows = np.pad(samples.astype(float), (0, -len(samples) % size)).reshape(-1, size)
        level = 10 * np.log10(np.maximum((rows**2).mean(axis=1), 1e-12))
        steps = np.round(level - level.max(initial=-120.0) + len(_LEVELS) - 1)
        letters = np.clip(steps, 0, len(_LEVELS) - 1).astype(int)
        return cls(round(len(samples) / rate, 3), "".join(_LEVELS[k] for k in letters))

    def is_same(self, other: "Sound") -> bool:
        """Whether another is the same recording: rounded, resampled or with silence after it."""
        shorter, longer = sorted((self.levels, other.levels), key=len)
        if not shorter or longer[len(shorter) + 1 :].strip(_QUIET):
            return False
        ours, theirs = (_steps(levels[: len(shorter)]) for levels in (shorter, longer))
        heard = np.maximum(ours, theirs) > len(_QUIET)
        return bool(np.abs(ours - theirs)[heard].mean() < 1) if heard.any() else True


def _steps(levels: str) -> Float64:
    return np.array([_LEVELS.index(letter) for letter in levels], float)


@dataclass(frozen=True)
class Layer:
    """Edits that belong together, in their order.

    Parameters
    ----------
    edits : tuple of Edit
    name : str
    muted : bool
        Whether it changes nothing for now.
    sound : Sound, optional
        The recording that it was made on.
    words : tuple of (str, float, float)
        Words of that recording with their first and last second.
    phones : tuple of (str, int)
        Its phones one after the other from its first second on, each with its length in sixtieths
        of a second.
    """

    edits: tuple[Edit, ...]
    name: str = ""
    muted: bool = False
    sound: Sound | None = None
    words: tuple[tuple[str, float, float], ...] = ()
    phones: tuple[tuple[str, int], ...] = field(default=(), repr=False)

    @property
    def n_keys(self) -> int:
        """Keys of all edits."""
        return sum(len(edit.keys) for edit in self.edits)

    @property
    def text(self) -> str:
        """The content of its file, which `parse_layers` reads."""
        tree = self.tree()
        edits = ",\n".join(f"  {_compact(edit)}" for edit in tree.pop("edits"))
        return f'{_compact(tree)[:-1]}, "edits": [\n{edits}\n]}}\n'

    def tree(self) -> dict[str, Any]:
        """What a file holds of it."""
        found: dict[str, Any] = {"schema": SCHEMA}
        found |= {"name": self.name} if self.name else {}
        found |= {"muted": True} if self.muted else {}
        if self.sound is not None:
            found["sound"] = {"seconds": self.sound.seconds, "levels": self.sound.levels}
        if self.words:
            found["words"] = [[text, _rounded(a), _rounded(b)] for text, a, b in self.words]
        if self.phones:
            found["phones"] = " ".join(f"{name} {length}" for name, length in self.phones)
        return found | {"edits": [edit.tree() for edit in self.edits]}


def _compact(tree: Any) -> str:
    return json.dumps(tree, ensure_ascii=False, separators=(",", ":"))


# Files, and the text of fields.


def read_layers(path: Path) -> tuple[Layer, ...]:
    """Read a file of a layer or of a list of layers, or the layers that lie in a take folder.

    Raises
    ------
    CurveError
        As `parse_layers`; if the file is missing or too large, or the folder has no layers.
    """
    if path.is_dir():
        files = sorted(path.glob(f"*{SUFFIX}"))
        if not files:
            raise CurveError(f"{path} holds no layers (*{SUFFIX}); name a file of edits")
        return tuple(layer for file in files for layer in read_layers(file))
    return parse_layers(read_text(path, limits.EDIT_BYTES, error=CurveError), path.name)


def parse_layers(given: Any, where: str = "edit") -> tuple[Layer, ...]:
    """Layers of JSON text or of what it holds: a layer, or a list of layers.

    Raises
    ------
    CurveError
        One line: which edit, the value and the rule.
    """
    tree = load_json(given, where, error=CurveError) if isinstance(given, str | bytes) else given
    trees = list(tree) if isinstance(tree, list | tuple) else [tree]
    if len(trees) > MOST_LAYERS:
        raise CurveError(f"{where} holds {len(trees)} layers; at most {MOST_LAYERS} are read")
    return tuple(one if isinstance(one, Layer) else _layer(one, where) for one in trees)


def _layer(tree: Any, where: str) -> Layer:
    if not isinstance(tree, Mapping) or tree.get("schema") != SCHEMA:
        raise CurveError(f"{where} is no layer of edits: its schema must be {SCHEMA}")
    _known(tree, ("schema", "name", "muted", "sound", "words", "phones", "edits"), where)
    edits = _list(tree.get("edits"), f"{where}: edits")
    if len(edits) > MOST_EDITS:
        raise CurveError(f"{where} has {len(edits)} edits; at most {MOST_EDITS} are read")
    return Layer(
        tuple(_edit(one, f"{where}, edit {k}") for k, one in enumerate(edits, 1)),
        _text(tree.get("name", ""), f"{where}: name"),
        _flag(tree.get("muted", False), f"{where}: muted"),
        _sound(tree.get("sound"), where),
        _words(tree.get("words", []), where),
        _phones(tree.get("phones", ""), where),
    )


def _edit(tree: Any, where: str) -> Edit:
    if not isinstance(tree, Mapping):
        raise CurveError(f"{where} is {quoted(tree)}; it must be an object with target and keys")
    _known(tree, ("target", "mode", "span", "ease", "keys", "owns", "words"), where)
    target, mode = _text(tree.get("target", ""), f"{where}: target"), tree.get("mode", "offset")
    if not target:
        raise CurveError(f"{where} has no target; name a control, a region or head.yaw")
    if mode not in MODES:
        raise CurveError(f"{where}: mode {quoted(mode)} must be {', '.join(MODES)}")
    keys = [_key(key, where) for key in _list(tree.get("keys"), f"{where}: keys")]
    if not keys:
        raise CurveError(f"{where} has no keys; give at least one [time, value]")
    if len(keys) > limits.KEYS:
        raise CurveError(f"{where} has {len(keys)} keys; at most {limits.KEYS} are read")
    for before, after in pairwise(keys):
        if after[0] <= before[0]:
            raise CurveError(f"{where}: key at {after[0]:g} s comes after {before[0]:g}; sort them")
    span = _numbers(tree.get("span", (keys[0][0], keys[-1][0])), 2, f"{where}: span")
    ease = _numbers(tree.get("ease", (0, 0)), 2, f"{where}: ease")
    if not 0 <= span[0] <= span[1] <= limits.SECONDS:
        raise CurveError(f"{where}: span {span[0]:g} to {span[1]:g} s must rise, from 0 on")
    if min(ease) < 0:
        raise CurveError(f"{where}: ease {min(ease):g} s must be 0 or more")
    owns = _flag(tree.get("owns", False), f"{where}: owns")
    words = _text(tree.get("words", ""), f"{where}: words")
    return Edit(target, tuple(keys), mode, (span[0], span[1]), (ease[0], ease[1]), owns, words)


def _key(given: Any, where: str) -> tuple[float, float, float, float]:
    if not isinstance(given, list | tuple) or len(given) not in _KEY_LENGTHS:
        raise CurveError(
            f"{where}: key {quoted(given)} must be [time, value] or [time, value, arriving slope, "
            "leaving slope]"
        )
    time, value, arrive, leave = (*_numbers(given, len(given), f"{where}: key"), 0.0, 0.0)[:4]
    if not 0 <= time <= limits.SECONDS:
        raise CurveError(f"{where}: key at {time:g} s must be within 0 to {limits.SECONDS:g} s")
    return time, value, arrive, leave


def _sound(tree: Any, where: str) -> Sound | None:
    if tree is None:
        return None
    if not isinstance(tree, Mapping) or not isinstance(tree.get("levels"), str):
        raise CurveError(f"{where}: sound must hold seconds and levels; leave it out")
    if not set(tree["levels"]) <= set(_LEVELS):
        raise CurveError(f"{where}: levels of the sound must be letters and digits; leave it out")
    (seconds,) = _numbers([tree.get("seconds")], 1, f"{where}: sound")
    return Sound(seconds, tree["levels"])


def _words(given: Any, where: str) -> tuple[tuple[str, float, float], ...]:
    found = []
    for word in _list(given, f"{where}: words"):
        if not isinstance(word, list | tuple) or len(word) != 3:
            raise CurveError(f"{where}: word {quoted(word)} must be [text, start, end]")
        start, end = _numbers(word[1:], 2, f"{where}: word")
        found.append((_text(word[0], f"{where}: word"), start, end))
    return tuple(found)


def _phones(given: Any, where: str) -> tuple[tuple[str, int], ...]:
    parts = _text(given, f"{where}: phones").split()
    names, lengths = parts[::2], parts[1::2]
    if len(names) != len(lengths) or not all(n.isascii() and n.isdigit() for n in lengths):
        raise CurveError(f"{where}: phones must be names, each with a whole number; leave them out")
    return tuple((name, int(length[:7])) for name, length in zip(names, lengths, strict=True))


def _known(tree: Mapping[str, Any], names: Sequence[str], where: str) -> None:
    for name in tree:
        if name not in names:
            raise CurveError(f"{where}: no field {quoted(name)}; known are {', '.join(names)}")


def _list(given: Any, where: str) -> list[Any]:
    if not isinstance(given, list | tuple):
        raise CurveError(f"{where} must be a list, not {quoted(given)}")
    return list(given)


def _text(given: Any, where: str) -> str:
    if not isinstance(given, str):
        raise CurveError(f"{where} must be a text, not {quoted(given)}")
    return given


def _flag(given: Any, where: str) -> bool:
    if not isinstance(given, bool):
        raise CurveError(f"{where} must be true or false, not {quoted(given)}")
    return given


def _numbers(given: Any, count: int, where: str) -> list[float]:
    """Finite numbers of a list."""
    numbers = list(given) if isinstance(given, list | tuple) else []
    for number in numbers:
        is_number = isinstance(number, int | float) and not isinstance(number, bool)
        if not is_number or not math.isfinite(number) or abs(number) > MAX_FACTOR:
            raise CurveError(f"{where} {quoted(number)} must be a finite number within ±1e6")
    if len(numbers) != count:
        raise CurveError(f"{where} {quoted(given)} must be {count} numbers")
    return [round(float(number), DECIMALS) for number in numbers]


# Layers on curves.


@dataclass(frozen=True)
class Closures:
    """Which controls close and part the lips, and from which contact on lips that meet stay so.

    Parameters
    ----------
    seals : tuple of sequence of int
        Columns of the controls set that close the lips, by kind: lips together, lip on teeth.
    opening : sequence of int
        Columns of those that part them.
    begin, full : float
        Mean of a kind from which the contact is kept, and from which it is kept in full.
    """

    seals: tuple[Sequence[int], ...]
    opening: Sequence[int]
    begin: float
    full: float

    def closed(self, values: Float32) -> Float64:
        """How closed the lips are in curves of the whole set (T, C) [shape=(T,), 0 to 1]."""
        means = [values[:, list(kind)].mean(axis=1) for kind in self.seals if len(kind)]
        if not means:
            return np.zeros(len(values))
        share = (np.max(means, axis=0) - self.begin) / (self.full - self.begin)
        return _smooth(np.clip(share, 0, 1))


def apply_layers(
    curves: RigCurves,
    layers: Iterable[Layer],
    controls: ControlSet | None = None,
    closures: Closures | None = None,
) -> tuple[RigCurves, tuple[str, ...]]:
    """Apply layers in their order, then meet the closures again, then keep the ranges.

    Parameters
    ----------
    curves : RigCurves
        All controls of the set, in its order.
    layers : iterable of Layer
        Muted ones change nothing.
    controls : ControlSet, optional
        Ranges, rest values and regions; the default board.
    closures : Closures, optional
        Where the lips are closed before the layers, no edit lowers what closes them or raises what
        parts them, unless it owns its control there.

    Returns
    -------
    curves : RigCurves
        The tracks are kept; the head is changed by edits of it.
    notes : tuple of str
        A line on what closures took back, and on what was beyond a range.

    Raises
    ------
    ControlError
        If a target is neither a control, nor a set, nor a part of the head.
    """
    controls = controls or default_controls()
    edits = [edit for layer in layers if not layer.muted for edit in layer.edits]
    targets = {edit.target: target_columns(controls, edit.target) for edit in edits}
    columns = np.unique(np.concatenate([np.zeros(0, np.intp), *targets.values()]))
    before = curves.values[:, columns]
    values, owned = before.astype(float), np.zeros(before.shape, bool)
    head = None if curves.head is None else curves.head.copy()
    for edit in edits:
        start, end = edit.span
        rows = slice(*np.searchsorted(curves.times, (start - SLACK, end + SLACK)))
        times = curves.times[rows]
        if edit.target not in HEAD_TARGETS:
            part = (
                np.arange(rows.start, rows.stop)[:, None],
                np.searchsorted(columns, targets[edit.target]),
            )
            values[part] = _changed(edit, times, values[part], controls.rest[targets[edit.target]])
            if edit.owns or edit.mode == "own":
                owned[part] |= edit.weight(times)[:, None] > 0
        elif head is not None:
            place = HEAD_TARGETS.index(edit.target)
            head[rows, place] = _changed(edit, times, head[rows, [place]], 0.0)[:, 0]
    names, notes = [controls.names[column] for column in columns], []
    if closures is not None:
        met = _met(values, before, owned, columns, closures, closures.closed(curves.values))
        notes.append(_note(names, values, met, "were taken back, as lips meet there"))
        values = met
    inside = np.clip(values, controls.minimum[columns], controls.maximum[columns])
    notes.append(_note(names, values, inside, "were brought into their ranges"))
    changed = curves.values.copy()
    changed[:, columns] = np.where(values == before, before, inside)
    return replace(curves, values=changed, head=head), tuple(note for note in notes if note)


def _note(names: Sequence[str], asked: Float64, given: Float64, what: str) -> str:
    """A line on values that differ by more than `SEEN` from those that were asked for."""
    missed = np.abs(asked - given) > SEEN
    if not missed.any():
        return ""
    controls = [name for name, column in zip(names, missed.T, strict=True) if column.any()]
    return f"{int(missed.sum())} edited values of {listed(controls)} {what}"


def target_columns(controls: ControlSet, target: str) -> Any:
    """Columns of a target's controls; none of a part of the head.

    Raises
    ------
    ControlError
        If it is neither a control, nor a set, nor a part of the head.
    """
    if target in HEAD_TARGETS:
        return np.zeros(0, np.intp)
    return members(controls, target)


def _changed(edit: Edit, times: Float64, values: Any, rest: Any) -> Float64:
    """Values (T, N) with an edit."""
    curve, weight = edit.curve(times)[:, None], edit.weight(times)[:, None]
    if edit.mode == "offset":
        changed: Float64 = values + weight * curve
    elif edit.mode == "scale":
        changed = rest + (values - rest) * (1 + weight * (curve - 1))
    else:
        changed = values + weight * (curve - values)
    return changed


def _met(
    values: Float64,
    before: Float32,
    owned: Bool,
    columns: Any,
    closures: Closures,
    closed: Float64,
) -> Float64:
    """Values without what parts lips that were closed (T,)."""
    met = values.copy()
    for place, column in enumerate(columns.tolist()):
        change = values[:, place] - before[:, place]
        if any(column in kind for kind in closures.seals):
            met[:, place] -= (1 - owned[:, place]) * closed * np.minimum(change, 0)
        elif column in closures.opening:
            met[:, place] -= (1 - owned[:, place]) * closed * change
    return met


def retimed(layer: Layer, old: Float64, new: Float64) -> Layer:
    """The layer on another time axis.

    Parameters
    ----------
    layer : Layer
        Its times are those of `old`.
    old, new : array [shape=(N,)]
        Rising seconds that belong together: linear between them, shifted before the first and
        after the last.
    """
    return replace(layer, edits=tuple(_retimed(edit, old, new) for edit in layer.edits))


def _retimed(edit: Edit, old: Float64, new: Float64) -> Edit:
    def place(time: float) -> float:
        if time <= old[0]:
            return max(float(time - old[0] + new[0]), 0.0)
        if time >= old[-1]:
            return float(time - old[-1] + new[-1])
        return float(np.interp(time, old, new))

    def stretch(a: float, b: float) -> float:
        return max(place(b) - place(a), 1e-6) / max(b - a, 1e-6)

    keys: list[tuple[float, float, float, float]] = []
    start, end = edit.span
    times = [key[0] for key in edit.keys]
    for k, (time, value, arrive, leave) in enumerate(edit.keys):
        before = stretch(times[k - 1], time) if k else 1.0
        after = stretch(time, times[k + 1]) if k + 1 < len(times) else 1.0
        at = place(time)
        if keys and at <= keys[-1][0]:  # two moments that are one in the other recording
            at = keys[-1][0] + 1e-3
        keys.append((at, value, arrive / before, leave / after))
    (first, last), (rise, fall) = edit.span, edit.ease
    ease = place(first + rise) - place(first), place(last) - place(last - fall)
    span = place(start), max(place(end), place(start))
    return replace(edit, keys=tuple(keys), span=span, ease=(max(ease[0], 0), max(ease[1], 0)))
