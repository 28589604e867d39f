"""What is said in a recording: words or phones, with or without their times.

==================  =================================================================
``transcript``      text, or the path of a text, a table (start, end, word) or a TextGrid
``phones``          phones as text, or the path of a text, a table (start, end, phone) or a TextGrid
==================  =================================================================

Words are pronounced by espeak-ng in the language of one of its voices; phones need nothing.
"""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.corpus.phone_alphabets import ipa_to_phones, spoken_words
from deitalk.errors import ConfigError, DataError, MissingError
from deitalk.phones import PHONES, SILENCE
from deitalk.pipeline.words.textgrid import Interval, read_textgrid
from rig import limits
from rig.errors import quoted
from rig.files.reading import read_text

SUFFIXES = (".txt", ".csv", ".tsv", ".textgrid")
LANGUAGE = "en-us"
_SILENT = frozenset(("", "sil", "sp", "spn", "pau", "<eps>", "<p:>", "<sil>", "_", "#", "..."))
_COLUMNS = {"word": ("word", "text", "label"), "phone": ("phone", "phoneme", "text", "label")}
_CLAUSE = re.compile(r"[^.!?;:。！？；\n]+[.!?;:。！？；\n]*")


@dataclass(frozen=True)
class Word:
    """A word, or a phone that was given alone.

    Attributes
    ----------
    text : str
        As written.
    phones : tuple of str
        Members of `deitalk.phones.PHONES`.
    start, end : float or None
        Seconds, where they were given.
    """

    text: str
    phones: tuple[str, ...]
    start: float | None = None
    end: float | None = None


@dataclass(frozen=True)
class Transcript:
    """Words in the order in which they are spoken.

    Attributes
    ----------
    words : tuple of Word
        At least one, each with phones.
    source : str
        Name of the file, or the text.
    """

    words: tuple[Word, ...]
    source: str

    @classmethod
    def of(cls, given: "str | Path | Transcript", language: str = LANGUAGE) -> "Transcript":
        """Words of a text or a file.

        Parameters
        ----------
        given : str or Path
            Text, or a ``.txt``, a table ``.csv`` (start, end, word) or a ``.TextGrid``.
        language : str
            Voice of espeak-ng that pronounces them: ``en-us``, ``de``, ``cmn`` …

        Raises
        ------
        DataError
            If there is no word, or the file is not as described.
        MissingError
            If espeak-ng is not installed; `of_phones` does without.
        ConfigError
            If the language is unknown.
        """
        if isinstance(given, Transcript):
            return given
        check_language(language)
        path = _path(given)
        if path is None or path.suffix.lower() == ".txt":
            text, source = _text(given, path)
            return cls(_checked(_pronounced(text, language), source), source)
        rows = _rows(path, "word")
        words = [_timed(row, _phones_of(row[2], language)) for row in rows]
        return cls(_checked(words, path.name), path.name)

    @classmethod
    def of_phones(cls, given: "str | Path | Transcript", language: str = LANGUAGE) -> "Transcript":
        """Phones of a text or a file: ARPABET in capitals, or IPA with spaces between words.

        ``|`` divides words of ARPABET. Arguments and errors are those of `of`; espeak-ng is not
        needed.
        """
        if isinstance(given, Transcript):
            return given
        path = _path(given)
        if path is None or path.suffix.lower() == ".txt":
            text, source = _text(given, path)
            return cls(_checked(_written(text, language), source), source)
        words = [_timed(row, _symbols(row[2], language)) for row in _rows(path, "phone")]
        return cls(_checked(words, path.name), path.name)

    @classmethod
    def given(cls, transcript: Any, phones: Any, language: str) -> "Transcript | None":
        """`of` a transcript or `of_phones` of phones, whichever is given; None if none is.

        Raises
        ------
        DataError
            If both are given.
        """
        if transcript is not None and phones is not None:
            raise DataError("transcript and phones are both given; leave one out")
        if phones is not None:
            return cls.of_phones(phones, language)
        return None if transcript is None else cls.of(transcript, language)


def is_words_file(given: str) -> bool:
    """Whether a transcript is the path of a file."""
    return given.strip().lower().endswith(SUFFIXES)


def check_language(language: str) -> None:
    """Refuse a language that espeak-ng has no voice for; MissingError without espeak-ng."""
    from deitalk.corpus.engines import espeak

    if (reason := espeak.missing()) is not None:
        raise MissingError(f"words need espeak-ng for their sounds; {reason}, or give phones")
    if not isinstance(language, str) or not espeak.has_voice(language):
        raise ConfigError(
            f"language {quoted(language)} is no voice of espeak-ng; en-us, en-gb, de, fr, es and "
            "cmn are"
        )


def _path(given: object) -> Path | None:
    """Path of a given file; None of a text."""
    if isinstance(given, Path):
        found = given
    elif isinstance(given, str) and is_words_file(given):
        found = Path(given.strip())
    elif isinstance(given, str):
        return None
    else:
        raise DataError(f"transcript {quoted(given)} must be a text or a path")
    if found.suffix.lower() not in SUFFIXES:
        known = ", ".join(SUFFIXES)
        raise DataError(f"{found}: suffix {quoted(found.suffix)} is none of {known}")
    return found


def _text(given: object, path: Path | None) -> tuple[str, str]:
    """A text, and what it is called."""
    if path is not None:
        return read_text(path, limits.TRANSCRIPT_BYTES, error=DataError), path.name
    text = str(given)
    if any(0xD800 <= ord(c) < 0xE000 or c == "\0" for c in text):
        raise DataError(
            f"transcript {quoted(given)} holds bytes that are no text; write it in UTF-8"
        )
    if len(text) > limits.TRANSCRIPT_BYTES:
        raise DataError(f"the transcript has more than {limits.TRANSCRIPT_BYTES} characters")
    return text, text if len(text) <= 60 else text[:59] + "…"


