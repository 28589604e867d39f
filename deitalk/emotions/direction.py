"""The emotion and the intensity that an animation follows, checked together."""

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

from deitalk.emotions.actor import ActorReference, read_actor
from deitalk.emotions.tracks import (
    EmotionTrack,
    IntensityCurve,
    check_intensity,
    parse_emotion,
    read_intensity_curve,
)
from deitalk.errors import EmotionError
from rig.errors import quoted


@dataclass(frozen=True)
class Direction:
    """Emotion, intensity factor and optional intensity curve of one animation.

    Parameters
    ----------
    emotion : EmotionTrack
        Weights of the emotional styles over time.
    intensity : float, range 0 to 4
        Factor on the intensity predicted from the voice; 0 gives the neutral reading.
    curve : IntensityCurve, optional
        Replaces the predicted intensity.
    voice : ActorReference, optional
        Usual voice of the speaker, with which the recording is compared.
    """

    emotion: EmotionTrack
    intensity: float = 1.0
    curve: IntensityCurve | None = None
    voice: ActorReference | None = None

    @property
    def is_neutral(self) -> bool:
        """Whether emotion, intensity and voice are those of `Direction.of()`."""
        is_plain = self.intensity == 1 and self.curve is None and self.voice is None
        return is_plain and bool((self.emotion.weights[:, 0] == 1).all())

    @classmethod
    def of(
        cls,
        emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
        intensity: float = 1.0,
        intensity_curve: str | Path | IntensityCurve | None = None,
        voice: str | Path | ActorReference | None = None,
    ) -> "Direction":
        """Check these arguments of `deitalk.animate`, and read those that are files.

        Raises
        ------
        EmotionError
            If one has the wrong type, is out of its range or is a malformed file.
        """
        return cls(_track(emotion), _factor(intensity), _curve(intensity_curve), _voice(voice))


def _track(emotion: Any) -> EmotionTrack:
    if not isinstance(emotion, str | Path | Mapping | EmotionTrack):
        raise EmotionError(
            f"emotion {quoted(emotion)} is a {type(emotion).__name__}; give a name, weights such "
            "as {'happy': 0.7}, a file or an EmotionTrack"
        )
    return parse_emotion(emotion)


def _factor(intensity: Any) -> float:
    if not isinstance(intensity, Real) or isinstance(intensity, bool):
        raise EmotionError(f"intensity {quoted(intensity)} must be a number, 0 to 4")
    return check_intensity(float(intensity))


def _curve(curve: Any) -> IntensityCurve | None:
    if curve is None or isinstance(curve, IntensityCurve):
        return curve
    if not isinstance(curve, str | Path):
        raise EmotionError(
            f"intensity_curve {quoted(curve)} is a {type(curve).__name__}; give a file or an "
            "IntensityCurve"
        )
    return read_intensity_curve(curve)


def _voice(voice: Any) -> ActorReference | None:
    if voice is None or isinstance(voice, ActorReference):
        return voice
    if not isinstance(voice, str | Path):
        raise EmotionError(
            f"voice {quoted(voice)} is a {type(voice).__name__}; give a file or an ActorReference"
        )
    return read_actor(Path(voice))
