"""What `deitalk.animate` and `deitalk.animate_mesh` ask of their arguments, before any work."""

from collections.abc import Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from deitalk.emotions import (
    EmotionTrack,
    IntensityCurve,
    check_intensity,
    parse_emotion,
    read_intensity_curve,
)
from deitalk.errors import DeitalkError, EmotionError
from rig.errors import quoted

MAX_SEED = 2**63


def emotion_track(emotion: Any) -> EmotionTrack:
    """Return an emotion in any of its spellings as a track.

    Raises
    ------
    EmotionError
        If it is none of them; see `deitalk.emotions.parse_emotion`.
    """
    if not isinstance(emotion, str | Path | Mapping | EmotionTrack):
        raise EmotionError(
            f"emotion {quoted(emotion)} is a {type(emotion).__name__}; give a name, weights such "
            "as {'happy': 0.7}, a file or an EmotionTrack"
        )
    return parse_emotion(emotion)


def emotion_text(emotion: Any) -> str:
    """Return an emotion as a line for a take's settings."""
    if isinstance(emotion, EmotionTrack):
        return f"a track of {len(emotion.times)} keys"
    if isinstance(emotion, Mapping):
        return ",".join(f"{name}={weight:g}" for name, weight in emotion.items())
    return str(emotion)


def intensity_factor(intensity: Any) -> float:
    """Return a factor on the intensity; EmotionError if it is no number of 0 to 4."""
    if not isinstance(intensity, Real) or isinstance(intensity, bool):
        raise EmotionError(f"intensity {quoted(intensity)} must be a number, 0 to 4")
    return check_intensity(float(intensity))


def applied_curve(curve: Any) -> IntensityCurve | None:
    """Return an intensity curve, read from its file if it is a path; EmotionError if neither."""
    if curve is None or isinstance(curve, IntensityCurve):
        return curve
    if not isinstance(curve, str | Path):
        raise EmotionError(
            f"intensity_curve {quoted(curve)} is a {type(curve).__name__}; give a file or an "
            "IntensityCurve"
        )
    return read_intensity_curve(curve)


def whole_seed(seed: Any) -> int:
    """Return a seed; DeitalkError if it is no whole number of 0 or more."""
    is_whole = isinstance(seed, Integral) and not isinstance(seed, bool)
    if not is_whole or not 0 <= int(seed) < MAX_SEED:
        raise DeitalkError(f"seed {quoted(seed)} must be a whole number of 0 to 2**63 - 1")
    return int(seed)


def check_progress(progress: Any) -> None:
    """Refuse what cannot be called with a share."""
    if not callable(progress):
        raise DeitalkError(f"progress {quoted(progress)} must be a function of the share done")
