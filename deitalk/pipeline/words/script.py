"""A script: words with what is said of how they are spoken, laid along a recording.

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
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from xml.parsers import expat

import numpy as np

from deitalk.acting_fields import Words
from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import parse_emotion
from deitalk.errors import DataError
from deitalk.pipeline.words.transcript import (
    Cue,
    Transcript,
    Word,
    bare,
    check_language,
    cues_of,
    spoken_transcript,
)
from deitalk.postprocess.life.voice import ACCENT_DISTANCE, Accent, Voice
from rig.arrays import Float32
from rig.errors import listed, quoted
from rig.files.reading import rows_of

if TYPE_CHECKING:  # needs torch
    from deitalk.pipeline.words.align import WordFit

Kind = Literal["emotion", "voice", "accent", "sound", "pause", "other"]
RAMP_SECONDS = 0.3
"""Time over which the emotion of a tag comes before its first word and goes after its last."""
LEAST_SOUND, MOST_SOUND = 0.5, 2.0
"""Seconds for which the emotion of a sound that is no word is shown: the pause that it lies in."""
ACCENTS = {"strong": 1.0, "moderate": 0.7, "reduced": 0.0, "none": 0.0}
"""Strength of the accent of a stressed word by the level of ``emphasis``; 0 takes its own away."""
VOLUMES = {
    "silent": 0.0, "x-soft": 0.5, "soft": 0.75, "medium": 1.0, "default": 1.0, "loud": 1.25,
    "x-loud": 1.5,
}  # fmt: skip
"""Factor on the intensity by ``volume``."""
DECIBELS = 12.0
"""Of a volume in dB that halves or doubles the intensity's factor."""
PAUSES = {"none": 0.0, "x-weak": 0.1, "weak": 0.2, "medium": 0.4, "strong": 0.7, "x-strong": 1.2}
"""Seconds by ``strength`` of a break."""
LINES = ("p", "s")
SILENT_ELEMENTS = ("speak", *LINES, "say-as", "phoneme", "w", "lang")
"""Elements of SSML that say nothing of a face."""
UNSHOWN_ELEMENTS = ("mark", "bookmark", "audio", "voice")
UNKNOWN = "unknown"
"""In place of the value of a tag."""
STYLES = {
    "mstts:express-as": "style", "google:style": "name", "amazon:emotion": "name",
    "amazon:effect": "name",
}  # fmt: skip
"""Elements of vendors whose attribute is a tag."""
DEEPEST = 64
"""Most elements of SSML within one another."""
_TAG = re.compile(r"\[([^\[\]\n]{0,200})\]|\(([^()\n]{0,200})\)|\*([^*\n]{1,200})\*")
_SPOKEN = re.compile(r"\S+")


class Mark(NamedTuple):
    """Something said of a part of the words."""

    kind: Kind
    name: str
    value: str
    """Weights of an emotion, factor on the intensity, strength of an accent, seconds of a pause."""
    first: int
    """Word before which it stands, and that it begins with."""
    stop: int
    """Past its last word; `first` of what lies between words."""


class TimedMark(NamedTuple):
    """A mark in the sound."""

    kind: Kind
    name: str
    value: str
    start: float
    end: float
    """Seconds."""


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
            lines: Sequence[Cue] = _Ssml(source, found.unknown).read(words.text)
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
        starts = [word.start for word in fit.words]
        ends = [word.end for word in fit.words]
        return tuple(_timed(mark, starts, ends, seconds) for mark in self.marks)


def _timed(mark: Mark, starts: list[float], ends: list[float], seconds: float) -> TimedMark:
    if mark.stop > mark.first:
        return TimedMark(*mark[:3], starts[mark.first], ends[mark.stop - 1])
    before = ends[mark.first - 1] if mark.first else 0.0
    after = starts[mark.first] if mark.first < len(starts) else seconds
    if mark.kind == "sound":
        middle, half = (before + after) / 2, min(max(after - before, LEAST_SOUND), MOST_SOUND) / 2
        before, after = max(middle - half, 0.0), min(middle + half, seconds)
    return TimedMark(*mark[:3], before, max(before, after))


# What the marks change of a take.


def with_emotions(weights: Float32, marks: Sequence[TimedMark], times: Any) -> Float32:
    """Weights of the emotions [shape=(T, 9)] with those of the marks; they come in a ramp."""
    found = weights.astype(np.float64)
    for mark in marks:
        if mark.kind not in ("emotion", "sound") or (
            mark.kind == "sound" and mark.value == "neutral=1"
        ):
            continue
        share = _share(times, mark)[:, None]
        wanted = _weights(mark.value).at(np.zeros(1))
        found = found + share * (wanted - found)
    return np.asarray(found, np.float32)


