"""Errors a user can cause, one line each: the value, the rule, the way out.

::

    ValueError
    └── UserError             anything the caller can correct
        └── RigError          anything about controls, curves, meshes, files
            ├── ControlError  an unknown, missing or doubled control
            ├── CurveError    values, shapes or times that make no curves
            ├── FormatError   a file whose content does not match its name
            ├── TargetError   a path that must not or cannot be written to
            │   └── ExistsError   one that exists and is not to be replaced
            └── MeshError     vertices, triangles or shapes that make no mesh
                └── TopologyError  triangles with wrong vertices, meshes that do not match
"""

import errno
import unicodedata
from typing import Any

from rig.limits import MESSAGE_CHARACTERS, QUOTED_CHARACTERS

_UNSAFE = ("Cc", "Zl", "Zp")
"""Unicode categories that would break a line or command a terminal."""


def decodable(text: str) -> str:
    r"""Return a text that can be written as UTF-8.

    Parameters
    ----------
    text : str
        For example a file name that is no UTF-8, which Python keeps in lone surrogates.

    Returns
    -------
    str
        The bytes that are no UTF-8 written as ``\xff``, all else as it was.
    """
    if text.isascii():
        return text
    try:
        raw = text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # a surrogate that stands for no byte
        raw = text.encode("utf-8", "backslashreplace")
    return raw.decode("utf-8", "backslashreplace")


def as_line(text: str) -> str:
    r"""Return a text as one line: `decodable`, line ends and control characters as ``\n``."""
    text = decodable(text)
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        character.encode("unicode_escape").decode("ascii")
        if unicodedata.category(character) in _UNSAFE
        else character
        for character in text
    )


def decodable_values(value: Any) -> Any:
    """Return what JSON can hold with every text in it `decodable`, keys too."""
    if isinstance(value, str):
        return decodable(value)
    if isinstance(value, dict):
        return {decodable_values(key): decodable_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [decodable_values(item) for item in value]
    return value


def shorten(text: str, most: int) -> str:
    """Return a text of at most `most` characters: a longer one loses its middle.

    Parameters
    ----------
    text : str
        Any length.
    most : int
        At least 3.
    """
    if len(text) <= most:
        return text
    tail = most // 3
    return f"{text[: most - tail - 1]}…{text[len(text) - tail :]}"


def quoted(value: object, most: int = QUOTED_CHARACTERS) -> str:
    """Return a value as Python writes it, shortened: for messages that quote a user's input."""
    if isinstance(value, str | bytes):
        value = value[: most + 1]
    return shorten(repr(value), most)


def listed(names: Any, most: int = 3) -> str:
    """The first few of a sequence of names or numbers: "3, 14, 15 and 90 more"."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(str, names[:most])) + more


def one_line(message: object) -> str:
    """Return a message of one line and at most `MESSAGE_CHARACTERS` characters.

    Line ends, control characters and bytes that are no text are written as escapes, so that any
    terminal can print the message (`as_line`).
    """
    line = as_line(shorten(str(message), MESSAGE_CHARACTERS))  # escapes make it longer
    return shorten(line, MESSAGE_CHARACTERS)


class UserError(ValueError):
    """An error that the caller can correct; the message says how, in one line.

    Parameters
    ----------
    message : object
        The value, the rule and the way out.
    parameter : str
        Parameter that the message names in backticks as the way out (``set `force=True` ``);
        a command line names its option instead.
    """

    def __init__(self, message: object = "", *, parameter: str = "") -> None:
        super().__init__(one_line(message))
        self.parameter = parameter


class RigError(UserError):
    """An error about a face: its controls, curves, meshes or files."""


class ControlError(RigError):
    """A control name that is unknown, missing or doubled."""


class CurveError(RigError):
    """Values, shapes or times that do not make curves."""


class FormatError(RigError):
    """A file whose content does not match its name."""


class TargetError(RigError):
    """A path that must not or cannot be written to."""


class ExistsError(TargetError):
    """A path that exists and is not to be replaced."""


class MeshError(RigError):
    """Vertices, triangles or shapes that make no mesh."""


class TopologyError(MeshError):
    """Triangles that name wrong vertices, or meshes that do not share their triangles."""


def is_disk_full(error: BaseException | None) -> bool:
    """Whether an error, or one that it came from, is that of a full disk."""
    while error is not None:
        code = getattr(error, "errno", None)
        # numpy's `tofile` has no number for bytes that the disk did not take.
        if code in (errno.ENOSPC, errno.EDQUOT) or (
            isinstance(error, OSError) and code is None and "requested and" in str(error)
        ):
            return True
        error = error.__cause__ or error.__context__
    return False
