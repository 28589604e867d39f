"""Transcripts of recordings: words with or without their times.

Words are pronounced by espeak-ng in the language of one of its voices.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from deitalk.acting_fields import Words
from deitalk.errors import ConfigError, DataError, MissingError
from deitalk.pipeline.words.alphabets import spoken_words
from deitalk.pipeline.words.espeak import has_voice, missing, pronounce
from deitalk.pipeline.words.textgrid import Interval, intervals_of
from rig import limits
from rig.errors import quoted, shorten

LANGUAGE = "en-us"
_SILENT = frozenset(("", "sil", "sp", "spn", "pau", "<eps>", "<p:>", "<sil>", "_", "#", "..."))
_BRACKETS = re.compile(r"\[[^]]*\]|\([^)]*\)")
"""What is not spoken in subtitles: ``[MUSIC]``, ``(laughs)``."""
CUE_SECONDS = 0.5
"""By which a word may lie outside the times of its subtitle, beside the slack of timed words."""
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
            found = [Word(label, _phones_of(label, language), *times) for *times, label in rows]
        elif words.kind == "ssml":
            raise DataError(f"words {source}: SSML is a script; give it as script")
        elif words.kind == "subtitles" or role is not None:
            cues = cues_of(words, source, role)
            found = [word for cue in cues for word in cue.words(cue.text, language)]
        else:
            found = _pronounced(_checked_text(words.text), language)
        return cls(_checked(found, source), source)


def spoken_transcript(words: Iterable[Word], source: str) -> Transcript:
    """A transcript of words; DataError if none is pronounced."""
    return Transcript(_checked(words, source), source)


def check_language(language: str) -> None:
    """Refuse a language that espeak-ng has no voice for; MissingError without espeak-ng."""
    if (reason := missing()) is not None:
        raise MissingError(f"words need espeak-ng for their sounds; {reason}")
    if not isinstance(language, str) or not has_voice(language):
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


def bare(word: str) -> str:
    """A word as written, without the marks around it."""
    return word.strip(",.!?;:\"'()…«»")


def _pronounced(text: str, language: str) -> list[Word]:
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


def _phones_of(text: str, language: str) -> tuple[str, ...]:
    """Phones of one or more words together."""
    return tuple(phone for phones in _spoken(text, language) for phone in phones)


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


_SPEAKER = re.compile(r"\s*([A-Z][A-Z0-9 .'&_-]{0,30}):\s+")
"""A speaker before a line: ``ANNA: …``."""
_VOICE = re.compile(r"<v(?:\.[^\s>]*)?\s+([^>]{1,100})>")
_MARK = "\u2063"
"""Invisible letter around the name of a voice, which the reader of subtitles keeps."""


@dataclass(frozen=True)
class Cue:
    """A line that somebody speaks.

    Attributes
    ----------
    text : str
        As written, without the speaker.
    start, end : float or None
        Seconds, of subtitles.
    speaker : str
        Empty where none is named.
    """

    text: str = ""
    start: float | None = None
    end: float | None = None
    speaker: str = ""

    def words(self, text: str, language: str) -> list[Word]:
        """Words of a text of it, within its times."""
        found = _pronounced(_checked_text(text), language)
        if self.start is None or self.end is None:
            return found
        times = self.start - CUE_SECONDS, self.end + CUE_SECONDS
        return [Word(word.text, word.phones, *times) for word in found]


def cues_of(
    words: Words, source: str, role: str | None = None, *, brackets: bool = False
) -> list[Cue]:
    """Lines of a text or of subtitles, those of one speaker if a role is given.

    Parameters
    ----------
    words : Words
        A text or subtitles.
    source : str
        Its name, for messages.
    role : str, optional
        A speaker, in any case of letters.
    brackets : bool
        Keep what stands in brackets, which is not spoken.

    Raises
    ------
    DataError
        If there is no subtitle, or none of the role.
    """
    if words.kind == "subtitles":
        found = _subtitles(words.text, source)
    elif role is not None:
        raise DataError(f"role {quoted(role)} needs lines with times; give a .srt or a .vtt")
    else:
        found = [_spoken_by(line, None, None) for line in words.text.splitlines() if line.strip()]
    if not brackets:
        found = [replace(cue, text=_BRACKETS.sub(" ", cue.text)) for cue in found]
    return found if role is None else [cue for cue in found if _is(cue, role, found, source)]


def other_spans(words: Words, source: str, role: str) -> list[tuple[float, float]]:
    """Spans, seconds, in which others speak and the role does not."""
    found = cues_of(words, source)
    spans = []
    own = [(c.start, c.end) for c in found if c.speaker.casefold() == role.casefold()]
    for cue in found:
        if not cue.speaker or cue.speaker.casefold() == role.casefold():
            continue
        pieces = [(cue.start or 0.0, cue.end or 0.0)]
        for begin, end in own:
            pieces = [
                part
                for first, last in pieces
                for part in ((first, min(last, begin or 0.0)), (max(first, end or 0.0), last))
                if part[1] > part[0]
            ]
        spans += pieces
    return spans


def _is(cue: Cue, role: str, cues: list[Cue], source: str) -> bool:
    """Whether a cue is of a role, which one of them must be."""
    speakers = dict.fromkeys(c.speaker for c in cues if c.speaker)
    if role.casefold() not in {speaker.casefold() for speaker in speakers}:
        known = ", ".join(speakers) or "none"
        raise DataError(f"role {quoted(role)} is no speaker of {source}; there are: {known}")
    return cue.speaker.casefold() == role.casefold()


def _subtitles(text: str, source: str) -> list[Cue]:
    """Cues of SubRip or WebVTT subtitles in the order of their times."""
    import pysubs2

    plain = re.sub(r"(?m)^(NOTE|STYLE|REGION)\b.*(\n.+)*", "", "\n".join(text.splitlines()))
    form = "vtt" if plain.startswith("WEBVTT") else "srt"
    plain = _VOICE.sub(lambda match: f"{_MARK}{match[1].strip()}{_MARK}", plain)
    events = pysubs2.SSAFile.from_string(plain, format_=form)
    events.sort()
    rows = []
    for event in events:
        before, *voices = event.plaintext.split(_MARK)
        pieces = [("", before), *zip(voices[::2], voices[1::2], strict=False)]
        for speaker, said in pieces:
            if said.strip():
                times = event.start / 1000, event.end / 1000
                lines = said.splitlines() if not speaker else [said]
                rows += _joined_lines([_spoken_by(line, *times, speaker) for line in lines])
    if not rows:
        raise DataError(f"{source}: no subtitle with times such as 00:00:01,000 --> 00:00:02,500")
    return rows


def _spoken_by(text: str, start: float | None, end: float | None, speaker: str = "") -> Cue:
    match = None if speaker else _SPEAKER.match(text)
    if match is None:
        return Cue(text, start, end, speaker)
    return Cue(text[match.end() :], start, end, match[1].strip())


def _joined_lines(cues: list[Cue]) -> list[Cue]:
    """Lines of one subtitle; those without a speaker go on with the line before."""
    found: list[Cue] = []
    for cue in cues:
        if found and not cue.speaker:
            found[-1] = replace(found[-1], text=f"{found[-1].text} {cue.text}")
        else:
            found.append(cue)
    return found
