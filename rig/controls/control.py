"""One control of a face, and tables of them as CSV."""

import csv
import itertools
from collections.abc import Iterable
from dataclasses import dataclass

from rig.errors import ControlError
from rig.limits import CONTROLS

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
            fields[field] = _number(row[column], f"control {row['name']!r}, column {column}")
    for column, field in LISTS.items():
        fields[field] = tuple(filter(None, row.get(column, "").split("|")))
    fields["sets"] = frozenset(name for name in SETS if row.get(name) == "1")
    return Control(name=row["name"].strip(), **fields)  # type: ignore[arg-type]


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ControlError(f"{where}: {text!r} is not a number") from None


def _spellings(name: str) -> tuple[str, ...]:
    """Return ``X.ty`` and its spellings in Unreal and Maya."""
    if name in ("", NEWER_ONLY):
        return ()
    stem, dot, axis = name.rpartition(".t")
    if not dot or axis not in ("x", "y"):
        return (name,)
    upper = axis.upper()
    return (name, f"{stem}.{upper}", f"{stem}-translate{upper}", f"{stem}.translate{upper}")
