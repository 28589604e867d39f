"""The controls of a face: names, ranges, rest values, sides, regions, mirrors, spellings.

The default set is the MetaHuman face board of generation mh4 (MetaHuman Creator 2.x, Unreal 5.2 and
later) as 185 scalar channels, one row each in ``controls.csv``. Names, ranges and rest values are
facts of the board, cross-checked between Epic's MetaHuman-DNA-Calibration scripts and the channel
lists that Unreal itself shows.

Paper silent: DEITalk counts 185 controls, of which 86 lip and 18 upper face (§3.5), and prints none
of the names. The 185 here are the 182 scalar channels of the Unreal board plus the three neck
corrective multipliers of its Maya ancestor. The lip and upper-face sets are **our choice**: the 90
mouth channels common to all board generations, less the four for cheeks and puffing, are 86; the
eight brow channels with blink, lid press, inner squint, cheek raise and scrunch of both sides are
18. ``lip_no_sticky`` and ``upper_face_gaze`` are alternatives of the same sizes.
"""

import csv
import difflib
import io
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32
from rig.errors import ControlError, quoted
from rig.files.reading import read_text
from rig.limits import CONTROL_SET_BYTES, CONTROLS

SETS = ("lip", "upper_face", "lip_no_sticky", "upper_face_gaze")
"""Named sets that are columns of the table."""
NEWER_ONLY = "-"
"""`mh3_name` of a control that the older board did not have."""
NUMBERS = {"min": "minimum", "max": "maximum", "rest": "rest", "mirror_sign": "mirror_sign"}
TEXTS = (
    "ue_control", "ue_channel", "type", "axis", "side", "region", "role", "mirror", "mh3_name",
    "emoface_name",
)  # fmt: skip
LISTS = {"raw_pos": "raw_positive", "raw_neg": "raw_negative", "aliases": "aliases"}


@dataclass(frozen=True)
class Control:
    """One scalar channel of a face: a row of the table.

    Parameters
    ----------
    name : str
        Canonical spelling, ``CTRL_C_jaw.ty``.
    minimum, maximum, rest : float
        Range and the value at rest, no unit.
    ue_control, ue_channel : str
        The control in Unreal, and its channel (``CTRL_C_jaw``, ``CTRL_C_jaw.Y``).
    type : str
        ``float`` or ``Vector2D``: the setter to use in Unreal.
    axis : str
        ``X`` or ``Y``.
    side, region, role : str
        ``L``, ``R`` or ``C``; ``mouth``, ``jaw`` …; ``driver`` (moves raw curves), ``master`` (both
        eyes), ``unmapped`` (exists, moves nothing), ``switch`` or ``multiplier``.
    sets : frozenset of str
        The named sets this control is in.
    mirror : str
        The control of the other side (itself in the middle); empty means itself.
    mirror_sign : float
        -1 where mirroring changes the sign.
    raw_positive, raw_negative : tuple of str
        Raw ``CTRL_expressions`` curves driven by the positive and the negative half.
    mh3_name : str
        Name on the mh3 board (2021 to 2023): empty if it is the same, ``-`` if it had none.
    emoface_name : str
        Spelling in EmoFace's 174 columns, empty if it has none.
    aliases : tuple of str
        Further spellings.
    """

    name: str
    minimum: float = 0.0
    maximum: float = 1.0
    rest: float = 0.0
    ue_control: str = ""
    ue_channel: str = ""
    type: str = "float"
    axis: str = "Y"
    side: str = "C"
    region: str = ""
    role: str = "driver"
    sets: frozenset[str] = frozenset()
    mirror: str = ""
    mirror_sign: float = 1.0
    raw_positive: tuple[str, ...] = ()
    raw_negative: tuple[str, ...] = ()
    mh3_name: str = ""
    emoface_name: str = ""
    aliases: tuple[str, ...] = ()

    @property
    def spellings(self) -> tuple[str, ...]:
        """Spellings of this board's name: ours, Unreal's channel, Maya's attribute."""
        unreal = tuple(filter(None, [self.ue_channel]))
        return (*unreal, *self.aliases, *_spellings(self.name))

    @property
    def older_spellings(self) -> tuple[str, ...]:
        """Spellings of the mh3 board's name, and EmoFace's."""
        emoface = tuple(filter(None, [self.emoface_name]))
        return (*emoface, *_spellings(self.mh3_name))


