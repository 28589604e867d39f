"""A causal DEITalk on many streams at once, as a `CausalNetwork`.

Letters: B streams, G groups of spectra (one a rig frame), P spectra of a group, W samples of a
spectrum, C controls.
"""

from collections.abc import Sequence
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
    put,
    take,
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
    decoder: tuple[Tensor, ...]
    """Of the decoder's layers, neutral and emotional reading [shape=(B, 2, span, channels)]."""
    lips: tuple[Tensor, ...] = ()
    """Of the readout of the lips, where there is one."""

    def tensors(self) -> tuple[Tensor, ...]:
        """All of them, in a row."""
        return (*self.frontend.tensors(), self.saliency, *self.decoder, *self.lips)

    @classmethod
    def of(cls, tensors: tuple[Tensor, ...], model: DEITalk) -> "TensorState":
        """The state of a model that `tensors` gave."""
        count = len(causal_frontend(model).rings)
        frontend, saliency, *rest = CausalState.of(tensors[:count]), *tensors[count:]
        layers = len(rest) - (model.lips is not None)
        return cls(frontend, saliency, tuple(rest[:layers]), tuple(rest[layers:]))


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
    def begin(self, windows: Float32, state: State, streams: Sequence[int]) -> None:
        """Read the first groups."""
        self._hear(windows, state, streams)

    @torch.no_grad()
    def advance(
        self, windows: Float32, styles: Float32, state: State, streams: Sequence[int]
    ) -> NetworkRows:
        """Read the next frames."""
        speech = self._hear(windows, state, streams)
        count = len(causal_frontend(self.model).rings)
        before = TensorState.of(take(state, streams), self.model)
        rows, after = decode(self.model, speech, self._given(styles), before)
        put(state[count:], streams, after.tensors()[count:])
        *curves, saliency, strength, effort = rows
        # One array crosses the bus: columns of the readings, then of the tracks.
        tracks = torch.stack((saliency, strength, effort), dim=-1)
        columns = torch.cat((*curves, tracks), dim=-1).cpu().numpy()
        size = len(self.controls)
        both = columns[..., :size], columns[..., size : 2 * size]
        return NetworkRows(*both, *np.moveaxis(columns[..., 2 * size :], -1, 0))

    def _hear(self, windows: Float32, state: State, streams: Sequence[int]) -> Tensor:
        """Features (B, G, D) of the next groups; changes the state of the frontend."""
        frontend = causal_frontend(self.model)
        before = take(state[: len(frontend.rings)], streams)
        speech, new = frontend.hear(self._given(windows), CausalState.of(before))
        put(state, streams, new.tensors(), frontend.rings)
        return speech

    def _given(self, values: Float32) -> Tensor:
        return torch.from_numpy(values).to(self.model.device)


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
    decoder = tuple(torch.stack((x, x), dim=1) for x in model.rig_decoder.first_past(batch))
    lips = () if model.lips is None else (model.lips.first_past(batch),)
    return TensorState(frontend, saliency, decoder, lips)


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
    curves, past = model.rig_decoder.advance(
        _twice(speech),
        torch.stack((plain, styles), dim=1),
        None if guidance is None else _twice(guidance),
        state.decoder,
    )
    pair = curves.transpose(0, 1)
    lips: tuple[Tensor, ...] = ()
    if model.lips is not None:
        pair = model.lips.correct(pair, model.lips(speech, state.lips[0]))
        lips = (model.lips.next_past(state.lips[0], speech),)
    neutral, emotional = pair
    rows = TensorRows(neutral, emotional, saliency, strength, effort)
    return rows, TensorState(state.frontend, kept, past, lips)


def _twice(rows: Tensor) -> Tensor:
    """Rows (B, G, D) for both readings (B, 2, G, D)."""
    return rows.unsqueeze(1).expand(-1, 2, -1, -1)
