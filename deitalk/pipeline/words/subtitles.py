"""Lines that somebody speaks: of a text, or of SubRip and WebVTT subtitles with their times."""

import re
from dataclasses import dataclass, replace

from deitalk.acting_fields import Words
from deitalk.errors import DataError
from deitalk.pipeline.words.pronounced import Word, checked_text, pronounced
from rig.errors import quoted

_BRACKETS = re.compile(r"\[[^]]*\]|\([^)]*\)")
"""What is not spoken in subtitles: ``[MUSIC]``, ``(laughs)``."""
CUE_SECONDS = 0.5
"""Time by which a word may lie outside its subtitle, beside the slack of timed words."""
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
        found = pronounced(checked_text(text), language)
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
        known = ", ".join(speakers) or "none, which lines begin with: `ANNA: …` or `<v Anna>`"
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
