"""Words with their phones, pronounced by espeak-ng in the language of one of its voices."""

import re
from dataclasses import dataclass

from deitalk.errors import ConfigError, DataError, MissingError
from deitalk.pipeline.words.alphabets import spoken_words
from deitalk.pipeline.words.espeak import has_voice, missing, pronounce
from rig.errors import quoted

LANGUAGE = "en-us"
_CLAUSE = re.compile(r"[^.!?;:。！？；\n]+[.!?;:。！？；\n]*")


@dataclass(frozen=True)
class Word:
    """A word.

    Attributes
    ----------
    text : str
        As written.
    phones : tuple of str
        Members of `deitalk.postprocess.phones.PHONES`.
    start, end : float or None
        Seconds, where they were given.
    """

    text: str
    phones: tuple[str, ...]
    start: float | None = None
    end: float | None = None


def check_language(language: str) -> None:
    """Refuse a language that espeak-ng has no voice for; MissingError without espeak-ng."""
    if (reason := missing()) is not None:
        raise MissingError(f"words need espeak-ng for their sounds; {reason}")
    if not isinstance(language, str) or not has_voice(language):
        raise ConfigError(
            f"language {quoted(language)} is no voice of espeak-ng; en-us, en-gb, de, fr, es and "
            "cmn are"
        )


def checked_text(text: str) -> str:
    """The text; DataError if it holds bytes that are none."""
    if any(0xD800 <= ord(c) < 0xE000 or c == "\0" for c in text):
        raise DataError(f"words {quoted(text)} hold bytes that are no text; write them in UTF-8")
    return text


def bare(word: str) -> str:
    """A word as written, without the marks around it."""
    return word.strip(",.!?;:\"'()…«»")


def pronounced(text: str, language: str) -> list[Word]:
    """Words of a text with their phones, clause by clause."""
    words: list[Word] = []
    for clause in _CLAUSE.findall(text):
        written = [w for w in clause.split() if any(c.isalnum() for c in w)]
        if not written:
            continue
        spoken = spoken_words(pronounce(clause, voice=language), language)
        if len(spoken) != len(written):  # espeak-ng joins small words, and divides numbers
            parts = [(w, phones) for w in written for phones in _spoken(w, language)]
        else:
            parts = list(zip(written, spoken, strict=True))
        words += [Word(bare(word), phones) for word, phones in parts]
    return words


def _spoken(word: str, language: str) -> list[tuple[str, ...]]:
    return spoken_words(pronounce(word, voice=language), language)


def phones_of(text: str, language: str) -> tuple[str, ...]:
    """Phones of one or more words together."""
    return tuple(phone for phones in _spoken(text, language) for phone in phones)
