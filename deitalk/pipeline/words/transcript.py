"""Transcripts of recordings: words with or without their times."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from deitalk.acting_fields import Words
from deitalk.errors import DataError
from deitalk.pipeline.words.pronounced import (
    LANGUAGE,
    Word,
    check_language,
    checked_text,
    phones_of,
    pronounced,
)
from deitalk.pipeline.words.subtitles import cues_of
from deitalk.pipeline.words.textgrid import Interval, intervals_of
from rig import limits
from rig.errors import quoted, shorten

_SILENT = frozenset(("", "sil", "sp", "spn", "pau", "<eps>", "<p:>", "<sil>", "_", "#", "..."))


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
    def of(
        cls, given: str | Path | Words, language: str = LANGUAGE, role: str | None = None
    ) -> "Transcript":
        """Words of a text or a file, see `deitalk.acting_fields.Words`.

        Parameters
        ----------
        given : str, Path or Words
            Text or a path.
        language : str
            Voice of espeak-ng that pronounces words: ``en-us``, ``de``, ``cmn`` …
        role : str, optional
            Speaker of subtitles whose words are read; all by default.

        Raises
        ------
        DataError
            If there is no word, no such speaker, or the file is not as described.
        MissingError
            If espeak-ng is not installed.
        ConfigError
            If the language is unknown.
        """
        words = Words.of(given)
        check_language(language)
        source = words.source or shorten(words.text, 60)
        if words.kind == "grid" and role is not None:
            raise DataError(f"role {quoted(role)} needs lines with speakers; give a .srt or a .vtt")
        if words.kind == "grid":
            rows = _tier(words.text, source)
            found = [Word(label, phones_of(label, language), *times) for *times, label in rows]
        elif words.kind == "ssml":
            raise DataError(f"words {source}: SSML is a script; give it as script")
        elif words.kind == "subtitles" or role is not None:
            cues = cues_of(words, source, role)
            found = [word for cue in cues for word in cue.words(cue.text, language)]
        else:
            found = pronounced(checked_text(words.text), language)
        return cls(_checked(found, source), source)


def spoken_transcript(words: Iterable[Word], source: str) -> Transcript:
    """A transcript of words; DataError if none is pronounced."""
    return Transcript(_checked(words, source), source)


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


def _tier(text: str, source: str) -> list[Interval]:
    """Words of a TextGrid, without silences."""
    tiers = intervals_of(text, source)
    named = [name for name in tiers if "word" in name.lower()]
    if not named and len(tiers) > 1:
        known = ", ".join(map(quoted, tiers))
        raise DataError(f"{source}: no tier is named words; its tiers are {known}: rename one")
    tier = tiers[named[0] if named else next(iter(tiers))]
    rows = [row for row in tier if row[2].strip().lower() not in _SILENT]
    ends = [0.0, *(end for _, end, _ in rows)]
    for number, (before, (start, end, label)) in enumerate(zip(ends, rows, strict=False), 1):
        if not 0 <= start < end <= limits.SECONDS or start < before - 0.02:
            raise DataError(
                f"{source}, word {number} {quoted(label)}: {start:g} to {end:g} s; times must rise"
            )
    return rows
