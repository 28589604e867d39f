"""Checks of arguments that `deitalk.animate` and `deitalk.animate_mesh` share, before any work."""

from collections.abc import Mapping
from numbers import Integral
from typing import Any

from deitalk.emotions import EmotionTrack
from deitalk.errors import DeitalkError
from rig.errors import quoted

MAX_SEED = 2**63
LONGEST_LISTENING = 600.0  # seconds


def emotion_text(emotion: Any) -> str:
    """Return an emotion as a line for a take's settings."""
    if isinstance(emotion, EmotionTrack):
        return f"a track of {len(emotion.times)} keys"
    if isinstance(emotion, Mapping):
        return ",".join(f"{name}={weight:g}" for name, weight in emotion.items())
    return str(emotion)


def whole_seed(seed: Any) -> int:
    """Return a seed; DeitalkError if it is no whole number of 0 or more."""
    is_whole = isinstance(seed, Integral) and not isinstance(seed, bool)
    if not is_whole or not 0 <= int(seed) < MAX_SEED:
        raise DeitalkError(f"seed {quoted(seed)} must be a whole number of 0 to 2**63 - 1")
    return int(seed)


def check_progress(progress: Any) -> None:
    """Refuse a progress that cannot be called."""
    if not callable(progress):
        raise DeitalkError(
            f"progress {quoted(progress)} must be a function of one number, the share done"
        )
