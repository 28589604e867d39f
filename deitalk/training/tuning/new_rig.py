"""First weights of a decoder for a new rig: regressions of the captured curves.

Letters: T frames, H inputs of the last layer, C controls.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from deitalk.models.rig_decoder import RigDecoder
from rig.arrays import Float32, Float64

RIDGE = 1000.0
"""Of the last layer, squared units of its input."""
RANGE_ROWS = 0.02
"""Share of an actor's frames, as if the gain of every control were 1 in them."""


class CapturedRows(NamedTuple):
    """A clip as the last layer is given it.

    Attributes
    ----------
    actor : str
    hidden : ndarray [shape=(T, H)]
    curves : ndarray [shape=(T, C)]
    """

    actor: str
    hidden: Float32
    curves: Float32


@torch.no_grad()
def fit_decoder(decoder: RigDecoder, rows: Sequence[CapturedRows], actors: Sequence[str]) -> None:
    """Fit the last layer by ridge regression, and the ranges of the actors to what it predicts.

    Parameters
    ----------
    decoder : RigDecoder
        Changed in place.
    rows : sequence of CapturedRows
        All clips to train on.
    actors : sequence of str
        Those of the model, in its order.
    """
    x = np.concatenate([row.hidden for row in rows]).astype(np.float64)
    y = np.concatenate([row.curves for row in rows]).astype(np.float64)
    mean, centre = x.mean(axis=0), y.mean(axis=0)
    x -= mean
    weight = np.linalg.solve(x.T @ x + RIDGE * np.eye(x.shape[1]), x.T @ (y - centre))
    bias = centre - mean @ weight
    decoder.output.weight.copy_(torch.from_numpy(weight.T))
    decoder.output.bias.copy_(torch.from_numpy(bias))
    if decoder.ranges is None:
        return
    for place, actor in enumerate(actors):
        own = [row for row in rows if row.actor == actor]
        if own:
            given = np.concatenate([row.hidden @ weight + bias for row in own])
            wanted = np.concatenate([row.curves for row in own]).astype(np.float64)
            gain, offset = actor_range(given, wanted)
            decoder.ranges.gains[place].copy_(torch.from_numpy(gain - 1))
            decoder.ranges.offsets[place].copy_(torch.from_numpy(offset))


def actor_range(given: Float64, wanted: Float64) -> tuple[Float64, Float64]:
    """Gain and offset that bring predictions for all actors to one actor's curves.

    Least squares of every control, held at a gain of 1 by `RANGE_ROWS`.

    Parameters
    ----------
    given, wanted : ndarray [shape=(T, C)]
        Predicted and captured.

    Returns
    -------
    gain, offset : ndarray [shape=(C,)]
    """
    centre, aim = given.mean(axis=0), wanted.mean(axis=0)
    moved = given - centre
    held = RANGE_ROWS * len(given) * given.var(axis=0).mean()
    square = (moved**2).sum(axis=0) + held
    gain = ((moved * (wanted - aim)).sum(axis=0) + held) / np.maximum(square, 1e-12)
    return gain, aim - gain * centre