def _checked(words: Iterable[Word], source: str) -> tuple[Word, ...]:
    """Words that have phones."""
    found = tuple(word for word in words if word.phones)
    if not found:
        raise DataError(f"transcript {quoted(source)} has no word that is pronounced; write some")
    if len(found) > limits.TRANSCRIPT_WORDS:
        raise DataError(
            f"transcript {quoted(source)} has {len(found):,} words; at most "
            f"{limits.TRANSCRIPT_WORDS:,} are read: cut the recording"
        )
    return found


# --- words


def _pronounced(text: str, language: str) -> list[Word]:
    """Words of a text with their phones, clause by clause."""
    from deitalk.corpus.engines import espeak

    words: list[Word] = []
    for clause in _CLAUSE.findall(text):
        written = [w for w in clause.split() if any(c.isalnum() for c in w)]
        if not written:
            continue
        spoken = spoken_words(espeak.pronounce(clause, voice=language), language)
        if len(spoken) != len(written):  # espeak-ng joins small words, and divides numbers
            parts = [(w, phones) for w in written for phones in _spoken(w, language)]
        else:
            parts = list(zip(written, spoken, strict=True))
        words += [Word(word.strip(",.!?;:\"'()…«»"), phones) for word, phones in parts]
    return words


def _spoken(word: str, language: str) -> list[tuple[str, ...]]:
    from deitalk.corpus.engines import espeak

    return spoken_words(espeak.pronounce(word, voice=language), language)


def _phones_of(text: str, language: str) -> tuple[str, ...]:
    """Phones of one or more words together."""
    return tuple(phone for phones in _spoken(text, language) for phone in phones)


# --- phones


def _written(text: str, language: str) -> list[Word]:
    """Words of phones."""
    tokens = text.split()
    if all(_arpabet(token) or token == "|" for token in tokens):
        groups = [" ".join(tokens).split("|")] if "|" in tokens else [[" ".join(tokens)]]
        return [Word(g.strip(), _symbols(g, language)) for group in groups for g in group]
    return [Word(token, _symbols(token, language)) for token in tokens]


def _symbols(text: str, language: str) -> tuple[str, ...]:
    """Phones of ARPABET or IPA symbols; silence is left out.

    Raises
    ------
    DataError
        If nothing of it is a phone.
    """
    tokens = text.split()
    if all(_arpabet(token) for token in tokens):
        return tuple(p for p in (_arpabet(token) for token in tokens) if p and p != SILENCE)
    found = ipa_to_phones(text, language.split("-")[0])
    if not found:
        raise DataError(f"phones {quoted(text)} are neither ARPABET nor IPA: P L IY Z or pliːz")
    return found


def _arpabet(token: str) -> str | None:
    """Phone of an ARPABET name with or without stress; None if it is none."""
    name = token.rstrip("012")
    return name if name in PHONES else None


# --- tables and TextGrids


def _rows(path: Path, kind: str) -> list[Interval]:
    """Timed words or phones of a file, without silences."""
    rows = _tier(path, kind) if path.suffix.lower() == ".textgrid" else _table(path, kind)
    rows = [row for row in rows if row[2].strip().lower() not in _SILENT]
    ends = [0.0, *(end for _, end, _ in rows)]
    for number, (before, (start, end, label)) in enumerate(zip(ends, rows, strict=False), 1):
        if not 0 <= start < end <= limits.SECONDS or start < before - 0.02:
            raise DataError(
                f"{path}, {kind} {number} {quoted(label)}: {start:g} to {end:g} s; times must rise"
            )
    return rows


def _tier(path: Path, kind: str) -> Sequence[Interval]:
    tiers = read_textgrid(path)
    named = [name for name in tiers if kind in name.lower()]
    if not named and len(tiers) > 1:
        known = ", ".join(map(quoted, tiers))
        raise DataError(f"{path}: no tier is named {kind}s; its tiers are {known}: rename one")
    return tiers[named[0] if named else next(iter(tiers))]


def _table(path: Path, kind: str) -> list[Interval]:
    text = read_text(path, limits.TRANSCRIPT_BYTES, error=DataError)
    first = text.partition("\n")[0]
    separator = max(",;\t", key=first.count)
    lines = list(csv.reader(text.splitlines(), delimiter=separator))
    header = [name.strip().lower() for name in lines[0]]
    label = next((name for name in _COLUMNS[kind] if name in header), None)
    if label is None or not {"start", "end"} <= set(header):
        raise DataError(f"{path}: the first row must name the columns start, end, {kind}")
    places = [header.index(name) for name in ("start", "end", label)]
    return [_row(path, n, line, places) for n, line in enumerate(lines[1:], 2) if any(line)]


def _row(path: Path, number: int, line: list[str], places: list[int]) -> Interval:
    try:
        start, end, label = (line[place] for place in places)
        times = float(start.replace(",", ".")), float(end.replace(",", "."))
    except (ValueError, IndexError):
        raise DataError(f"{path}, row {number}: no start and end in seconds and a label") from None
    if not np.isfinite(times).all():
        raise DataError(f"{path}, row {number}: start and end must be finite numbers")
    return (*times, label.strip())


def _timed(row: Interval, phones: tuple[str, ...]) -> Word:
    return Word(row[2], phones, row[0], row[1])
