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
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np

from rig.arrays import Float32, Float64
from rig.curves.edit import hermite
from rig.curves.rig_curves import HEAD

SCHEMA: Final = "deitalk.edit/1"
SUFFIX: Final = ".edit.json"
MODES = ("offset", "scale", "own")
HEAD_TARGETS = tuple(f"head.{part}" for part in HEAD)
"""Targets that are parts of the head: degrees and cm, see `rig.curves.HEAD`."""
MOST_EDITS = 20_000
"""Edits of one layer, and of all layers of a file."""
MOST_LAYERS = 256
DECIMALS = 5
"""Decimals of times, values and slopes, in files and in what is read."""
SLACK = 1e-3
"""Seconds by which a frame may lie outside of a span: times of files are rounded."""
SEEN = 0.01
"""Least difference of a value that is reported."""
LEVELS_PER_SECOND = 10
LEVELS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
_QUIET = LEVELS[: len(LEVELS) // 2]
"""Levels 30 dB under the loudest, which are not compared."""
KEY_LENGTHS = (2, 4)


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
        weight: Float64 = inside * eased(rise) * eased(fall)
        return weight

    def applied(self, times: Float64, values: Any, rest: Any) -> Float64:
        """Values (T, N) at times [shape=(T,), seconds] with the change; `rest` is theirs."""
        curve, weight = self.curve(times)[:, None], self.weight(times)[:, None]
        if self.mode == "offset":
            changed: Float64 = values + weight * curve
        elif self.mode == "scale":
            changed = rest + (values - rest) * (1 + weight * (curve - 1))
        else:
            changed = values + weight * (curve - values)
        return changed

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


def eased(share: Float64) -> Float64:
    """Share of a ramp, 0 to 1, with a slope of 0 at both ends."""
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
        steps = np.round(level - level.max(initial=-120.0) + len(LEVELS) - 1)
        letters = np.clip(steps, 0, len(LEVELS) - 1).astype(int)
        return cls(round(len(samples) / rate, 3), "".join(LEVELS[k] for k in letters))

    def is_same(self, other: "Sound") -> bool:
        """Whether another is the same recording: rounded, resampled or with silence after it."""
        shorter, longer = sorted((self.levels, other.levels), key=len)
        if not shorter or longer[len(shorter) + 1 :].strip(_QUIET):
            return False
        ours, theirs = (
            np.array([LEVELS.index(letter) for letter in levels[: len(shorter)]], float)
            for levels in (shorter, longer)
        )
        heard = np.maximum(ours, theirs) > len(_QUIET)
        return bool(np.abs(ours - theirs)[heard].mean() < 1) if heard.any() else True


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
