"""A causal DEITalk on many streams at once, as a `CausalNetwork`.

Letters: B streams, G groups of spectra (one a rig frame), P spectra of a group, W samples of a
spectrum, C controls.
"""

from typing import NamedTuple, Self, cast

import numpy as np
import torch
from torch import Tensor

from deitalk.audio.log_mel import N_FFT
from deitalk.config.rules import RulesConfig
from deitalk.emotions import EMOTIONS
from deitalk.frontends.causal_whisper import CausalState, CausalWhisperFrontend
from deitalk.models.curve_model import DEITalk
from deitalk.models.protocol import (
    NetworkRows,
    Product,
    SpectraGrid,
    State,
)
from deitalk.postprocess.curve_pass import TorchPass
from rig import ControlSet
from rig.arrays import Float32

NEUTRAL = EMOTIONS.index("neutral")


class TensorState(NamedTuple):
    """What the network keeps of streams between two calls; all tensors begin with the stream."""

    frontend: CausalState
    saliency: Tensor
    """Last emotion features [shape=(B, saliency_frames - 1, E)]; empty without the module."""
    neutral: tuple[Tensor, ...]
    """Of the decoder's layers, neutral reading."""
    emotional: tuple[Tensor, ...]
    """Of the decoder's layers, emotional reading."""
    lips: tuple[Tensor, ...] = ()
    """Of the readout of the lips, where there is one."""

    def tensors(self) -> tuple[Tensor, ...]:
        """All of them, in a row."""
        decoders = *self.neutral, *self.emotional
        return (*self.frontend.tensors(), self.saliency, *decoders, *self.lips)

    @classmethod
    def of(cls, tensors: tuple[Tensor, ...], n_frontend: int) -> "TensorState":
        """The state that `tensors` gave, so many of them of the frontend."""
        frontend, rest = CausalState.of(tensors[:n_frontend]), tensors[n_frontend + 1 :]
        layers = len(rest) // 2
        decoders = rest[:layers], rest[layers : 2 * layers]
        return cls(frontend, tensors[n_frontend], *decoders, rest[2 * layers :])


class TensorRows(NamedTuple):
    """As `NetworkRows`."""

    neutral: Tensor
    emotional: Tensor
    saliency: Tensor
    strength: Tensor
    effort: Tensor


class TorchNetwork:
    """A causal DEITalk as a `CausalNetwork`.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend, in evaluation mode.
    """

    product: Product = "curves"
    is_causal = True

    def __init__(self, model: DEITalk) -> None:
        self.model = model
        self.controls: ControlSet = model.controls
        self.rules: RulesConfig = model.rules
        self.actors: tuple[str, ...] = model.actors
        self.emotions: tuple[str, ...] = model.emotions
        self.grid, self.device = grid_of(model), str(model.device)

    def eval(self) -> Self:
        """The network, its model in evaluation mode."""
        self.model.eval()
        return self

    def curve_pass(self, *, live: bool = False) -> TorchPass:
        """Rules after the network."""
        return self.model.curve_pass(live=live)

    @torch.no_grad()
    def first_state(self, batch: int) -> State:
        """See `CausalNetwork`; so the other methods. States stay on the model's device."""
        return tuple(part.clone() for part in first_state(self.model, batch).tensors())

    @torch.no_grad()
    def begin(self, windows: Float32, state: State) -> State:
        """Read the first groups."""
        before, frontend = self._state(state), causal_frontend(self.model)
        _, kept = frontend.advance(self._given(windows), before.frontend)
        return before._replace(frontend=kept).tensors()

    @torch.no_grad()
    def advance(self, windows: Float32, styles: Float32, state: State) -> tuple[NetworkRows, State]:
        """Read the next frames."""
        given = self._given(windows), self._given(styles)
        rows, after = advance(self.model, *given, self._state(state))
        *curves, saliency, strength, effort = rows
        # One array crosses the bus: columns of the readings, then of the tracks.
        tracks = torch.stack((saliency, strength, effort), dim=-1)
        columns = torch.cat((*curves, tracks), dim=-1).cpu().numpy()
        size = len(self.controls)
        both = columns[..., :size], columns[..., size : 2 * size]
        return NetworkRows(*both, *np.moveaxis(columns[..., 2 * size :], -1, 0)), after.tensors()

    def _given(self, values: Float32) -> Tensor:
        return torch.from_numpy(values).to(self.model.device)

    def _state(self, state: State) -> TensorState:
        return TensorState.of(state, causal_frontend(self.model).n_states)


