"""An actor: the usual voice, from which the strength of a recording counts, and the way of moving.

Written by `deitalk data voice`::

    {"format": "deitalk-actor", "version": 1, "strength": 0.41, "effort": -0.27,
     "recordings": 12, "seconds": 63.5,
     "traits": {"blink_interval": 1.1, "side": -0.09, "brow_range": 1, "head_range": 1.05,
                "avoids": 0.3, "own": 1}}

The traits may be edited, or left out: then they are drawn for each recording.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from deitalk.errors import EmotionError
from rig import limits
from rig.errors import quoted
from rig.files.reading import load_json, read_bytes

FORMAT, VERSION = "deitalk-actor", 1
LARGEST = 100.0
TRAITS = {
    "blink_interval": (0.25, 4.0),
    "side": (-0.3, 0.3),
    "brow_range": (0.0, 2.0),
    "head_range": (0.0, 2.0),
    "avoids": (-1.0, 1.0),
    "own": (0.0, 1.0),
}
"""Names and ranges of the traits, see `deitalk.postprocess.life.character.Traits`."""


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
    traits : mapping of str to float
        Some of `TRAITS`; empty: drawn for each recording.
    effort : float or None
        Median of a network's readout of the strength (`Tracks.effort`), dB; None where the network
        that measured has none.
    """

    strength: float
    recordings: int
    seconds: float
    traits: Mapping[str, float] = field(default_factory=dict)
    effort: float | None = None

    @property
    def content(self) -> dict[str, Any]:
        """Content of a reference file."""
        content: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "strength": self.strength,
            "recordings": self.recordings,
            "seconds": self.seconds,
        }
        content |= {} if self.effort is None else {"effort": self.effort}
        return content | ({"traits": dict(self.traits)} if self.traits else {})

    def as_json(self) -> str:
        """Return a reference file, its numbers rounded."""
        rounded = replace(
            self,
            strength=round(self.strength, 4),
            effort=None if self.effort is None else round(self.effort, 4),
            seconds=round(self.seconds, 2),
            traits={name: round(value, 4) for name, value in self.traits.items()},
        )
        return json.dumps(rounded.content) + "\n"


def read_actor(path: Path) -> ActorReference:
    """Read a reference file.

    Raises
    ------
    EmotionError
        If it is absent, too large or malformed.
    """
    return parse_actor(read_bytes(path, limits.TRACK_JSON_BYTES, error=EmotionError), path)


def parse_actor(data: bytes, path: object) -> ActorReference:
    """Parse the content of a file of `read_actor`; `path` is for messages."""
    way_out = "`deitalk data voice` writes an actor reference"
    content = load_json(data, path, error=lambda told: EmotionError(f"{told}; {way_out}"))
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise EmotionError(f"{path} is no actor reference; {way_out}")
    if content.get("version") != VERSION:
        version = quoted(content.get("version"))
        raise EmotionError(f"{path}: version {version} is not {VERSION}; build it again")
    try:
        strength, seconds = float(content["strength"]), float(content["seconds"])
        recordings = int(content["recordings"])
        effort = None if content.get("effort") is None else float(content["effort"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise EmotionError(f"{path} is no actor reference; {way_out}") from None
    for name, value in (("strength", strength), ("effort", effort or 0.0)):
        if not (math.isfinite(value) and abs(value) <= LARGEST):
            raise EmotionError(f"{path}: {name} {value:g} must be from -{LARGEST:g} to {LARGEST:g}")
    traits = checked_traits(path, content.get("traits", {}))
    return ActorReference(strength, recordings, seconds, traits, effort)


def checked_traits(path: object, traits: Any) -> dict[str, float]:
    """Traits of a file, each in its range; EmotionError names `path`."""
    if not isinstance(traits, dict) or any(name not in TRAITS for name in traits):
        raise EmotionError(f"{path}: traits must be an object with some of {', '.join(TRAITS)}")
    for name, value in traits.items():
        low, high = TRAITS[name]
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not low <= value <= high:
            raise EmotionError(f"{path}: {name} {quoted(value)} must be from {low:g} to {high:g}")
    return {name: float(value) for name, value in traits.items()}
