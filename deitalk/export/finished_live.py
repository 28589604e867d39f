"""Next frame of live voices to finished curves: a frame a call, all state in one tensor.

Letters: B streams, S samples, A actors, C controls, N numbers of the state.
"""

import math
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils import _pytree as tree

from deitalk.array_functions import like
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.log_mel import N_FFT
from deitalk.audio.voice_activity import WINDOW
from deitalk.emotions import LABELS
from deitalk.export.finished import MIXTURES
from deitalk.export.sound_measures import BandLevels, WindowProsody
from deitalk.live.analysis import N_SOUND, FrameMeasures, VoiceAnalysis
from deitalk.models.causal_model import TensorState, advance, causal_frontend, first_state, grid_of
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.network_graph import causal_graph
from deitalk.postprocess.curve_pass import CurvePass
from deitalk.postprocess.factors import (
    expression_scale,
    held_intensity,
)
from deitalk.postprocess.feeling import felt_intensity
from deitalk.postprocess.torch_columns import constant
from deitalk.postprocess.tracks import VoiceTracks

WRAP = 720
"""Frames after which a counter goes back by half: a multiple of all periods."""


class FinishedLive(nn.Module):
    """The next frame of streams to finished curves.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend.

    Attributes
    ----------
    window : int
        Samples of a call, from `before` ahead of the time of the frame that is measured on.
    behind : int
        Frames by which the curves are behind it.
    """

    offsets: Tensor

    def __init__(self, model: DEITalk) -> None:
        super().__init__()
        self.model, grid = causal_graph(model), grid_of(model)
        self.delay, self.behind = grid.delay, grid.delay + grid.rules_ahead
        self.levels, self.prosody = BandLevels(), WindowProsody()
        self.analysis = VoiceAnalysis(model.rules, grid)
        self.rules = CurvePass(model.controls, model.rules, grid.rules_ahead)
        self.before = WINDOW // 2
        # Samples of the spectra in a window, of the frames 3 n, 3 n + 1 and 3 n + 2.
        frames = np.arange(3)[:, None]
        centres = np.round(
            (frames * grid.spectra + np.arange(grid.spectra) - grid.lead) * SAMPLE_RATE / grid.rate
        )
        starts = centres - frames * SAMPLE_RATE // FRAME_RATE + self.before - grid.length // 2
        self.window = max(WINDOW, int(starts.max()) + grid.length)
        constant(self, "offsets", starts.astype(np.int64))
        constant(self, "trained", MIXTURES)
        first, self.shape = tree.tree_flatten(self.first_states(1))
        self.sizes = [part.shape[1:] for part in first]
        self.begins = [bool((part != 0).any()) for part in first]
        for k, part in enumerate(first):
            if self.begins[k]:
                row = part.reshape(1, -1)
                is_one = bool((row == row[0, 0]).all())
                constant(self, f"begin_{k}", (row[:, :1] if is_one else row).numpy())

    def first_states(self, batch: int) -> Any:
        """State of streams before their first sample, in its parts.

        The frame that is measured next; state of the network, of the analysis, and of the rules.
        """
        low = torch.finfo(torch.float32).min
        network = (part.clamp_min(low) for part in first_state(self.model, batch).tensors())
        frame = torch.zeros(batch, 1)
        return (
            frame,
            tuple(network),
            tuple(like(part, frame) for part in self.analysis.first(batch)),
            self.rules.first(batch),
        )

    def first(self, batch: int) -> Tensor:
        """State before the first call (B, N)."""
        return torch.zeros(batch, sum(math.prod(size) for size in self.sizes))

    def forward(
        self,
        sound: Tensor,
        emotion: Tensor,
        intensity: Tensor,
        variants: Tensor,
        motion: Tensor,
        state: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Take the sound of a frame, and finish the one `behind` it.

        Parameters
        ----------
        sound : Tensor [shape=(B, window)]
            16 kHz, any level.
        emotion : Tensor [shape=(B, 9 + A)]
            Weights of the emotions, then of the actors, of the frame `delay` before.
        intensity : Tensor [shape=(B, 2)]
            Of the same frame: factor on the intensity of the voice, and share of the expression
            that stays in silence.
        variants : Tensor [shape=(B, V + 1)]
            Of the same frame, as for a recording.
        motion : Tensor [shape=(B, M)]
            `deitalk.postprocess.tracks.MotionTracks` of the frame that comes out; zeros: none.
        state : Tensor [shape=(B, N)]
            Of the call before; zeros before the first.

        Returns
        -------
        curves : Tensor [shape=(B, C)]
        intensity : Tensor [shape=(B,)]
            Of the voice, of the frame `delay` before.
        state : Tensor [shape=(B, N)]
        """
        parts = torch.split(state, [math.prod(size) for size in self.sizes], dim=1)
        old = [self._begun(k, part, state[:, :1] > 0) for k, part in enumerate(parts)]
        shaped = [part.reshape(-1, *size) for part, size in zip(old, self.sizes, strict=True)]
        frame, network, analysed, rules = tree.tree_unflatten(shaped, self.shape)
        # The network: two readings of the frame `delay` before.
        labels, actors = emotion[:, : len(LABELS)], emotion[:, len(LABELS) :]
        styles = torch.cat((labels @ cast(Tensor, self.trained), actors), dim=1)
        before = TensorState.of(network, self.model)
        rows, next_network = advance(
            self.model, self._spectra(sound, frame), styles[:, None], before
        )
        # Measures of its voice.
        begun = frame >= self.delay
        factor, rest = intensity.unbind(1)
        rest = torch.where(begun[:, 0], rest, torch.zeros_like(rest))
        window = sound[:, :WINDOW]
        measured = FrameMeasures.of_rows(self.levels(window), self.prosody(window), 1)
        found, measures = self.analysis(measured, rows.strength, rows.effort, rest, analysed)
        held, scale, felt = rows.strength, factor[:, None], found.intensity
        rule = self.model.rules.voice_intensity
        labels = labels[:, None]
        if rule is not None:
            felt = felt_intensity(felt, labels, rule)
            held = held_intensity(
                self.model.rules.expressions,
                self.model.controls,
                rows.neutral,
                rows.emotional,
                labels,
                rows.strength,
            )
            scale = expression_scale(felt * factor[:, None], held)
        phones, (back, kept, _) = torch.zeros_like(labels[..., :4]), found.held
        ways, side = variants[:, None, :-1], variants[:, None, -1]
        voice = VoiceTracks(
            scale, found.opening, held, phones, labels, back, kept, ways, side, felt
        ).columns()
        # The rules.
        gates = torch.cat((found.mouth, found.expression), dim=1)
        shown = torch.cat((gates, motion), dim=1)[:, None]
        gain, ruled = torch.ones_like(rows.neutral[:, 0]), torch.ones_like(factor)
        curves, _, _, finished = self.rules(
            rows.neutral, rows.emotional, voice, shown, gain, ruled, rules
        )
        frame = frame + 1
        frame = torch.where(frame >= WRAP, frame - WRAP // 2, frame)
        carried = frame, tuple(next_network.tensors()), measures, finished
        new = [
            part.flatten(1) if part.dim() > 1 else part[:, None]
            for part in tree.tree_leaves(carried)
        ]
        # Before the first frame only the sound counts, not what is read and finished of it.
        decoder = 1 + len(causal_frontend(self.model).rings)
        sound_end = 1 + len(network) + N_SOUND
        blocks = []
        for first, stop, waits in (
            (0, decoder, False),
            (decoder, 1 + len(network), True),
            (1 + len(network), sound_end, False),
            (sound_end, len(new), True),
        ):
            block = torch.cat(new[first:stop], dim=1)
            if waits:
                block = torch.where(begun, block, torch.cat(old[first:stop], dim=1))
            blocks.append(block)
        return curves[:, 0], found.intensity[:, 0], torch.cat(blocks, dim=1)

    def _begun(self, number: int, part: Tensor, has_begun: Tensor) -> Tensor:
        """A part of the state (B, ...), with its first value where no frame has come."""
        if not self.begins[number]:
            return part
        return torch.where(has_begun, part, cast(Tensor, getattr(self, f"begin_{number}")))

    def _spectra(self, sound: Tensor, frame: Tensor) -> Tensor:
        """Samples of the spectra of the frame (B, P, 400)."""
        starts = self.offsets[torch.remainder(frame[:, 0], 3).long()]
        places = starts[:, :, None] + torch.arange(N_FFT)
        rows = torch.gather(sound, 1, places.flatten(1))
        return rows.view(-1, starts.shape[1], N_FFT)
