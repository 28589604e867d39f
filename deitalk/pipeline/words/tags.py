"""Tags of scripts, by the table ``tags.csv``, and the parts of a line that they stand in."""

from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

from rig.files.reading import rows_of

Kind = Literal["emotion", "voice", "accent", "sound", "pause", "other"]
UNKNOWN = "unknown"
"""Value of a tag of which nothing is known."""


class Piece(NamedTuple):
    """A part of a line of SSML: text, or a mark that begins, ends, or stands there."""

    do: Literal["text", "begin", "end", "at"]
    text: str = ""
    kind: Kind = "other"
    value: str = ""


@cache
def known_tags() -> dict[str, tuple[Kind, str]]:
    """Kind and value of each tag."""
    rows = rows_of(Path(__file__).with_name("tags.csv"))
    return {row["tag"]: (row["kind"], row["value"]) for row in rows}  # type: ignore[misc]


def tag_of(name: str, written: str) -> Piece:
    """The mark of a tag, a closing one such as ``[/whispers]`` too."""
    if name.startswith("/") and name[1:].strip() in known_tags():
        return Piece("end", name, known_tags()[name[1:].strip()][0])
    for form in (name, name.removesuffix(" tone"), name.removesuffix(" voice")):
        if form in known_tags():
            kind, value = known_tags()[form]
            return Piece("at", form, kind, value)
    return unknown_tag(written)


def unknown_tag(text: str) -> Piece:
    """A tag of which nothing is known."""
    return Piece("at", text, "other", UNKNOWN)
