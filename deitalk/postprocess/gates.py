"""Gates of mouth and expression: the shares of the motion that are shown in silence.

The *share* of the expression is 1 in speech. It rises over the half second before speech, decays
over seconds after it to the share that stays in silence (`Acting.rest`), and goes to 0 where speech
is far, so that a face is at rest in its emotion before and after it speaks. An intensity curve or
keyframes of the emotion are shown as drawn: their share is 1. The mouth has a gate of its own and
is shut in silence.

Not in the paper: in silence inside a speech it keeps "subtle emotions", by its positional encoding.
"""

import math

import numpy as np
import numpy.typing as npt

from deitalk.array_functions import Array, as_number, library, neighbours, single
from deitalk.config.rules import Gates

READY_FRAMES = 3
"""Frames before speech (0.1 s) at which the whole expression is there."""


def mouth_gate(activity: npt.ArrayLike, gates: Gates = Gates()) -> Array:
    """Share of the mouth's motion shown at each frame: 1 in speech, 0 in silence.

    Opens over the 0.17 s before speech and closes over the 0.33 s after it, in raised cosines.

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
    return mouth_between(*_distances(np.asarray(activity) > 0.5), gates)


def expression_share(activity: npt.ArrayLike, rest: float, gates: Gates = Gates()) -> Array:
    """Share of the expression shown at each frame: 1 in speech, `rest` in silence, 0 far from it.

    Parameters
    ----------
    activity, gates
        As for `mouth_gate`.
    rest : float
        Share that stays in silence, 0 to 1.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
    """
    return expression_between(*_distances(np.asarray(activity) > 0.5), rest, gates)


def gates_of(speaking: Array, rest: Array, gates: Gates | None) -> tuple[Array, Array]:
    """Mouth gate and share of the expression, as above, of frames of speech, arrays or tensors."""
    if gates is None:
        return as_number(speaking) * 0 + 1, as_number(speaking) * 0 + 1
    since, until = _distances(speaking)
    return mouth_between(since, until, gates), expression_between(since, until, rest, gates)


def mouth_between(since: Array, until: Array, gates: Gates, ahead: int = 999) -> Array:
    """Mouth gate so many frames after the last speech and before the next [shape=(T,) each].

    It opens no earlier than `ahead` frames before speech.
    """
    opens = min(gates.mouth_opens, ahead)
    after, before = fade(since / (gates.mouth_closes + 1)), fade(until / (opens + 1))
    return library(since).maximum(after, before)


def expression_between(since: Array, until: Array, rest: Array | float, gates: Gates) -> Array:
    """Share of the expression so many frames after the last speech and before the next."""
    rising = fade((until - READY_FRAMES) / (gates.feeling_rises + 1))
    return library(since).maximum(expression_after(since, until, rest, gates), rising)


def expression_after(since: Array, until: Array, rest: Array | float, gates: Gates) -> Array:
    """Share of the expression that stays after speech: its decay to `rest`, and to 0 far from any.

    Parameters
    ----------
    since, until : array or Tensor
        Frames since the last speech and until the next.
    rest : float, array or Tensor
        Share that stays in silence.
    gates : Gates
        Frames of the decay.
    """
    xp = library(since)
    kept = rest + (1 - rest) * xp.exp(-since / gates.feeling_decays)
    beyond = xp.minimum(since, until) - gates.feeling_leaves
    return single(kept * fade(beyond / (2 * gates.feeling_decays)))


def _distances(speaking: Array) -> tuple[Array, Array]:
    """Frames since the last and until the next speaking frame (T,) each; many where none."""
    frames, (last, following) = library(speaking).arange(speaking.shape[0]), neighbours(speaking)
    return single(frames - last), single(following - frames)


def fade(progress: Array) -> Array:
    """Raised cosine from 1 (progress 0) to 0 (progress 1), flat outside."""
    xp = library(progress)
    return 0.5 + 0.5 * single(xp.cos(math.pi * xp.clip(progress, 0, 1)))
