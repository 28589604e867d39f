"""Lines of a script in SSML."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from xml.parsers import expat

import numpy as np

from deitalk.errors import DataError
from deitalk.pipeline.words.subtitles import Cue
from deitalk.pipeline.words.tags import UNKNOWN, Kind, Piece, tag_of, unknown_tag

ACCENTS = {"strong": 1.0, "moderate": 0.7, "reduced": 0.0, "none": 0.0}
"""Strength of the accent of a stressed word by the level of ``emphasis``; 0 takes its own away."""
VOLUMES = {
    "silent": 0.0, "x-soft": 0.5, "soft": 0.75, "medium": 1.0, "default": 1.0, "loud": 1.25,
    "x-loud": 1.5,
}  # fmt: skip
"""Factor on the intensity by ``volume``."""
DECIBELS = 12.0
"""Change of the volume that halves or doubles the intensity's factor, dB."""
PAUSES = {"none": 0.0, "x-weak": 0.1, "weak": 0.2, "medium": 0.4, "strong": 0.7, "x-strong": 1.2}
"""Seconds by ``strength`` of a break."""
LINES = ("p", "s")
SILENT_ELEMENTS = ("speak", *LINES, "say-as", "phoneme", "w", "lang")
"""Elements of SSML that say nothing of a face."""
UNSHOWN_ELEMENTS = ("mark", "bookmark", "audio", "voice")
STYLES = {
    "mstts:express-as": "style", "google:style": "name", "amazon:emotion": "name",
    "amazon:effect": "name",
}  # fmt: skip
"""Elements of vendors whose attribute is a tag."""
DEEPEST = 64
"""Most elements of SSML within one another."""


@dataclass(frozen=True)
class Line(Cue):
    """A line of SSML, in pieces."""

    pieces: tuple[Piece, ...] = ()


class Ssml:
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
        for piece in pieces_of(name, attributes):
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


def pieces_of(name: str, attributes: dict[str, str]) -> Iterator[Piece]:
    """Pieces that an element of SSML begins with."""
    if name == "emphasis":
        level = attributes.get("level", "moderate")
        if level in ACCENTS:
            yield Piece("begin", f"emphasis {level}", "accent", str(ACCENTS[level]))
        else:
            yield unknown_tag(f"emphasis level={level}")
    elif name == "break":
        yield _break(attributes.get("time"), attributes.get("strength", "medium"))
    elif name == "prosody":
        yield from _prosody(attributes)
    elif name == "sub":
        yield Piece("text", attributes.get("alias", ""))
    elif name in STYLES:  # of a vendor
        style = attributes.get(STYLES[name], "")
        piece = tag_of(" ".join(style.split()).lower(), f"{name} {style}")
        yield piece._replace(do="begin") if piece.kind in ("emotion", "voice") else piece
    elif name in UNSHOWN_ELEMENTS:
        yield Piece("at", f"<{name}>", "other")
    elif name not in SILENT_ELEMENTS:
        yield unknown_tag(f"<{name}>")


def _prosody(attributes: dict[str, str]) -> Iterator[Piece]:
    """Pieces of a volume; rate, pitch, range and contour are in the sound."""
    volume = attributes.get("volume", "medium")
    decibels = re.fullmatch(r"([+-]?\d{1,3}(?:\.\d{0,3})?)dB", volume)
    factor = VOLUMES.get(volume)
    if decibels is not None:
        factor = float(np.clip(2 ** (float(decibels[1]) / DECIBELS), 0.25, 2.0))
    if factor is None:
        yield unknown_tag(f"prosody volume={volume}")
    elif "volume" in attributes:
        yield Piece("begin", f"volume {volume}", "voice", f"{factor:.4g}")
    others = attributes.keys() - {"volume", "rate", "pitch", "range", "contour", "duration"}
    yield from (unknown_tag(f"prosody {other}") for other in sorted(others))


def _break(time: str | None, strength: str) -> Piece:
    match = re.fullmatch(r"\+?(\d{1,5}(?:\.\d{0,3})?|\.\d{1,3})(ms|s)", time or "")
    if match is not None:
        seconds = float(match[1]) / (1000 if match[2] == "ms" else 1)
        return Piece("at", f"break {time}", "pause", f"{seconds:.4g}")
    if time is not None:
        return unknown_tag(f"break time={time}")
    if strength in PAUSES:
        return Piece("at", f"break {strength}", "pause", f"{PAUSES[strength]:.4g}")
    return unknown_tag(f"break strength={strength}")
