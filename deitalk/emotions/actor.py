"""Usual voice of an actor: the reference of a recording's strength.

Written by `deitalk actor build`::

    {"format": "deitalk-actor", "version": 1, "strength": 0.41, "recordings": 12, "seconds": 63.5}
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

from deitalk.errors import EmotionError
from rig import limits
from rig.errors import quoted
from rig.files.reading import load_json, read_bytes

FORMAT, VERSION = "deitalk-actor", 1
LARGEST = 100.0


@dataclass(frozen=True)
class ActorReference:
    """Usual voice of an actor.

    Attributes
    ----------
    strength : float
        Median over the actor's recordings of `deitalk.audio.vocal_strength`, dB above the usual
        speech of an average speaker.
    recordings : int
        How many there were.
    seconds : float
        Their length.
    """

    strength: float
    recordings: int
    seconds: float

    def as_json(self) -> str:
        """Return the content of a reference file."""
        content = {
            "format": FORMAT,
            "version": VERSION,
            "strength": round(self.strength, 4),
            "recordings": self.recordings,
            "seconds": round(self.seconds, 2),
        }
        return json.dumps(content) + "\n"


def read_actor(path: Path) -> ActorReference:
    """Read a reference file.

    Raises
    ------
    EmotionError
        If it is absent, too large or malformed.
    """
    return parse_actor(read_bytes(path, limits.TRACK_JSON_BYTES, error=EmotionError), path)


def parse_actor(data: bytes, path: object) -> ActorReference:
    """As `read_actor`, of the content of a file; `path` is for messages."""
    content = load_json(data, path, error=EmotionError)
    rule = "is no actor reference; `deitalk actor build` writes one"
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise EmotionError(f"{path}: {rule}")
    if content.get("version") != VERSION:
        version = quoted(content.get("version"))
        raise EmotionError(f"{path}: version {version} is not {VERSION}; build it again")
    try:
        strength, seconds = float(content["strength"]), float(content["seconds"])
        recordings = int(content["recordings"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise EmotionError(f"{path}: {rule}") from None
    if not (math.isfinite(strength) and abs(strength) <= LARGEST):
        raise EmotionError(
            f"{path}: strength {strength:g} must be from -{LARGEST:g} to {LARGEST:g}"
        )
    return ActorReference(strength, recordings, seconds)
