"""One recording of a batch with its settings, and the key of what is made of it."""

import hashlib
import json
import re
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

from deitalk.audio.original import ZERO, start_of
from deitalk.emotions import check_intensity, parse_emotion
from deitalk.emotions.track_files import TRACK_SUFFIXES
from deitalk.errors import DeitalkError
from deitalk.pipeline.arguments import LONGEST_LISTENING
from deitalk.pipeline.words.transcript import is_words_file
from deitalk.postprocess.life.amounts import Life
from rig import limits
from rig.errors import quoted
from rig.files.reading import read_bytes
from rig.formats import checked_digits, find_format
from rig.formats.table import FORMATS, Format, writable_suffixes

TAKE = "take"
"""Name of the format that is a whole take folder."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of one line; a manifest's empty cells keep the defaults of the command.

    Parameters
    ----------
    emotion : str
        As for `deitalk.animate`; a track is the path of its file.
    intensity : float, range 0 to 4
        Factor on the intensity predicted from the voice.
    intensity_curve, voice : str
        Paths, as for `deitalk.animate`; empty: none.
    actor : str
        Who speaks; lines of one actor share a reference. Empty: nobody in particular.
    formats : tuple of str
        Suffixes of the files to write, and ``take``.
    fps : float, optional
        Rate of the written curves.
    digits : int, range 2 to 6, optional
        Digits after the point, of the formats that have them.
    timecode : str
        Of the first frame: ``zero``, ``recording`` or ``HH:MM:SS:FF``.
    transcript, phones, language : str
        As for `deitalk.animate`, from a manifest alone; empty: no words, in the default language.
    idle, raw, seed, life, look_at, listen, gain
        As for `deitalk.animate`; empty: its defaults.
    """

    emotion: str = "neutral"
    intensity: float = 1.0
    intensity_curve: str = ""
    voice: str = ""
    actor: str = ""
    formats: tuple[str, ...] = (".csv",)
    fps: float | None = None
    idle: bool = True
    raw: bool = False
    seed: int = 0
    life: str = ""
    look_at: str = ""
    listen: float = 0.0
    gain: str = ""
    digits: int | None = None
    timecode: str = ZERO
    transcript: str = ""
    phones: str = ""
    language: str = ""


@dataclass(frozen=True, slots=True)
class Line:
    """One recording to animate."""

    number: int
    """Row of the manifest or place in the folder, from 1."""
    audio: str
    """Path or URL of the recording."""
    output: str
    """Path below the output folder with ``/``, without suffix."""
    settings: Settings = field(default_factory=Settings)

    @property
    def targets(self) -> tuple[str, ...]:
        """Files and, for a take, the folder that are written, below the output folder."""
        return tuple(
            self.output if suffix == TAKE else self.output + suffix
            for suffix in self.settings.formats
        )


@dataclass(frozen=True, slots=True)
class BadLine:
    """A row or a recording that cannot be animated."""

    number: int
    audio: str
    output: str
    error: str


def parse_formats(text: str) -> tuple[str, ...]:
    """Suffixes of a list of formats, such as ``csv;take`` or ``.npz livelink``.

    Raises
    ------
    DeitalkError
        If one is unknown or cannot be written.
    """
    names = [name for name in re.split(r"[\s,;|+]+", text.strip()) if name]
    found = tuple(dict.fromkeys(_suffix(name) for name in names))
    if not found:
        raise DeitalkError("no format is named; give csv, npz, take or another")
    return found


@cache
def _suffix(name: str) -> str:
    lower = name.lower()
    if lower == TAKE:
        return TAKE
    dotted = "." + lower.removeprefix(".")
    if dotted in writable_suffixes():
        return dotted
    by_name = {f.name: f.suffixes[0] for f in FORMATS if f.write}
    if lower not in by_name:
        known = ", ".join((TAKE, *by_name))
        raise DeitalkError(f"format {quoted(name)} is unknown; known are {known}")
    return by_name[lower]


def check_settings(settings: Settings) -> None:
    """Check what can be checked without reading a file.

    Raises
    ------
    UserError
        If a number is out of its range or an emotion is unknown.
    """
    from rig.curves import snap_fps
    from rig.curves.edit import parse_gains

    check_intensity(settings.intensity)
    _checked_life(settings.life, settings.look_at)
    if not 0 <= settings.listen <= LONGEST_LISTENING:
        raise DeitalkError(f"listen {settings.listen:g} must be 0 to {LONGEST_LISTENING:g} s")
    parse_gains(settings.gain or None)
    if settings.transcript and settings.phones:
        raise DeitalkError("transcript and phones are both given; leave one out")
    if not is_track(settings.emotion):
        _parsed(settings.emotion)
    if settings.fps is not None:
        snap_fps(settings.fps)
    start_of(settings.timecode, settings.fps, 0.0)
    if settings.digits is not None:
        _check_digits(settings.digits, settings.formats)


def has_digits(suffix: str) -> bool:
    """Whether a format of a line is written with a number of digits."""
    return suffix == TAKE or "digits" in _written(suffix).options


def _written(suffix: str) -> Format:
    return find_format(Path(f"x{suffix}"), writable=True)


@cache
def _check_digits(digits: int, formats: tuple[str, ...]) -> None:
    """Raise if there are too few or too many digits, or none of the formats has them."""
    taking = any(map(has_digits, formats))
    checked_digits(digits, None if taking else _written(formats[0]))


@cache
def _parsed(emotion: str) -> None:
    parse_emotion(emotion)


@cache
def _checked_life(life: str, look_at: str) -> None:
    Life.of(life or None, look_at or (0.0, 0.0))


def is_track(emotion: str) -> bool:
    """Whether an emotion is the path of a track's file."""
    return emotion.lower().endswith(TRACK_SUFFIXES)


def line_key(line: Line, model: str, strength: float | None) -> str:
    """Hash of everything but the sound that the outputs of a line follow from.

    Parameters
    ----------
    line : Line
        Files that its settings name are hashed by their content.
    model : str
        Identity of the model: its weights, configuration and rules.
    strength : float, optional
        Reference of the line's actor.

    Raises
    ------
    DeitalkError
        If a file of its settings cannot be read.
    """
    settings = line.settings
    parts = asdict(settings) | {"model": model, "strength": strength}
    for name in ("intensity_curve", "voice"):
        if path := getattr(settings, name):
            parts[name] = content_hash(path)
    for name in ("transcript", "phones"):
        if is_words_file(words := getattr(settings, name)):
            parts[name] = content_hash(words)
    if is_track(settings.emotion):
        parts["emotion"] = content_hash(settings.emotion)
    if TAKE in settings.formats:
        parts["name"] = Path(line.audio).name  # files of a take are named after it
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


@cache
def content_hash(path: str) -> str:
    """SHA-256 of a small file, in hexadecimal."""
    data = read_bytes(Path(path), limits.TRACK_BYTES, error=DeitalkError)
    return hashlib.sha256(data).hexdigest()
