"""Actor, emotion and style of takes: from a table, options, a pattern or names of folders.

The first that gives a label counts, in this order: a row of the table, an option, a named group
of the pattern, and for the emotion a folder or a part of the file's name that is one.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from deitalk.data.captures.sources import Source
from deitalk.data.clips import SPLITS
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from rig.errors import quoted
from rig.files.text_rows import read_rows
from rig.limits import TRACK_BYTES

GROUPS = ("actor", "emotion", "style")
COLUMNS = (*GROUPS, "voice", "split")
"""Columns of a table of takes, beside the take."""
UNNAMED = "actor"
"""Actor of takes that no label names."""
SPELLINGS = {
    "anger": "angry", "mad": "angry", "ang": "angry", "furious": "angry",
    "happiness": "happy", "joy": "happy", "joyful": "happy", "hap": "happy",
    "sadness": "sad", "sorrow": "sad",
    "surprise": "surprised", "sur": "surprised", "suprised": "surprised",
    "neutral": "neutral", "neu": "neutral", "calm": "neutral",
}  # fmt: skip
"""Other spellings of the five emotions."""


@dataclass(frozen=True)
class Labels:
    """Labels of one take."""

    actor: str
    emotion: str
    style: str = ""
    split: str = ""
    """Split that the table gives; empty: chosen by `deitalk.data.captures.splits`."""
    voice: str = ""
    is_actor_given: bool = True
    is_emotion_given: bool = True
    named: tuple[str, ...] = ()
    """Emotions of the take's name, where these are several, the one that is taken first."""


@dataclass(frozen=True)
class Labelling:
    """Sources of labels.

    Parameters
    ----------
    actor, emotion, style : str or None
        The same for all takes.
    pattern : str or None
        Regular expression with a group ``(?P<actor>…)``, ``(?P<emotion>…)`` or ``(?P<style>…)``,
        searched in a take's path without suffix.
    table : Path or None
        CSV with a column ``take`` (name, in the dataset or of the file, or path of the take) and
        any of actor, emotion, style, voice, split.
    """

    actor: str | None = None
    emotion: str | None = None
    style: str | None = None
    pattern: str | None = None
    table: Path | None = None
    _rows: dict[str, dict[str, str]] = field(default_factory=dict, init=False, repr=False)
    _used: set[str] = field(default_factory=set, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.emotion is not None:
            emotion_of(self.emotion, "`emotion`", parameter="emotion")
        if self.pattern is not None:
            _check_pattern(self.pattern)
        if self.table is not None:
            self._rows.update(_read_table(self.table))

    def of(self, source: Source, name: str = "") -> Labels:
        """Labels of a take; `name` is the one that it has in the dataset.

        Raises
        ------
        DataError
            If an emotion or split is unknown, or the pattern is not found in the take's path.
        """
        row = self._row(source, name)
        groups: dict[str, str | None] = {}
        if self.pattern is not None:
            match = re.search(self.pattern, source.place)
            if match is None:
                place = quoted(source.place)
                raise DataError(
                    f"{source.curves}: `pattern={self.pattern}` is not found in {place}",
                    parameter="pattern",
                )
            groups = match.groupdict()
        found = {
            name: row.get(name) or getattr(self, name) or groups.get(name) or "" for name in GROUPS
        }
        where = str(source.curves)
        emotion = emotion_of(found["emotion"], where) if found["emotion"] else ""
        several: tuple[str, ...] = ()
        if not emotion:  # the last part of the path that names one
            for part in reversed(source.place.lower().split("/")):
                words = [SPELLINGS.get(word, word) for word in re.split(r"[^a-z]+", part)]
                several = tuple(dict.fromkeys(w for w in reversed(words) if w in EMOTIONS))
                if several:
                    emotion = several[0]
                    break
        split = row.get("split", "")
        if split and split not in SPLITS:
            raise DataError(f"{where}: split {quoted(split)} must be {', '.join(SPLITS)}")
        actor = found["actor"].strip()
        return Labels(
            actor or UNNAMED,
            emotion or "neutral",
            found["style"].strip(),
            split,
            emotion_of(row["voice"], where) if row.get("voice") else "",
            is_actor_given=bool(actor),
            is_emotion_given=bool(emotion),
            named=several if len(several) > 1 else (),
        )

    def check_rows(self, names: Sequence[str]) -> None:
        """Refuse a table with a row of none of the takes that were labelled."""
        unknown = [row["take"] for take, row in self._rows.items() if take not in self._used]
        if unknown:
            raise DataError(
                f"{self.table}: take {quoted(unknown[0])} is not among the takes "
                f"{', '.join(names[:6])}{' …' if len(names) > 6 else ''}; mend or remove the row"
            )

    def _row(self, source: Source, name: str) -> dict[str, str]:
        if self.table is None:
            return {}
        given = (name, source.place, source.curves.name, source.curves.stem, source.stem)
        for key in map(str.lower, given):
            if key in self._rows:
                self._used.add(key)
                return self._rows[key]
        raise DataError(f"{self.table}: has no row of take {quoted(source.stem)}; add one")


def emotion_of(text: str, where: str, *, parameter: str = "") -> str:
    """Return one of the five emotions for a name of one, in any of the known spellings."""
    name = text.strip().lower()
    name = SPELLINGS.get(name, name)
    if name not in EMOTIONS:
        raise DataError(
            f"{where}: emotion {quoted(text)} is unknown; known are {', '.join(EMOTIONS)}",
            parameter=parameter,
        )
    return name


def _check_pattern(pattern: str) -> None:
    try:
        groups = re.compile(pattern).groupindex
    except re.error as error:
        raise DataError(
            f"`pattern={pattern}` is no regular expression: {error}", parameter="pattern"
        ) from None
    unknown = set(groups) - set(GROUPS)
    if unknown or not groups:
        raise DataError(
            f"`pattern={pattern}` needs a group (?P<actor>…), (?P<emotion>…) or (?P<style>…) and "
            "no other named one",
            parameter="pattern",
        )


def _read_table(path: Path) -> dict[str, dict[str, str]]:
    """Rows by the names of their takes, in lower case."""
    _, rows = read_rows(
        path, TRACK_BYTES, error=DataError, needed=("take",), once=COLUMNS, lower=True
    )
    found: dict[str, dict[str, str]] = {}
    for row in rows:
        if found.setdefault(row["take"].lower(), row) is not row:
            raise DataError(f"{path}: take {row['take']!r} appears twice; names must differ")
    return found