def grid_of(model: DEITalk) -> SpectraGrid:
    """Where the spectra of a causal model lie."""
    frontend = causal_frontend(model)
    looks = frontend.delay, frontend.lead, frontend.rules_ahead
    return SpectraGrid(frontend.spectra, N_FFT, *looks)


def first_state(model: DEITalk, batch: int) -> TensorState:
    """State of streams before their first sample."""
    frontend = causal_frontend(model).first_state(batch)
    module = model.intensity if model.config.intensity else None
    saliency = frontend.level.new_zeros(batch, 0) if module is None else module.first_past(batch)
    neutral, emotional = (model.rig_decoder.first_past(batch) for _ in range(2))
    lips = () if model.lips is None else (model.lips.first_past(batch),)
    return TensorState(frontend, saliency, neutral, emotional, lips)


def causal_frontend(model: DEITalk) -> CausalWhisperFrontend:
    """The model's frontend, which is causal."""
    return cast("CausalWhisperFrontend", model.frontend)


def advance(
    model: DEITalk, windows: Tensor, styles: Tensor, state: TensorState
) -> tuple[TensorRows, TensorState]:
    """Read the next frames of streams in the neutral and in another emotion.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend, in evaluation mode.
    windows : Tensor [shape=(B, G P, W)]
        Samples of the next groups of spectra.
    styles : Tensor [shape=(B, G, 5 + actors)]
        Of the frames that are read: the frontend's `delay` before the groups.
    state : TensorState
        From `first_state`, or from the call before.
    """
    speech, frontend = causal_frontend(model).advance(windows, state.frontend)
    return decode(model, speech, styles, state._replace(frontend=frontend))


def decode(
    model: DEITalk, speech: Tensor, styles: Tensor, state: TensorState
) -> tuple[TensorRows, TensorState]:
    """`advance` after the frontend: its features (B, G, D), and its state for the next call."""
    guidance, kept = None, state.saliency
    strength = speech.new_ones(speech.shape[:2])
    saliency = effort = speech.new_zeros(speech.shape[:2])
    if model.config.intensity:
        intensity, kept = model.intensity.advance(speech, state.saliency)
        guidance, saliency = intensity.guidance, intensity.saliency
        strength = intensity.strength
        effort = effort if intensity.effort is None else intensity.effort
    neutral_style = torch.eye(len(EMOTIONS), device=styles.device)[NEUTRAL]
    plain = 0 * styles[..., : len(EMOTIONS)] + neutral_style
    plain = torch.cat((plain, styles[..., len(EMOTIONS) :]), dim=-1)
    both = tuple(torch.cat(pair) for pair in zip(state.neutral, state.emotional, strict=True))
    curves, past = model.rig_decoder.advance(
        torch.cat((speech, speech)),
        torch.cat((plain, styles)),
        None if guidance is None else torch.cat((guidance, guidance)),
        both,
    )
    pair = torch.stack(curves.chunk(2))
    lips: tuple[Tensor, ...] = ()
    if model.lips is not None:
        pair = model.lips.correct(pair, model.lips(speech, state.lips[0]))
        lips = (model.lips.next_past(state.lips[0], speech),)
    neutral, emotional = pair
    halves = tuple(zip(*(part.chunk(2) for part in past), strict=True))
    return (
        TensorRows(neutral, emotional, saliency, strength, effort),
        TensorState(state.frontend, kept, halves[0], halves[1], lips),
    )
