"""What is said in a recording: words or phones, with or without their times.

Words are pronounced by espeak-ng in the language of one of its voices; phones need nothing.
"""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.acting import Words
from deitalk.errors import ConfigError, DataError, MissingError
from deitalk.phones import PHONES, SILENCE
from deitalk.pipeline.words.espeak import ipa_to_phones, spoken_words
from rig import limits
from rig.errors import quoted, shorten

# Interval tiers of Praat's TextGrid files, in the long and in the short form.

Interval = tuple[float, float, str]
"""Start and end in seconds, and the label."""
_TOKEN = re.compile(r'"((?:[^"]|"")*)"|\[\d+\]|(?<![\w.])(-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)(?!\w)')
"""A quoted text, a number in brackets (which is no value), or a number: both forms have the same
values in the same order."""


def intervals_of(text: str, path: object) -> dict[str, list[Interval]]:
    """Interval tiers of a TextGrid by name, in the order of the text; `path` is for messages.

    Raises
    ------
    DataError
        If it is no TextGrid with interval tiers.
    """
    found = (match for match in _TOKEN.finditer(text) if not match[0].startswith("["))
    values = [float(m[2]) if m[2] else m[1].replace('""', '"') for m in found]
    tiers: dict[str, list[Interval]] = {}
    for i, value in enumerate(values):
        if value == "IntervalTier" and len(values) > i + 4:
            tiers[str(values[i + 1])] = _intervals(path, values[i + 4 :])
    if not tiers:
        raise DataError(f"{path}: no interval tier; save a TextGrid of Praat with one")
    return tiers


def _intervals(path: object, values: list[float | str]) -> list[Interval]:
    """Intervals of a tier from its number of intervals on."""
    count = values[0]
    if not isinstance(count, float) or not 0 <= count <= (len(values) - 1) // 3:
        raise DataError(f"{path}: a tier has {quoted(count)} intervals, which are not in the file")
    rows: list[Interval] = []
    for k in range(1, 1 + 3 * int(count), 3):
        start, end, label = values[k : k + 3]
        if not isinstance(start, float) or not isinstance(end, float) or isinstance(label, float):
            raise DataError(f"{path}: interval {len(rows) + 1} is no start, end and text")
        rows.append((start, end, label))
    return rows


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
    def of(cls, given: str | Path | Words, language: str = LANGUAGE) -> "Transcript":
        """Words or phones of a text or a file, see `deitalk.acting.Words`.

        Parameters
        ----------
        given : str, Path or Words
            Phones are ARPABET in capitals, whose words ``|`` divides, or IPA with spaces between
            words; espeak-ng is not needed for them.
        language : str
            Voice of espeak-ng that pronounces words: ``en-us``, ``de``, ``cmn`` …

        Raises
        ------
        DataError
            If there is no word, or the file is not as described.
        MissingError
            If words need espeak-ng and it is not installed.
        ConfigError
            If the language is unknown.
        """
        words = Words.of(given)
        if not words.are_phones:
            check_language(language)
        pronounce, phones_of = (
            (_written, _symbols) if words.are_phones else (_pronounced, _phones_of)
        )
        source = words.source or shorten(words.text, 60)
        if words.kind == "text":
            return cls(_checked(pronounce(_checked_text(words.text), language), source), source)
        rows = _rows(words, source)
        timed = [Word(label, phones_of(label, language), *times) for *times, label in rows]
        return cls(_checked(timed, source), source)


def check_language(language: str) -> None:
    """Refuse a language that espeak-ng has no voice for; MissingError without espeak-ng."""
    from deitalk.pipeline.words import espeak

    if (reason := espeak.missing()) is not None:
        raise MissingError(f"words need espeak-ng for their sounds; {reason}, or give phones")
    if not isinstance(language, str) or not espeak.has_voice(language):
        raise ConfigError(
            f"language {quoted(language)} is no voice of espeak-ng; en-us, en-gb, de, fr, es and "
            "cmn are"
        )


def _checked_text(text: str) -> str:
    if any(0xD800 <= ord(c) < 0xE000 or c == "\0" for c in text):
        raise DataError(f"words {quoted(text)} hold bytes that are no text; write them in UTF-8")
    return text


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
    from deitalk.pipeline.words import espeak

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
    from deitalk.pipeline.words import espeak

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


def _rows(words: Words, source: str) -> list[Interval]:
    """Timed words or phones of a table or a TextGrid, without silences."""
    kind = "phone" if words.are_phones else "word"
    read = _tier if words.kind == "grid" else _table
    rows = [row for row in read(words.text, source, kind) if row[2].strip().lower() not in _SILENT]
    ends = [0.0, *(end for _, end, _ in rows)]
    for number, (before, (start, end, label)) in enumerate(zip(ends, rows, strict=False), 1):
        if not 0 <= start < end <= limits.SECONDS or start < before - 0.02:
            raise DataError(
                f"{source}, {kind} {number} {quoted(label)}: {start:g} to {end:g} s; times must "
                "rise"
            )
    return rows


def _tier(text: str, source: str, kind: str) -> Sequence[Interval]:
    tiers = intervals_of(text, source)
    named = [name for name in tiers if kind in name.lower()]
    if not named and len(tiers) > 1:
        known = ", ".join(map(quoted, tiers))
        raise DataError(f"{source}: no tier is named {kind}s; its tiers are {known}: rename one")
    return tiers[named[0] if named else next(iter(tiers))]


def _table(text: str, source: str, kind: str) -> list[Interval]:
    first = text.partition("\n")[0]
    separator = max(",;\t", key=first.count)
    lines = list(csv.reader(text.splitlines(), delimiter=separator)) or [[]]
    header = [name.strip().lower() for name in lines[0]]
    label = next((name for name in _COLUMNS[kind] if name in header), None)
    if label is None or not {"start", "end"} <= set(header):
        raise DataError(f"{source}: the first row must name the columns start, end, {kind}")
    places = [header.index(name) for name in ("start", "end", label)]
    return [_row(source, n, line, places) for n, line in enumerate(lines[1:], 2) if any(line)]


def _row(path: str, number: int, line: list[str], places: list[int]) -> Interval:
    try:
        start, end, label = (line[place] for place in places)
        times = float(start.replace(",", ".")), float(end.replace(",", "."))
    except (ValueError, IndexError):
        raise DataError(f"{path}, row {number}: no start and end in seconds and a label") from None
    if not np.isfinite(times).all():
        raise DataError(f"{path}, row {number}: start and end must be finite numbers")
    return (*times, label.strip())