def levels(marks: Sequence[TimedMark], times: Any) -> Float32:
    """Factor on the intensity of each frame [shape=(T,)]."""
    factor = np.ones(len(times))
    for mark in marks:
        if mark.kind == "voice":
            factor *= 1 + _share(times, mark) * (float(mark.value) - 1)
    return factor.astype(np.float32)


def with_accents(voice: Voice, marks: Sequence[TimedMark]) -> Voice:
    """The events of a voice with the accents of the marks, in place of those within their words."""
    stressed = [mark for mark in marks if mark.kind == "accent"]
    kept = list(voice.accents)
    for mark in stressed:
        middle = round((mark.start + mark.end) / 2 * FRAME_RATE)
        size = float(mark.value)
        span = range(round(mark.start * FRAME_RATE), round(mark.end * FRAME_RATE) + 1)
        inside = [accent for accent in kept if accent.frame in span]
        place = max(inside, key=lambda accent: accent.strength).frame if inside else middle
        gone = ACCENT_DISTANCE if size else 0
        kept = [a for a in kept if a not in inside and abs(a.frame - place) >= gone]
        if size and 0 <= place < voice.n_frames:
            kept.append(Accent(place, size))
    return voice._replace(accents=tuple(sorted(kept)))


def _share(times: Any, mark: TimedMark) -> Any:
    """1 within a mark, with ramps on both sides [shape=(T,)]."""
    rises = np.clip((times - mark.start) / RAMP_SECONDS + 1, 0, 1)
    falls = np.clip((mark.end - times) / RAMP_SECONDS + 1, 0, 1)
    share = np.minimum(rises, falls)
    return share * share * (3 - 2 * share)


_weights = cache(parse_emotion)


# Notations to words and marks.


@cache
def known_tags() -> dict[str, tuple[Kind, str]]:
    """Kind and value of each tag."""
    rows = rows_of(Path(__file__).with_name("tags.csv"))
    return {row["tag"]: (row["kind"], row["value"]) for row in rows}  # type: ignore[misc]


class Piece(NamedTuple):
    """A part of a line of SSML: text, or a mark that begins, ends, or stands there."""

    do: Literal["text", "begin", "end", "at"]
    text: str = ""
    kind: Kind = "other"
    value: str = ""


@dataclass(frozen=True)
class Line(Cue):
    """A line of SSML, in pieces."""

    pieces: tuple[Piece, ...] = ()


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
            self._take(piece, first + index[place], len(spoken))
        self._close(len(spoken), lambda kind: True)
        capitals = [k for k, word in enumerate(said) if _is_loud(word.text)]
        if len(capitals) < len(said):
            for k in capitals:
                self.marks.append(
                    Mark("accent", said[k].text, str(ACCENTS["moderate"]), first + k, first + k + 1)
                )

    def _take(self, piece: Piece, place: int, last: int) -> None:
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


def _is_loud(word: str) -> bool:
    letters = [c for c in word if c.isalpha()]
    return len(letters) > 1 and all(c.isupper() for c in letters)


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
            yield _tag(name, match[0])
    yield Piece("text", text[at:])


def _tag(name: str, written: str) -> Piece:
    """The mark of a tag, a closing one such as ``[/whispers]`` too."""
    if name.startswith("/") and name[1:].strip() in known_tags():
        return Piece("end", name, known_tags()[name[1:].strip()][0])
    for form in (name, name.removesuffix(" tone"), name.removesuffix(" voice")):
        if form in known_tags():
            kind, value = known_tags()[form]
            return Piece("at", form, kind, value)
    return _unknown(written)


