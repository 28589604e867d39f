"""The one whom a face listens to: when it speaks, how strongly, and what it feels."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.audio.frames import FRAME_RATE, frame_times
from deitalk.audio.load import Recording, load_audio
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.vocal_strength import strength_frames, vocal_strength
from deitalk.emotions import LABELS, parse_emotion
from deitalk.errors import DataError
from deitalk.postprocess.life.voice import Phrase, Voice, measure_voice
from rig.arrays import Float32
from rig.errors import quoted
from rig.files.reading import load_json

FORMAT, VERSION = "deitalk-heard", 1
STRENGTH_DB = 6.0
"""Strength of a voice above the usual from which a feeling counts as strong."""
MOST_PHRASES, LONGEST = 100_000, 86_400.0
"""Of a content; seconds."""


@dataclass(frozen=True)
class OtherVoice:
    """A voice that a face listens to, on the clock of its own recording.

    Attributes
    ----------
    seconds : float
        How long it is.
    phrases : tuple of tuple of float
        Start and stop of each, seconds, and its strength, 0 to 1.
    emotion : str
        What is felt, a label or weights; empty if it is not known: a listener mirrors none then.
    recording : Recording or None
        Its sound, until the emotion is known.
    """

    seconds: float
    phrases: tuple[tuple[float, float, float], ...] = ()
    emotion: str = ""
    recording: Recording | None = field(default=None, compare=False, repr=False)

    @classmethod
    def of_recording(cls, recording: Recording) -> "OtherVoice":
        """Measure a recording at 16 kHz."""
        activity, waveform = recording.activity, recording.waveform
        prosody = measure_prosody(waveform, len(activity))
        _, around = vocal_strength().follow(strength_frames(prosody, activity))
        phrases = []
        for start, stop, _ in measure_voice(activity, prosody).phrases:
            strong = 1 / (1 + math.exp(-float(np.mean(around[start:stop])) / STRENGTH_DB))
            phrases.append((start / FRAME_RATE, stop / FRAME_RATE, strong))
        rounded = tuple(tuple(round(x, 4) for x in phrase) for phrase in phrases)
        return cls(round(recording.duration, 4), rounded, recording=recording)  # type: ignore[arg-type]

    @property
    def content(self) -> dict[str, Any]:
        """What a take keeps of it."""
        about = {"format": FORMAT, "version": VERSION, "seconds": self.seconds}
        emotion = {"emotion": self.emotion} if self.emotion else {}
        return {**about, **emotion, "phrases": [list(phrase) for phrase in self.phrases]}

    def voice(self, n_frames: int) -> Voice:
        """Its phrases in the first frames of a take."""
        edges = [
            (round(start * FRAME_RATE), round(stop * FRAME_RATE)) for start, stop, _ in self.phrases
        ]
        phrases = tuple(Phrase(a, min(b, n_frames), False) for a, b in edges if a < n_frames)
        return Voice(n_frames, np.zeros(n_frames, np.float32), (), phrases)

    def felt(self, n_frames: int) -> Float32 | None:
        """Emotion of each frame, weights times strength [shape=(T, 9)]; None if it is not known."""
        if not self.emotion:
            return None
        strong = np.zeros((n_frames, 1), np.float32)
        for start, stop, strength in self.phrases:
            strong[round(start * FRAME_RATE) : round(stop * FRAME_RATE)] = strength
        weights = parse_emotion(self.emotion).at(frame_times(n_frames))
        shown = np.where(np.arange(len(LABELS)) > 0, weights, 0)
        return (strong * shown).astype(np.float32)


def other_voice(given: Any, where: str, path: Path | None = None) -> OtherVoice:
    """A voice of a recording, or of the content that a take keeps.

    Parameters
    ----------
    given : OtherVoice, Recording, mapping or str
        A text that begins with ``{`` is a content.
    where : str
        Name of the field, for messages.
    path : Path, optional
        Of the recording, where it is given by one.

    Raises
    ------
    UserError
        If it cannot be read.
    """
    if isinstance(given, OtherVoice):
        return given
    if isinstance(given, Recording):
        return OtherVoice.of_recording(given)
    if isinstance(given, Mapping):
        return _parsed(given, where)
    if isinstance(given, str) and given.lstrip().startswith("{"):
        return _parsed(load_json(given, where, error=DataError), where)
    if path is None:
        raise DataError(
            f"{where} {quoted(given)} is a {type(given).__name__}; give the path of a recording"
        )
    return OtherVoice.of_recording(load_audio(path))


def _parsed(content: Any, where: str) -> OtherVoice:
    """A voice of its content, checked."""
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise DataError(f"{where}: is no content of format {FORMAT}; give a recording")
    if content.get("version") != VERSION:
        version = quoted(content.get("version"))
        raise DataError(f"{where}: version {version} is unknown; known is {VERSION}")
    rows, emotion = content.get("phrases", []), content.get("emotion", "")
    if not isinstance(emotion, str):
        raise DataError(f"{where}: emotion {quoted(json.dumps(emotion))} must be text")
    if emotion:
        parse_emotion(emotion)
    try:
        seconds = float(content["seconds"])
        table = np.array(rows, np.float64).reshape(-1, 3)
    except (KeyError, TypeError, ValueError):
        seconds, table = math.nan, np.zeros((0, 3))
    times = table[:, :2].ravel()
    if (
        not 0 <= seconds <= LONGEST
        or not len(table) <= MOST_PHRASES
        or not (np.diff(times) >= 0).all()
        or not ((times >= 0) & (times <= seconds + 1 / FRAME_RATE)).all()
        or not ((table[:, 2] >= 0) & (table[:, 2] <= 1)).all()
    ):
        raise DataError(
            f"{where}: seconds must be a number to {LONGEST:g}, phrases rows of start, stop and "
            "strength (0 to 1) in the order of time within it"
        )
    phrases = tuple((float(a), float(b), float(c)) for a, b, c in table)
    return OtherVoice(seconds, phrases, emotion)
