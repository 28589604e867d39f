"""Sound in, finished curves out: a model, the measures of the voice and the rules in one graph.

Letters: B streams, S samples, T frames, A actors, C controls.
"""

import math
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils import _pytree as tree

from deitalk.array_functions import like, single
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.held_sound import held_sound
from deitalk.audio.log_mel import N_FFT
from deitalk.audio.vocal_strength import strength_frames, vocal_strength
from deitalk.audio.voice_activity import WINDOW, active_frames, speech_energy
from deitalk.config.rules import HoldPose
from deitalk.emotions import LABELS
from deitalk.errors import CheckpointError
from deitalk.export.sound_measures import BandLevels, WindowProsody, frame_windows
from deitalk.live.analysis import MEASURED_AHEAD, N_SOUND, FrameMeasures, VoiceAnalysis
from deitalk.models.causal_model import TensorState, advance, causal_frontend, first_state, grid_of
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.network_graph import CurveGraph, causal_graph
from deitalk.models.protocol import trained_weights
from deitalk.pipeline.curves import READ_ON_SAMPLES
from deitalk.pipeline.speech import CUT_FRAMES, phrase_strengths
from deitalk.postprocess.curve_pass import CurvePass
from deitalk.postprocess.factors import (
    expression_scale,
    held_intensity,
    mean_around,
    opening_factor,
)
from deitalk.postprocess.feeling import felt_intensity, gates_of, voice_intensity
from deitalk.postprocess.torch_columns import constant
from deitalk.postprocess.tracks import LIVE_AHEAD, rest_rows

MIXTURES = trained_weights(np.eye(len(LABELS), dtype=np.float32))
"""Trained emotions (9, 5) of each label."""


LEVEL_DB = -23.0
"""Active level of the speech that a network of whole clips reads, dB re full scale."""


def voice_columns(
    factors: tuple[Tensor, ...], kept: tuple[Tensor, Tensor], emotion: Tensor, variants: Tensor
) -> Tensor:
    """`deitalk.postprocess.tracks.VoiceTracks` without words, of tensors.

    `factors` are its `scale`, `opening` and `held`, `kept` its `back` and `kept`, and `variants`
    its `variants` and `side`.
    """
    phones, ways, side = torch.zeros_like(emotion[..., :4]), variants[..., :-1], variants[..., -1]
    single = torch.stack(factors, dim=-1), phones, torch.stack((*kept, side), dim=-1)
    return torch.cat((*single, emotion, ways), dim=-1)