class _Ssml:
    """Lines of SSML: sentences and paragraphs.

    The parser reads no document type, so that there are no entities but those of XML itself.
    """

    def __init__(self, source: str, unknown: list[str]) -> None:
        self.source, self.unknown = source, unknown
        self.lines: list[Line] = []
        self.pieces: list[Piece] = []
        self.opened: list[list[Kind]] = []
        self.replaced = 0
        """Depth of the element whose text is replaced by another; 0: none."""

    def read(self, text: str) -> list[Line]:
        """Parse a document."""
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = self._text, self._refuse
        try:
            parser.Parse(text.encode(errors="replace"), True)
        except expat.ExpatError as error:
            raise DataError(
                f"script {self.source}: the SSML cannot be parsed ({error}); mend it"
            ) from None
        self._close_line()
        return self.lines

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        if len(self.opened) >= DEEPEST:
            raise DataError(
                f"script {self.source}: more than {DEEPEST} elements within one another; mend it"
            )
        self.opened.append([])
        if self.replaced:
            return
        if name in LINES:
            self._close_line()
        made = ELEMENTS[name](attributes) if name in ELEMENTS else _other(name, attributes)
        for piece in made:
            if piece.value == UNKNOWN:
                self.unknown.append(piece.text)
                continue
            self.pieces.append(piece)
            if piece.do == "begin":
                self.opened[-1].append(piece.kind)
        if name == "sub":
            self.replaced = len(self.opened)

    def _end(self, name: str) -> None:
        if self.replaced == len(self.opened):
            self.replaced = 0
        for kind in reversed(self.opened.pop()):
            self.pieces.append(Piece("end", name, kind))
        if name in LINES:
            self._close_line()

    def _text(self, text: str) -> None:
        if not self.replaced:
            self.pieces.append(Piece("text", text))

    def _refuse(self, *_: object) -> None:
        raise DataError(
            f"script {self.source}: SSML with a document type is not read; remove DOCTYPE"
        )

    def _close_line(self) -> None:
        if any(piece.do == "text" and piece.text.strip() for piece in self.pieces):
            self.lines.append(Line(pieces=tuple(self.pieces)))
            self.pieces = []


def _unknown(text: str) -> Piece:
    return Piece("at", text, "other", UNKNOWN)


def _emphasis(attributes: dict[str, str]) -> Iterator[Piece]:
    level = attributes.get("level", "moderate")
    if level in ACCENTS:
        yield Piece("begin", f"emphasis {level}", "accent", str(ACCENTS[level]))
    else:
        yield _unknown(f"emphasis level={level}")


def _prosody(attributes: dict[str, str]) -> Iterator[Piece]:
    """The volume; rate, pitch, range and contour are in the sound."""
    volume = attributes.get("volume")
    factor = None if volume is None else _volume(volume)
    if factor is not None:
        yield Piece("begin", f"volume {volume}", "voice", f"{factor:.4g}")
    elif volume is not None:
        yield _unknown(f"prosody volume={volume}")
    others = attributes.keys() - {"volume", "rate", "pitch", "range", "contour", "duration"}
    yield from (_unknown(f"prosody {other}") for other in sorted(others))


def _other(name: str, attributes: dict[str, str]) -> Iterator[Piece]:
    """Styles of vendors, elements that no face shows, and unknown ones."""
    if name in STYLES:
        style = attributes.get(STYLES[name], "")
        piece = _tag(" ".join(style.split()).lower(), f"{name} {style}")
        yield piece._replace(do="begin") if piece.kind in ("emotion", "voice") else piece
    elif name in UNSHOWN_ELEMENTS:
        yield Piece("at", f"<{name}>", "other")
    elif name not in SILENT_ELEMENTS:
        yield _unknown(f"<{name}>")


def _break(attributes: dict[str, str]) -> Iterator[Piece]:
    time, strength = attributes.get("time"), attributes.get("strength", "medium")
    match = re.fullmatch(r"\+?(\d{1,5}(?:\.\d{0,3})?|\.\d{1,3})(ms|s)", time or "")
    if match is not None:
        seconds = float(match[1]) / (1000 if match[2] == "ms" else 1)
        yield Piece("at", f"break {time}", "pause", f"{seconds:.4g}")
    elif time is not None:
        yield _unknown(f"break time={time}")
    elif strength in PAUSES:
        yield Piece("at", f"break {strength}", "pause", f"{PAUSES[strength]:.4g}")
    else:
        yield _unknown(f"break strength={strength}")


def _sub(attributes: dict[str, str]) -> Iterator[Piece]:
    yield Piece("text", attributes.get("alias", ""))


def _volume(volume: str) -> float | None:
    """Factor of a volume: a name, or decibels; None of another."""
    match = re.fullmatch(r"([+-]?\d{1,3}(?:\.\d{0,3})?)dB", volume)
    if match is None:
        return VOLUMES.get(volume)
    return float(np.clip(2 ** (float(match[1]) / DECIBELS), 0.25, 2.0))


ELEMENTS = {"emphasis": _emphasis, "break": _break, "prosody": _prosody, "sub": _sub}
"""What an element of SSML begins with, by its attributes."""
