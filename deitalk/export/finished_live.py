"""Next frames of live voices to finished curves, all state in one tensor.

Letters: B streams, G frames of a call, S samples, P spectra of a frame, A actors, C controls,
N numbers of the state. A call of one frame has no axis of frames.
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
from deitalk.models.causal_model import TensorState, causal_frontend, decode, first_state, grid_of
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
    """The next frames of streams to finished curves.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend.
    n_frames : int
        Frames of a call: a divisor of the frames that the network looks ahead.

    Attributes
    ----------
    window : int
        Samples of a call, from `before` ahead of the time of its first frame on.
    behind : int
        Frames by which the curves are behind the frames that are measured.
    """

    measured: Tensor
    heard: Tensor

    def __init__(self, model: DEITalk, n_frames: int = 1) -> None:
        super().__init__()
        self.n_frames = n_frames
        self.model, grid = causal_graph(model), grid_of(model)
        self.delay, self.behind = grid.delay, grid.delay + grid.rules_ahead
        self.levels, self.prosody = BandLevels(), WindowProsody()
        self.analysis = VoiceAnalysis(model.rules, grid)
        self.rules = CurvePass(model.controls, model.rules, grid.rules_ahead)
        self.before = WINDOW // 2
        # Samples of a call of which frames are measured, and those of their spectra, where the
        # first frame is 3 n, 3 n + 1 or 3 n + 2.
        phase, number = np.arange(3)[:, None], np.arange(n_frames)
        begin = phase * SAMPLE_RATE // FRAME_RATE - self.before
        windows = (phase + number) * SAMPLE_RATE // FRAME_RATE - self.before - begin
        spectra = phase * grid.spectra + np.arange(n_frames * grid.spectra) - grid.lead
        centres = np.round(spectra * SAMPLE_RATE / grid.rate).astype(np.int64)
        starts = centres - grid.length // 2 - begin
        self.window = max(int(windows.max()) + WINDOW, int(starts.max()) + grid.length)
        constant(self, "measured", windows)
        constant(self, "heard", starts)
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
        """Take the sound of frames, and finish those `behind` them.

        Parameters
        ----------
        sound : Tensor [shape=(B, window)]
            16 kHz, any level.
        emotion : Tensor [shape=(B, G, 9 + A)]
            Weights of the emotions, then of the actors, of the frames `delay` before.
        intensity : Tensor [shape=(B, 2)]
            Of the same frames: factor on the intensity of the voice, and share of the expression
            that stays in silence.
        variants : Tensor [shape=(B, G, V + 1)]
            Of the same frames, as for a recording.
        motion : Tensor [shape=(B, G, M)]
            `deitalk.postprocess.tracks.MotionTracks` of the frames that come out; zeros: none.
        state : Tensor [shape=(B, N)]
            Of the call before; zeros before the first.

        Returns
        -------
        curves : Tensor [shape=(B, G, C)]
        intensity : Tensor [shape=(B, G)]
            Of the voice, of the frames `delay` before.
        state : Tensor [shape=(B, N)]
        """
        emotion, variants, motion = (
            part.reshape(-1, self.n_frames, part.shape[-1]) for part in (emotion, variants, motion)
        )
        parts = torch.split(state, [math.prod(size) for size in self.sizes], dim=1)
        old = [self._begun(k, part, state[:, :1] > 0) for k, part in enumerate(parts)]
        shaped = [part.reshape(-1, *size) for part, size in zip(old, self.sizes, strict=True)]
        frame, network, analysed, rules = tree.tree_unflatten(shaped, self.shape)
        phase = torch.remainder(frame[:, 0], 3).long()
        # The network: two readings of the frames `delay` before.
        labels, actors = emotion[..., : len(LABELS)], emotion[..., len(LABELS) :]
        styles = torch.cat((labels @ cast(Tensor, self.trained), actors), dim=2)
        before = TensorState.of(network, self.model)
        spectra = _windows(sound, self.heard[phase], N_FFT)
        speech, heard = causal_frontend(self.model).advance(spectra, before.frontend)
        before = before._replace(frontend=heard)
        rows, next_network = decode(self.model, speech, styles, before)
        # Measures of their voice.
        begun = frame >= self.delay
        factor, rest = intensity.unbind(1)
        rest = torch.where(begun[:, 0], rest, torch.zeros_like(rest))
        windows = _windows(sound, self.measured[phase], WINDOW).flatten(0, 1)
        measured = FrameMeasures.of_rows(self.levels(windows), self.prosody(windows), self.n_frames)
        found, measures = self.analysis(measured, rows.strength, rows.effort, rest, analysed)
        factor = factor[:, None].expand(-1, self.n_frames)
        held, scale, felt = rows.strength, factor, found.intensity
        rule = self.model.rules.voice_intensity
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
            scale = expression_scale(felt * factor, held)
        phones, (back, kept, _) = torch.zeros_like(labels[..., :4]), found.held
        ways, side = variants[..., :-1], variants[..., -1]
        voice = VoiceTracks(
            scale, found.opening, held, phones, labels, back, kept, ways, side, felt
        ).columns()
        # The rules.
        gates = torch.stack((found.mouth, found.expression), dim=2)
        shown = torch.cat((gates, motion), dim=2)
        gain, ruled = torch.ones_like(rows.neutral[:, 0]), torch.ones_like(rest)
        curves, _, _, finished = self.rules(
            rows.neutral, rows.emotional, voice, shown, gain, ruled, rules
        )
        frame = frame + self.n_frames
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
        is_one = self.n_frames == 1
        given = [part[:, 0] if is_one else part for part in (curves, found.intensity)]
        return given[0], given[1], torch.cat(blocks, dim=1)

    def _begun(self, number: int, part: Tensor, has_begun: Tensor) -> Tensor:
        """A part of the state (B, ...), with its first value where no frame has come."""
        if not self.begins[number]:
            return part
        return torch.where(has_begun, part, cast(Tensor, getattr(self, f"begin_{number}")))


def _windows(sound: Tensor, starts: Tensor, length: int) -> Tensor:
    """Samples (B, K, W) of the streams' sound (B, S) from each of the starts (B, K) on."""
    places = starts[:, :, None] + torch.arange(length)
    return torch.gather(sound, 1, places.flatten(1)).view(-1, starts.shape[1], length)