class FinishedClip(nn.Module):
    """A whole recording to finished curves.

    Parameters
    ----------
    model : DEITalk
        With a Whisper frontend and an intensity module.

    Raises
    ------
    CheckpointError
        If it has other ones.
    """

    trained: Tensor
    after: Tensor

    def __init__(self, model: DEITalk) -> None:
        super().__init__()
        self.graph = CurveGraph(model)
        self.levels, self.prosody = BandLevels(), WindowProsody()
        self.config, self.controls = model.rules, model.controls
        self.rules = CurvePass(model.controls, model.rules)
        constant(self, "trained", MIXTURES)
        window = self.rules.behind + self.rules.ahead
        constant(self, "after", rest_rows(model.controls.rest, window)[: self.rules.ahead])

    def forward(
        self,
        sound: Tensor,
        emotion: Tensor,
        intensity: Tensor,
        variants: Tensor,
        motion: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Animate a recording.

        Parameters
        ----------
        sound : Tensor [shape=(S,)]
            16 kHz mono, any level.
        emotion : Tensor [shape=(T, 9 + A)]
            Weights of the emotions, then of the actors, of T = ceil(30 S / 16000) frames.
        intensity : Tensor [shape=(3, T)]
            Intensity to show, below 0 that of the voice; a factor on it; and the share of the
            expression that stays in silence.
        variants : Tensor [shape=(T, V + 1)]
            `variants` and `side` of `deitalk.postprocess.tracks.VoiceTracks`; zeros: the poses of
            the emotions themselves, on both sides.
        motion : Tensor [shape=(T, M)]
            `deitalk.postprocess.tracks.MotionTracks`; zeros: none.

        Returns
        -------
        curves, neutral : Tensor [shape=(T, C)]
        intensity : Tensor [shape=(T,)]
            Of the voice.
        """
        n_frames = emotion.shape[0]
        sound = sound - sound.mean()
        sound = sound - sound.mean()  # what rounding left
        windows = frame_windows(sound, n_frames, nearest=False)
        levels = self.levels(windows)
        speaking = active_frames(levels, self.prosody(windows).tone, sound.shape[0])
        labels, actors = emotion[:, : len(LABELS)], emotion[:, len(LABELS) :]
        styles = torch.cat((labels @ self.trained, actors), dim=1)
        gain = self._gain(sound, speaking)
        emotional, neutral, network, effort = self._readings(sound * gain, styles, speaking)
        curve, factor, rest = intensity.unbind(0)
        prosody = self.prosody(frame_windows(sound, n_frames, nearest=True))
        rules, rule, voice = self.config, self.config.voice_intensity, network
        if rule is not None:
            frames = strength_frames(prosody, speaking)
            _, strengths = phrase_strengths(*vocal_strength().follow(frames), speaking, effort)
            voice = voice_intensity(network, prosody, speaking, strengths, rule)
        near, usual = mean_around(voice, speaking), mean_around(network, speaking)
        opening = opening_factor(rules.scale_opening, near, usual)
        pose = held_sound(levels, prosody.tone, rules.hold_pose or HoldPose())
        mouth, expression = gates_of(speaking, rest, rules.gates)
        # Intensity: of the voice, or as drawn, which silence does not change.
        is_drawn = curve >= 0
        share = torch.where(is_drawn, torch.ones_like(curve), expression)
        felt = voice if rule is None else felt_intensity(voice, labels, rule)
        wanted = torch.where(is_drawn, curve, felt) * factor
        held = held_intensity(rules.expressions, self.controls, neutral, emotional, labels, network)
        scale = expression_scale(wanted, held)
        if rule is None:
            scale = torch.where(is_drawn, scale, factor)
        kept = single(pose.back), single(pose.share)
        columns = voice_columns((scale, opening, held), kept, labels, variants)
        shown = torch.cat((mouth[:, None], share[:, None], motion), dim=1)
        curves, plain = self._finished(neutral, emotional, columns, shown)
        return curves, plain, felt * expression

    def _gain(self, sound: Tensor, speaking: Tensor) -> Tensor:
        """Factor that brings the speech to `LEVEL_DB`; 1 if there is none."""
        energy, count = speech_energy(sound, speaking)
        usual = 10 ** (LEVEL_DB / 20) * torch.sqrt(count / energy.clamp_min(1e-30))
        return torch.where(energy > 0, usual, torch.ones_like(usual))

    def _readings(
        self, sound: Tensor, styles: Tensor, speaking: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor | None]:
        """What the network reads, on beyond the end of a recording that is cut in its speech."""
        n_frames, n_samples = torch.as_tensor(speaking.shape[0]), torch.as_tensor(sound.shape[0])
        is_cut = speaking[-1 - CUT_FRAMES :].any().long()
        added = torch.minimum(torch.as_tensor(READ_ON_SAMPLES), n_samples) * is_cut
        total = n_samples + added
        backwards = sound[-READ_ON_SAMPLES:].flip(0)
        longer = torch.cat((sound, backwards))[:total]
        count = (FRAME_RATE * total + SAMPLE_RATE - 1) // SAMPLE_RATE
        more = styles[-1:].expand(1 + READ_ON_SAMPLES * FRAME_RATE // SAMPLE_RATE, -1)
        rows = torch.cat((styles, more))[: torch.maximum(count, n_frames)]
        frames = torch.arange(rows.shape[0])
        place = frames.float() / torch.as_tensor(rows.shape[0]).float()
        found = self.graph(longer, rows, place)
        emotional, neutral, _, strength, *effort = (part[:n_frames] for part in found)
        return emotional, neutral, strength, effort[0] if effort else None

    def _finished(
        self, neutral: Tensor, emotional: Tensor, voice: Tensor, shown: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Curves of both readings after the rules, the whole recording at once."""
        rules = self.rules
        rows = torch.cat((neutral, emotional, voice), dim=1)
        rows = torch.cat((rows, self.after))[None]  # a face at rest follows the last frame
        size = neutral.shape[1]
        before = torch.zeros_like(shown[:1]).expand(rules.ahead, -1)
        curves, plain, *_ = rules(
            *torch.split(rows, [size, size, voice.shape[1]], dim=2),
            torch.cat((before, shown))[None],
            torch.ones(1, size),
            torch.ones(1),
            rules.first(1),
        )
        return curves[0, rules.ahead :], plain[0, rules.ahead :]


# Voices that have not ended: a frame a call, all state in one tensor.


WRAP = 720
"""Frames after which a counter goes back by half: a multiple of all periods."""


class FinishedLive(nn.Module):
    """The next frame of streams to finished curves.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend.

    Raises
    ------
    CheckpointError
        If it looks another number of frames ahead.

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
        if grid.delay != MEASURED_AHEAD:  # sound is measured when the network reads it
            raise CheckpointError(
                f"only causal models that look {MEASURED_AHEAD} frames ahead are exported, such as "
                f"live; this one looks {grid.delay} ahead"
            )
        self.delay, self.behind = grid.delay, grid.delay + LIVE_AHEAD
        self.levels, self.prosody = BandLevels(), WindowProsody()
        self.analysis = VoiceAnalysis(model.rules)
        self.rules = CurvePass(model.controls, model.rules, LIVE_AHEAD)
        self.before = WINDOW // 2
        # Samples of the spectra in a window, of the frames 3 n, 3 n + 1 and 3 n + 2.
        frames = np.arange(3)[:, None]
        centres = np.round(
            (frames * grid.spectra + np.arange(grid.spectra)) * SAMPLE_RATE / grid.rate
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
                is_one = bool((part == part.flatten()[0]).all())
                constant(self, f"begin_{k}", (part.flatten()[:1] if is_one else part).numpy())

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
        shaped = [
            self._begun(k, part.reshape(-1, *size), state[:, 0] > 0)
            for k, (part, size) in enumerate(zip(parts, self.sizes, strict=True))
        ]
        frame, network, analysed, rules = tree.tree_unflatten(shaped, self.shape)
        # The network: two readings of the frame `delay` before.
        labels, actors = emotion[:, : len(LABELS)], emotion[:, len(LABELS) :]
        styles = torch.cat((labels @ cast(Tensor, self.trained), actors), dim=1)
        n_frontend = causal_frontend(self.model).n_states
        before = TensorState.of(network, n_frontend)
        rows, next_network = advance(
            self.model, self._spectra(sound, frame), styles[:, None], before
        )
        # Measures of its voice.
        begun = frame[:, 0] >= self.delay
        factor, rest = intensity.unbind(1)
        rest = torch.where(begun, rest, torch.zeros_like(rest))
        window = sound[:, :WINDOW]
        measured = FrameMeasures.of_rows(self.levels(window), self.prosody(window), 1)
        found, measures = self.analysis(measured, rows.strength, rows.effort, rest, analysed)
        held, scale, rule = rows.strength, factor[:, None], self.model.rules.voice_intensity
        labels = labels[:, None]
        if rule is not None:
            applied = felt_intensity(found.intensity, labels, rule) * factor[:, None]
            held = held_intensity(
                self.model.rules.expressions,
                self.model.controls,
                rows.neutral,
                rows.emotional,
                labels,
                rows.strength,
            )
            scale = expression_scale(applied, held)
        factors, kept = (scale, found.opening, held), (found.held.back, found.held.share)
        voice = voice_columns(factors, kept, labels, variants[:, None])
        # The rules.
        gates = torch.cat((found.mouth, found.expression), dim=1)
        shown = torch.cat((gates, motion), dim=1)[:, None]
        gain, ruled = torch.ones_like(rows.neutral[:, 0]), torch.ones_like(factor)
        curves, _, _, finished = self.rules(
            rows.neutral, rows.emotional, voice, shown, gain, ruled, rules
        )
        # Before the first frame only the sound counts.
        read = tuple(next_network.tensors())
        decoder, spoken, finished = tree.tree_map(
            lambda new, old: torch.where(begun.view(-1, *[1] * (new.dim() - 1)), new, old),
            (read[n_frontend:], measures[N_SOUND:], finished),
            (tuple(network[n_frontend:]), analysed[N_SOUND:], rules),
        )
        frame = frame + 1
        frame = torch.where(frame >= WRAP, frame - WRAP // 2, frame)
        after = (*measures[:N_SOUND], *spoken)
        carried = (frame, (*read[:n_frontend], *decoder), after, finished)
        flat = [
            part.flatten(1) if part.dim() > 1 else part[:, None]
            for part in tree.tree_leaves(carried)
        ]
        new = torch.cat(flat, dim=1)
        return curves[:, 0], found.intensity[:, 0], new

    def _begun(self, number: int, part: Tensor, has_begun: Tensor) -> Tensor:
        """A part of the state, with its first value where no frame has come."""
        if not self.begins[number]:
            return part
        first = cast(Tensor, getattr(self, f"begin_{number}"))
        return torch.where(has_begun.view(-1, *[1] * (part.dim() - 1)), part, first)

    def _spectra(self, sound: Tensor, frame: Tensor) -> Tensor:
        """Samples of the spectra of the frame (B, P, 400)."""
        starts = self.offsets[torch.remainder(frame[:, 0], 3).long()]
        places = starts[:, :, None] + torch.arange(N_FFT)
        rows = torch.gather(sound, 1, places.flatten(1))
        return rows.view(-1, starts.shape[1], N_FFT)