def read_table(lines: Iterable[str]) -> tuple[Control, ...]:
    """Read a CSV with a column ``name`` and any of the columns of ``controls.csv``.

    Raises
    ------
    ControlError
        If a value is no number, or the rows are more than a control set may have.
    """
    rows = list(itertools.islice(csv.DictReader(lines), CONTROLS + 1))
    return tuple(_control_from({k: v or "" for k, v in row.items() if k}) for row in rows)


def _control_from(row: dict[str, str]) -> Control:
    """Read one row of a table; absent columns take the defaults of `Control`."""
    fields: dict[str, object] = {key: row[key] for key in TEXTS if row.get(key)}
    for column, field in NUMBERS.items():
        if row.get(column):
            try:
                fields[field] = float(row[column])
            except ValueError:
                raise ControlError(
                    f"control {row['name']!r}, column {column}: {row[column]!r} is not a number"
                ) from None
    for column, field in LISTS.items():
        fields[field] = tuple(filter(None, row.get(column, "").split("|")))
    fields["sets"] = frozenset(name for name in SETS if row.get(name) == "1")
    return Control(name=row["name"].strip(), **fields)  # type: ignore[arg-type]


def _spellings(name: str) -> tuple[str, ...]:
    """Return ``X.ty`` and its spellings in Unreal and Maya."""
    if name in ("", NEWER_ONLY):
        return ()
    stem, dot, axis = name.rpartition(".t")
    if not dot or axis not in ("x", "y"):
        return (name,)
    upper = axis.upper()
    return (name, f"{stem}.{upper}", f"{stem}-translate{upper}", f"{stem}.translate{upper}")


