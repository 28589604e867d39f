"""Gates of mouth and expression: shares of motion shown at each frame, from voice activity.

Paper silent: neither paper specifies the face in silence. Here the mouth shuts and the expression
decays by these gates, which use the activity of the whole clip.
"""

import numpy as np
import numpy.typing as npt

from deitalk.config.rules import Gates
from rig.arrays import AnyFloat, Float32

REST_AT_END = 13  # frames of trailing silence (0.43 s) that end in a face wholly at rest
HOLD_AT_END = 6  # frames (0.2 s) that change nothing yet; in between, in proportion


def mouth_gate(activity: npt.ArrayLike, gates: Gates = Gates()) -> Float32:
    """Share of the mouth's motion shown at each frame: 1 in speech, 0 in silence.

    Opens over the 0.1 s before speech and closes over the 0.2 s after it, in raised cosines.

    Parameters
    ----------
    activity : array [shape=(T,)]
        1 in speech, else 0, from `deitalk.audio.voice_activity.speech_activity`.
    gates : Gates
        Frames of opening and closing.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
    """
    return mouth_between(*_distances(activity), gates)


def expression_gate(activity: npt.ArrayLike, gates: Gates = Gates()) -> Float32:
    """Share of the emotional expression shown at each frame: 1 in speech and short pauses.

    Rises over the 0.4 s before speech, holds through pauses of 1.5 s, then fades over 1 s. In
    trailing silence the fade is complete by the last frame: from 0.43 s of silence on the face
    ends at rest; under 0.2 s the clip counts as cut and nothing fades; in between in proportion.

    Parameters
    ----------
    activity, gates
        As for `mouth_gate`.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
    """
    since, until = _distances(activity)
    gate = expression_between(since, until, gates)
    if len(gate) and 0 < since[-1] < gates.expression_holds + gates.expression_fades:
        trailing = int(since[-1])
        depth = np.clip((trailing - HOLD_AT_END) / (REST_AT_END - HOLD_AT_END), 0, 1)
        held = max(trailing - gates.expression_fades, trailing // 4)
        progress = (np.arange(1, trailing + 1) - held) / (trailing - held)
        gate[-trailing:] = 1 - depth * (1 - fade(progress))
    return gate


def mouth_between(since: Float32, until: Float32, gates: Gates, ahead: int = 999) -> Float32:
    """Mouth gate so many frames after the last speech and before the next [shape=(T,) each].

    It opens no earlier than `ahead` frames before speech.
    """
    opens = min(gates.mouth_opens, ahead)
    return np.maximum(fade(since / (gates.mouth_closes + 1)), fade(until / (opens + 1)))


def expression_between(since: Float32, until: Float32, gates: Gates, ahead: int = 999) -> Float32:
    """The same of the expression, but for the end of a take."""
    fading = fade((since - gates.expression_holds) / gates.expression_fades)
    rises = min(gates.expression_rises, ahead)
    return np.maximum(fading, fade(until / (rises + 1)))


def _distances(activity: npt.ArrayLike) -> tuple[Float32, Float32]:
    """Frames since the last and until the next speaking frame (T,) each; inf where none."""
    active = np.asarray(activity) > 0.5
    frames = np.arange(len(active), dtype=np.float32)
    last = np.maximum.accumulate(np.where(active, frames, -np.inf))
    following = np.minimum.accumulate(np.where(active, frames, np.inf)[::-1])[::-1]
    return (frames - last).astype(np.float32), (following - frames).astype(np.float32)


def fade(progress: AnyFloat) -> Float32:
    """Raised cosine from 1 (progress 0) to 0 (progress 1), flat outside."""
    faded: Float32 = 0.5 + 0.5 * np.cos(np.pi * np.clip(progress, 0, 1)).astype(np.float32)
    return faded
