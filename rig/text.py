"""Names and values of any kind as text that every terminal, file and JSON reader takes."""

import unicodedata
from typing import Any

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