DEFAULT_ID = "metahuman-185@mh4"
_LONGEST_NAME = 100
SIDES = {"left": "L", "right": "R", "center": "C"}

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class ControlSet:
    """An ordered, versioned list of controls, and look-ups over it.

    Parameters
    ----------
    id : str
        ``name@version``; written into every file.
    controls : tuple of Control
        In column order.

    Raises
    ------
    ControlError
        If names are doubled or empty, a range is empty or not finite, the rest value lies outside
        it, or a mirror is unknown.
    """

    id: str
    controls: tuple[Control, ...]

    def __post_init__(self) -> None:
        if not 0 < len(self.controls) <= CONTROLS:
            raise ControlError(
                f"control set {self.id!r} has {len(self.controls)} controls; "
                f"it needs 1 to {CONTROLS}"
            )
        check_unique(self.names, where=f"control set {self.id!r}")
        known = set(self.names)
        for control in self.controls:
            _check_control(control, known)

    def __len__(self) -> int:
        return len(self.controls)

    def __deepcopy__(self, memo: object) -> Self:
        """Return the set itself: it never changes."""
        return self

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Canonical names, in column order."""
        return tuple(control.name for control in self.controls)

    @cached_property
    def minimum(self) -> Float32:
        """Lower ends of the ranges [shape=(C,)]."""
        return _frozen([control.minimum for control in self.controls])

    @cached_property
    def maximum(self) -> Float32:
        """Upper ends of the ranges [shape=(C,)]."""
        return _frozen([control.maximum for control in self.controls])

    @cached_property
    def rest(self) -> Float32:
        """Values of the face at rest [shape=(C,)]; not all are 0."""
        return _frozen([control.rest for control in self.controls])

    @cached_property
    def mirror_index(self) -> Indices:
        """Index of each control's counterpart on the other side [shape=(C,)]."""
        places = [self._places[control.mirror or control.name] for control in self.controls]
        return _frozen(places, np.intp)

    @cached_property
    def mirror_sign(self) -> Float32:
        """1, or -1 where mirroring changes the sign [shape=(C,)]."""
        return _frozen([control.mirror_sign for control in self.controls])

    @cached_property
    def regions(self) -> tuple[str, ...]:
        """Regions that occur, in order of first appearance."""
        return tuple(dict.fromkeys(c.region for c in self.controls if c.region))

    def index(self, name: str) -> int:
        """Return the column of a control, by any of its spellings."""
        try:
            return self._places[name]
        except KeyError:
            return self._places[self.canonical(name)]

    def __getitem__(self, name: str) -> Control:
        return self.controls[self.index(name)]

    def indices(self, names: Iterable[str]) -> Indices:
        """Return the columns of several controls, by any of their spellings."""
        return np.array([self.index(name) for name in names], dtype=np.intp)

    def __contains__(self, name: object) -> bool:
        """Return whether a name is a spelling of one of the controls."""
        return name in self._aliases or name in self._older_aliases

    def canonical(self, name: str) -> str:
        """Return the canonical name of one spelling; mh4 wins where both boards use a name.

        Raises
        ------
        ControlError
            If the name is unknown; near matches are listed.
        """
        found = self._aliases.get(name) or self._older_aliases.get(name)
        if found is None:
            known = [*self.names, *self._older_aliases]
            is_short = len(name) <= _LONGEST_NAME  # comparing takes the product of the lengths
            near = difflib.get_close_matches(name, known, n=3, cutoff=0.6) if is_short else []
            hint = f"did you mean {', '.join(near)}?" if near else "see `deitalk face controls`"
            raise ControlError(f"unknown control {quoted(name)} in {self.id}; {hint}")
        return found

    def resolve(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return canonical names for a whole header; the board generation is inferred from it.

        ``CTRL_C_tongue_roll.ty`` is a control of both boards and means different things. If any
        other name of the header exists on the older board only, the header is of the older board
        and all its names are read so.

        Raises
        ------
        ControlError
            If a name is unknown, or two names mean one control.
        """
        older = self._older_aliases if self.is_older_board(names) else {}
        resolved = tuple(older.get(name) or self.canonical(name) for name in names)
        check_unique(resolved, where="the header (after older names are resolved)")
        return resolved

    def is_older_board(self, names: Iterable[str]) -> bool:
        """Return whether a header holds a name that only the older board has."""
        return any(n not in self._aliases and n in self._older_aliases for n in names)

    def missing(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the controls of its own board that a header lacks."""
        present = set(self.resolve(names))
        lacking = [control for control in self.controls if control.name not in present]
        if self.is_older_board(names):
            lacking = [control for control in lacking if control.mh3_name != NEWER_ONLY]
        return tuple(control.name for control in lacking)

    def subset(self, name: str) -> Indices:
        """Return the columns of a named set, region, side or role.

        Parameters
        ----------
        name : str
            ``all``; ``lip``, ``upper_face``, ``lip_no_sticky``, ``upper_face_gaze`` (our choice,
            see the module); a region (``mouth``, ``jaw`` …); ``left``, ``right``, ``center``; a
            role (``driver``, ``master`` …).

        Raises
        ------
        ControlError
            If there is no such set; the known ones are listed.
        """
        try:
            return self._subsets[name]
        except KeyError:
            known = ", ".join(self._subsets)
            raise ControlError(f"unknown set of controls {name!r}; known: {known}") from None

    @property
    def subset_names(self) -> tuple[str, ...]:
        """Names that `subset` accepts."""
        return tuple(self._subsets)

    def select(self, indices: Iterable[int], *, id: str) -> "ControlSet":
        """Return a control set of some of the controls; mirrors outside it become themselves."""
        chosen = [self.controls[i] for i in indices]
        kept = {control.name for control in chosen}
        return ControlSet(
            id, tuple(replace(c, mirror=c.mirror if c.mirror in kept else "") for c in chosen)
        )

    @classmethod
    def from_names(cls, names: Sequence[str], *, id: str, minimum: float = 0.0) -> "ControlSet":
        """Make a control set from plain names, all from a minimum of 0 or less to 1, at rest 0."""
        return cls(id, tuple(Control(name, minimum) for name in names))

    @classmethod
    def from_csv(cls, path: Path | str, *, id: str = "") -> "ControlSet":
        """Make a control set from a table, or from the header of a CSV of curves.

        A table has a column ``name`` and any of the columns of ``controls.csv``. Otherwise the
        first line is taken as names of controls, less ``frame`` and ``time``, all in [-1, 1].

        Raises
        ------
        ControlError
            If the file is no table of text, or the set it makes is not valid.
        """
        path = Path(path)
        try:
            text = read_text(path, CONTROL_SET_BYTES, error=ControlError)
            header = [cell.strip() for cell in next(csv.reader(io.StringIO(text)), [])]
            if "name" in header:
                return cls(id or path.stem, read_table(io.StringIO(text)))
        except csv.Error as error:
            raise ControlError(f"cannot read a control set from {path}: {error}") from error
        names = [name for name in header if name not in ("frame", "time")]
        return cls.from_names(names, id=id or path.stem, minimum=-1.0)

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def _aliases(self) -> dict[str, str]:
        """Spellings of this board: name, Unreal channel, Maya channel; the first of a control."""
        pairs = [(spelling, c.name) for c in self.controls for spelling in c.spellings]
        return dict(reversed(pairs)) | {name: name for name in self.names}

    @cached_property
    def _older_aliases(self) -> dict[str, str]:
        """Spellings of the mh3 board and of EmoFace."""
        pairs = [(spelling, c.name) for c in self.controls for spelling in c.older_spellings]
        return dict(reversed(pairs))

    @cached_property
    def _subsets(self) -> dict[str, Indices]:
        members: dict[str, list[int]] = {"all": list(range(len(self)))}
        members |= {name: [] for name in (*SETS, *self.regions, *SIDES)}
        side_names = {letter: name for name, letter in SIDES.items()}
        for i, control in enumerate(self.controls):
            groups = {*control.sets, control.region, side_names.get(control.side, ""), control.role}
            for group in sorted(groups - {""}):
                members.setdefault(group, []).append(i)
        return {name: _frozen(places, np.intp) for name, places in members.items()}


@cache
def default_controls() -> ControlSet:
    """Return the 185 channels of the MetaHuman face board, ``metahuman-185@mh4``."""
    with Path(__file__).with_name("controls.csv").open(encoding="utf-8") as stream:
        return ControlSet(DEFAULT_ID, read_table(stream))


def check_unique(names: Sequence[str], *, where: str) -> None:
    """Raise ControlError if a name is empty or occurs twice."""
    seen: set[str] = set()
    for i, name in enumerate(names):
        if not name:
            raise ControlError(f"{where}: name {i + 1} is empty; every control needs a name")
        if name in seen:
            raise ControlError(f"{where}: control {name!r} occurs twice; keep one")
        seen.add(name)


def _check_control(control: Control, known: set[str]) -> None:
    numbers = (control.minimum, control.maximum, control.rest)
    if not (np.isfinite(numbers).all() and control.minimum < control.maximum):
        raise ControlError(
            f"control {control.name!r}: range {control.minimum} to {control.maximum} must be "
            "finite and not empty"
        )
    if not control.minimum <= control.rest <= control.maximum:
        raise ControlError(
            f"control {control.name!r}: rest {control.rest} lies outside its range "
            f"{control.minimum} to {control.maximum}"
        )
    if control.mirror and control.mirror not in known:
        raise ControlError(
            f"control {control.name!r}: its mirror {control.mirror!r} is not in the set"
        )


def _frozen(values: Sequence[float], dtype: Any = np.float32) -> NDArray[Any]:
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array
