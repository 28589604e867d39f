"""A causal DEITalk on many streams at once: explicit state, one call for the next frames of all.

Letters: B streams, G groups of spectra (one a rig frame), C controls.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from deitalk.emotions import EMOTIONS
from deitalk.frontends.causal_mel import CausalMelFrontend, CausalState
from deitalk.models.curve_model import DEITalk

NEUTRAL = EMOTIONS.index("neutral")


class NetworkState(NamedTuple):
    """What the network keeps of streams between two calls; all tensors begin with the stream."""

    frontend: CausalState
    saliency: Tensor
    """Last emotion features [shape=(B, saliency_frames - 1, E)]; empty without the module."""
    neutral: tuple[Tensor, ...]
    """Of the decoder's layers, neutral reading."""
    emotional: tuple[Tensor, ...]
    """Of the decoder's layers, emotional reading."""


class NetworkRows(NamedTuple):
    """What the network gives for consecutive frames."""

    neutral: Tensor
    """[shape=(B, G, C)]."""
    emotional: Tensor
    """[shape=(B, G, C)]."""
    strength: Tensor
    """Predicted intensity [shape=(B, G), range 0 to 1]; 1 without the intensity module."""


def first_state(network: DEITalk, batch: int) -> NetworkState:
    """State of streams before their first sample."""
    frontend = causal_frontend(network).first_state(batch)
    module = network.intensity if network.config.intensity else None
    saliency = frontend.level.new_zeros(batch, 0) if module is None else module.first_past(batch)
    neutral, emotional = (network.decoder.first_past(batch) for _ in range(2))
    return NetworkState(frontend, saliency, neutral, emotional)


def causal_frontend(network: DEITalk) -> CausalMelFrontend:
    """The network's frontend, which is causal."""
    assert isinstance(network.frontend, CausalMelFrontend)
    return network.frontend


@torch.no_grad()
def begin(network: DEITalk, windows: Tensor, state: NetworkState) -> NetworkState:
    """Read the first groups of streams, as many as the frontend's `delay`: they give no frame.

    The decoder begins with the first frame, as on a whole clip. Parameters as for `advance`.
    """
    _, frontend = causal_frontend(network).advance(windows, state.frontend)
    return state._replace(frontend=frontend)


@torch.no_grad()
def advance(
    network: DEITalk, windows: Tensor, styles: Tensor, state: NetworkState
) -> tuple[NetworkRows, NetworkState]:
    """Read the next frames of streams in the neutral and in another emotion.

    Parameters
    ----------
    network : DEITalk
        With a causal frontend, in evaluation mode.
    windows : Tensor [shape=(B, G P, W)]
        Samples of the next groups of spectra.
    styles : Tensor [shape=(B, G, 5 + actors)]
        From `DEITalk.styles`, of the frames that are read: the frontend's `delay` before the
        groups.
    state : NetworkState
        From `first_state`, or from the call before.
    """
    speech, frontend = causal_frontend(network).advance(windows, state.frontend)
    guidance, saliency = None, state.saliency
    strength = speech.new_ones(speech.shape[:2])
    if network.config.intensity:
        intensity, saliency = network.intensity.advance(speech, state.saliency)
        guidance, strength = intensity.guidance, intensity.strength
    plain = styles.clone()
    plain[..., : len(EMOTIONS)] = 0
    plain[..., NEUTRAL] = 1
    both = tuple(torch.cat(pair) for pair in zip(state.neutral, state.emotional, strict=True))
    curves, past = network.decoder.advance(
        torch.cat((speech, speech)),
        torch.cat((plain, styles)),
        None if guidance is None else torch.cat((guidance, guidance)),
        both,
    )
    neutral, emotional = curves.chunk(2)
    halves = tuple(zip(*(part.chunk(2) for part in past), strict=True))
    return (
        NetworkRows(neutral, emotional, strength),
        NetworkState(frontend, saliency, halves[0], halves[1]),
    )


def take(state: NetworkState, streams: list[int]) -> NetworkState:
    """State of some streams."""
    index = torch.tensor(streams)
    return NetworkState(
        CausalState(*(part[index] for part in state.frontend)),
        state.saliency[index],
        tuple(part[index] for part in state.neutral),
        tuple(part[index] for part in state.emotional),
    )


def put(state: NetworkState, streams: list[int], new: NetworkState) -> None:
    """Replace the state of some streams, in place."""
    index = torch.tensor(streams)
    for old, part in zip(_tensors(state), _tensors(new), strict=True):
        old[index] = part


def _tensors(state: NetworkState) -> tuple[Tensor, ...]:
    return (*state.frontend, state.saliency, *state.neutral, *state.emotional)
