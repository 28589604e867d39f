"""A causal DEITalk on many streams at once, as a `CausalNetwork`.

Letters: B streams, G groups of spectra (one a rig frame), P spectra of a group, W samples of a
spectrum, C controls.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Self, cast

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.audio.log_mel import N_FFT
from deitalk.audio.running_level import levelled
from deitalk.config.rules import RulesConfig
from deitalk.emotions import EMOTIONS
from deitalk.frontends.causal_whisper import CausalState, CausalWhisperFrontend
from deitalk.models.curve_model import DEITalk
from deitalk.models.frozen import frozen
from deitalk.models.protocol import (
    NetworkRows,
    Product,
    SpectraGrid,
    State,
)
from deitalk.models.streams import StreamedNetwork
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


class TorchNetwork(StreamedNetwork):
    """A causal DEITalk as a `CausalNetwork`.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend, in evaluation mode.
    lasts : bool
        Whether it reads for minutes, as it is now: it then begins half a second later, and reads
        in a sixth less (`deitalk.models.frozen`).
    """

    product: Product = "curves"
    is_causal = True

    def __init__(self, model: DEITalk, *, lasts: bool = False) -> None:
        self.model, self.lasts = model, lasts
        self.controls: ControlSet = model.controls
        self.rules: RulesConfig = model.rules
        self.actors: tuple[str, ...] = model.actors
        self.emotions: tuple[str, ...] = model.emotions
        self.grid, self.device = grid_of(model), str(model.device)
        self.rings = causal_frontend(model).rings
        step = CausalStep(model)
        self.step: Callable[..., Any] = frozen(step, step_example(model)) if lasts else step

    def eval(self) -> Self:
        """The network, its model in evaluation mode."""
        self.model.eval()
        return self

    def curve_pass(self, *, live: bool = False) -> TorchPass:
        """Rules after the network."""
        found = self.model.curve_pass(live=live)
        if not self.lasts:
            return found
        return TorchPass(found.rules, frozen(found.rules, found.rules.example()))

    @torch.no_grad()
    def first_state(self, batch: int) -> State:
        """See `CausalNetwork`. States stay on the model's device."""
        return tuple(part.clone() for part in first_state(self.model, batch).tensors())

    @torch.no_grad()
    def _next(self, windows: Float32, styles: Float32, state: State) -> tuple[NetworkRows, State]:
        level, *kept = state
        given, level = levelled(self._given(windows), self.grid.spectra, level)
        found = self.step(given, self._given(styles), *kept)
        emotional, neutral, *tracks = found[: len(NetworkRows._fields)]
        # One array crosses the bus: columns of the readings, then of the tracks.
        columns = torch.cat((neutral, emotional, torch.stack(tracks, dim=-1)), dim=-1).cpu().numpy()
        size = len(self.controls)
        both = columns[..., :size], columns[..., size : 2 * size]
        rows = NetworkRows(*both, *np.moveaxis(columns[..., 2 * size :], -1, 0))
        return rows, (level, *found[len(NetworkRows._fields) :])

    def _given(self, values: Float32) -> Tensor:
        return torch.from_numpy(values).to(self.model.device)


class CausalStep(nn.Module):
    """A causal curve model, the next G frames of B streams.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend.
    """

    def __init__(self, model: DEITalk) -> None:
        super().__init__()
        self.model = model

    def forward(self, windows: Tensor, emotion: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        """Predict the next frames.

        Parameters
        ----------
        windows : Tensor [shape=(B, G P, W)]
            Samples of the spectra of the frames, at the usual level.
        emotion : Tensor [shape=(B, G, 5 + actors)]
            Weights of the styles.
        state : Tensor
            From the call before, but the level. Of rings the new rows alone are returned.
        """
        before = TensorState.of((windows.new_zeros(0), *state), self.model)
        speech, new = causal_frontend(self.model).read(windows, before.frontend)
        rows, after = decode(self.model, speech, emotion, before._replace(frontend=new))
        frames = (rows.emotional, rows.neutral, rows.saliency, rows.strength, rows.effort)
        return (*frames, *after.tensors()[1:])


def step_example(model: DEITalk, batch: int = 2, n_frames: int = 3) -> tuple[Tensor, ...]:
    """Inputs of `CausalStep`, for a trace of it."""
    grid, state = grid_of(model), first_state(model, batch).tensors()[1:]
    windows = state[0].new_zeros(batch, n_frames * grid.spectra, grid.length)
    styles = windows.new_full((batch, n_frames, len(EMOTIONS) + len(model.actors)), 0.2)
    return windows, styles, *state


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


def decode(
    model: DEITalk, speech: Tensor, styles: Tensor, state: TensorState
) -> tuple[NetworkRows, TensorState]:
    """The next frames of streams, in the neutral and in another emotion.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend, in evaluation mode.
    speech : Tensor [shape=(B, G, D)]
        Features of the frontend.
    styles : Tensor [shape=(B, G, 5 + actors)]
        Of these frames.
    state : TensorState
        From `first_state` or the call before; that of the frontend is returned as it is.
    """
    guidance, kept = None, state.saliency
    strength = speech.new_ones(speech.shape[:2])
    saliency = effort = speech.new_zeros(speech.shape[:2])
    if model.config.intensity:
        intensity, kept = model.intensity.advance(speech, state.saliency)
        guidance, saliency = intensity.guidance, intensity.saliency
        strength = intensity.strength
        effort = effort if intensity.effort is None else intensity.effort
    curves, past = model.rig_decoder.advance(
        _twice(speech),
        torch.stack((plain_styles(styles), styles), dim=1),
        None if guidance is None else _twice(guidance),
        state.decoder,
    )
    pair = curves.transpose(0, 1)
    lips: tuple[Tensor, ...] = ()
    if model.lips is not None:
        pair = model.lips.correct(pair, model.lips(speech, state.lips[0]))
        lips = (model.lips.next_past(state.lips[0], speech),)
    neutral, emotional = pair
    rows = NetworkRows(neutral, emotional, saliency, strength, effort)
    return rows, TensorState(state.frontend, kept, past, lips)


def plain_styles(styles: Tensor) -> Tensor:
    """Styles (..., 5 + actors) of the neutral reading, of the same actor."""
    emotions, actors = styles[..., : len(EMOTIONS)], styles[..., len(EMOTIONS) :]
    neutral = torch.eye(len(EMOTIONS), device=styles.device)[NEUTRAL]
    return torch.cat((0 * emotions + neutral, actors), dim=-1)


def _twice(rows: Tensor) -> Tensor:
    """Rows (B, G, D) for both readings (B, 2, G, D)."""
    return rows.unsqueeze(1).expand(-1, 2, -1, -1)
