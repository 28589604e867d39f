"""First weights of a decoder's layers for a new rig: ridge regressions of the captured curves.

Letters: T frames, D features, H inputs of the last layer, C controls.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deitalk.data.lips.regression import LipRidge
from deitalk.models.rig_decoder import DirectPath, RigDecoder
from rig.arrays import Float32, Float64

LAST_LAYER_RIDGE = 1000.0
"""Squared units of the input of the last layer."""
DIRECT_RIDGE = 30_000.0
"""Of standardised features; on takes that were left out, 10,000 is as good and 3,000 worse."""
RANGE_ROWS = 0.02
"""Share of an actor's frames, as if the range of every control were 1 in them."""


class CapturedRows(NamedTuple):
    """A clip as the decoder is given it.

    Attributes
    ----------
    actor : str
    speech : ndarray [shape=(T, D)]
        With its positional encoding.
    hidden : ndarray [shape=(T, H)]
        Input of the last layer.
    curves : ndarray [shape=(T, C)]
    """

    actor: str
    speech: Float32
    hidden: Float32
    curves: Float32


@torch.no_grad()
def fit_decoder(decoder: RigDecoder, rows: Sequence[CapturedRows], actors: Sequence[str]) -> None:
    """Fit the direct path and the actors' ranges, or, without a direct path, the last layer.

    Parameters
    ----------
    decoder : RigDecoder
        Changed in place. With a direct path the last layer begins at 0.
    rows : sequence of CapturedRows
        All clips to train on.
    actors : sequence of str
        Those of the model, in its order.
    """
    if decoder.direct is None:
        weight, bias = _last_layer(rows)
    else:
        _fit_direct(decoder.direct, rows, actors)
        weight, bias = 0 * decoder.output.weight, 0 * decoder.output.bias
    decoder.output.weight.copy_(weight)
    decoder.output.bias.copy_(bias)


def _last_layer(rows: Sequence[CapturedRows]) -> tuple[Tensor, Tensor]:
    x = torch.from_numpy(np.concatenate([row.hidden for row in rows])).double()
    y = torch.from_numpy(np.concatenate([row.curves for row in rows])).double()
    mean, centre = x.mean(dim=0), y.mean(dim=0)
    x = x - mean
    square = x.T @ x + LAST_LAYER_RIDGE * torch.eye(x.shape[1], dtype=x.dtype)
    weight = torch.linalg.solve(square, x.T @ (y - centre)).T
    return weight, centre - weight @ mean


def _fit_direct(direct: DirectPath, rows: Sequence[CapturedRows], actors: Sequence[str]) -> None:
    recordings = [(row.actor, row.speech, row.curves) for row in rows]
    found = LipRidge.fit(recordings, ridge=DIRECT_RIDGE)
    weights = found.weights / found.scale[:, None]
    direct.map.weight.copy_(torch.from_numpy(weights.T))
    direct.map.bias.copy_(torch.from_numpy(found.constant - found.mean @ weights))
    for place, actor in enumerate(actors):
        own = [row for row in rows if row.actor == actor]
        if own:
            given = np.concatenate([found(row.speech) for row in own]).astype(np.float64)
            wanted = np.concatenate([row.curves for row in own]).astype(np.float64)
            gain, offset = actor_range(given, wanted)
            direct.gains[place].copy_(torch.from_numpy(gain - 1))
            direct.offsets[place].copy_(torch.from_numpy(offset))


def actor_range(given: Float64, wanted: Float64) -> tuple[Float64, Float64]:
    """Gain and offset that bring predictions of all actors to one actor's curves.

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
