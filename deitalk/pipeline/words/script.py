"""A script states the words of a recording and how they are spoken; this module reads scripts.

Three notations are read:

- tags in brackets that voices carry, such as ``[angrily]`` or ``[laughs]``, in a text or in
  subtitles; ``*word*`` and words in capitals are stressed;
- SSML: ``emphasis``, ``break``, ``prosody``, ``voice``, and the styles of other vendors;
- SubRip and WebVTT subtitles with their speakers, ``ANNA: …`` or ``<v Anna>``.

What a tag means is in ``tags.csv``: an emotion or a strength of the voice from the next word to the
end of its line, a sound that is no word, a pause, or something that no face shows. Others are
listed, and change nothing.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deitalk.acting_fields import Words
from deitalk.errors import DataError
from deitalk.pipeline.words.marks import Mark, TimedMark, timed_mark
from deitalk.pipeline.words.pronounced import Word, bare, check_language
from deitalk.pipeline.words.ssml import ACCENTS, Line, Ssml
from deitalk.pipeline.words.subtitles import Cue, cues_of
from deitalk.pipeline.words.tags import UNKNOWN, Kind, Piece, tag_of
from deitalk.pipeline.words.transcript import Transcript, spoken_transcript
from rig.errors import listed, quoted

if TYPE_CHECKING:  # needs torch
    from deitalk.pipeline.words.align import WordFit


_TAG = re.compile(r"\[([^\[\]\n]{0,200})\]|\(([^()\n]{0,200})\)|\*([^*\n]{1,200})\*")
_SPOKEN = re.compile(r"\S+")


@dataclass(frozen=True)
class Script:
    """Words and marks of a script.

    Attributes
    ----------
    transcript : Transcript
        Its spoken words.
    marks : tuple of Mark
        In the order of their words.
    unknown : tuple of str
        Tags, elements and attributes of which nothing is known; not used.
    """

    transcript: Transcript
    marks: tuple[Mark, ...]
    unknown: tuple[str, ...]

    @classmethod
    def of(cls, given: "str | Path | Words", language: str, role: str | None = None) -> "Script":
        """Read a script.

        Parameters
        ----------
        given : str, Path or Words
            Text, or a file (``.txt``, ``.srt``, ``.vtt``, ``.ssml``, ``.xml``).
        language : str
            Voice of espeak-ng for the words.
        role : str, optional
            Speaker whose words are read; all by default.

        Raises
        ------
        DataError
            If no word is spoken, or the SSML cannot be parsed or declares entities.
        """
        words = Words.of(given)
        check_language(language)
        source = words.source or quoted(words.text)
        if words.kind == "grid":
            raise DataError(f"script {source}: a TextGrid has no tags; give it as words")
        found = _Reading()
        if words.kind == "ssml" and role is not None:
            raise DataError(f"role {quoted(role)} needs lines with times; give a .srt or a .vtt")
        if words.kind == "ssml":
            lines: Sequence[Cue] = Ssml(source, found.unknown).read(words.text)
        else:
            lines = cues_of(words, source, role, brackets=True)
        spoken: list[Word] = []
        for line in lines:
            found.line(line, language, spoken)
        marks = sorted(found.marks, key=lambda mark: (mark.first, mark.stop))
        unknown = tuple(dict.fromkeys(found.unknown))
        return cls(spoken_transcript(spoken, source), tuple(marks), unknown)

    def notes(self) -> Iterator[str]:
        """Lines on what is not used."""
        if self.unknown:
            yield f"tags of the script that are unknown and not used: {listed(self.unknown, 10)}"
        others = list(dict.fromkeys(mark.name for mark in self.marks if mark.kind == "other"))
        if others:
            yield f"tags of the script that no face shows: {listed(others, 10)}"

    def timed(self, fit: "WordFit | None", seconds: float) -> tuple[TimedMark, ...]:
        """The marks in the sound, by the times of the words; none where the words do not fit."""
        if fit is None or not fit.is_used or len(fit.words) != len(self.transcript.words):
            return ()
        return tuple(timed_mark(mark, fit.words, seconds) for mark in self.marks)


class _Reading:
    """Words and marks as they are read."""

    def __init__(self) -> None:
        self.marks: list[Mark] = []
        self.unknown: list[str] = []
        self.open: list[tuple[Kind, str, str, int]] = []

    def line(self, line: Cue, language: str, spoken: list[Word]) -> None:
        """Take a line: its words go to `spoken`, its marks end with it."""
        pieces = line.pieces if isinstance(line, Line) else tuple(_pieces(line.text))
        text, places = [], []  # words as written, and the pieces before each
        for piece in pieces:
            if piece.do == "text":
                text += _SPOKEN.findall(piece.text)
            else:
                places.append((len(text), piece))
        said = line.words(" ".join(text), language)
        # Words as written to those that are pronounced, which may be more or fewer.
        index = _indices(text, said)
        first = len(spoken)
        spoken += said
        for place, piece in places:
            self._take(piece, first + index[place])
        self._close(len(spoken), lambda kind: True)
        letters = ["".join(filter(str.isalpha, word.text)) for word in said]
        capitals = [k for k, word in enumerate(letters) if len(word) > 1 and word.isupper()]
        if len(capitals) < len(said):
            for k in capitals:
                self.marks.append(
                    Mark("accent", said[k].text, str(ACCENTS["moderate"]), first + k, first + k + 1)
                )

    def _take(self, piece: Piece, place: int) -> None:
        if piece.do == "end":
            self._close(place, lambda kind: kind == piece.kind, only_last=True)
        elif piece.do == "begin":
            self.open.append((piece.kind, piece.text, piece.value, place))
        elif piece.kind in ("emotion", "voice"):
            # Tags without a word between them hold together.
            self._close(place, lambda kind: kind in ("emotion", "voice"), before=place)
            self._close(place, lambda kind: kind == piece.kind)
            self.open.append((piece.kind, piece.text, piece.value, place))
        elif piece.value == UNKNOWN:
            self.unknown.append(piece.text)
        else:
            self.marks.append(Mark(piece.kind, piece.text, piece.value, place, place))

    def _close(
        self, place: int, which: Any, *, only_last: bool = False, before: float = math.inf
    ) -> None:
        """End the marks of some kinds before a word; those that began before another one."""
        for k in range(len(self.open) - 1, -1, -1):
            kind, name, value, first = self.open[k]
            if not which(kind) or first >= before:
                continue
            del self.open[k]
            if place > first:
                self.marks.append(Mark(kind, name, value, first, place))
            if only_last:
                return


def _indices(text: list[str], said: list[Word]) -> list[int]:
    """Place among the pronounced words of each word as written, and of their end.

    A number is pronounced as several words of its text, and a sign may be none.
    """
    found, place = [], 0
    for word, following in zip(text, [*text, ""][1:], strict=True):
        found.append(place)
        if not any(c.isalnum() for c in word):
            continue
        same = place
        while same < len(said) and said[same].text == bare(word):
            same += 1
        place = place + 1 if same > place and bare(following) == bare(word) else same
    return [*found, len(said)]


def _pieces(text: str) -> Iterator[Piece]:
    """Text and tags of a line."""
    at = 0
    for match in _TAG.finditer(text):
        yield Piece("text", text[at : match.start()])
        at = match.end()
        if match[3] is not None:
            yield Piece("begin", match[3], "accent", str(ACCENTS["moderate"]))
            yield Piece("text", match[3])
            yield Piece("end", match[3], "accent")
            continue
        name = " ".join((match[1] if match[1] is not None else match[2]).split()).lower()
        if name:
            yield tag_of(name, match[0])
    yield Piece("text", text[at:])
