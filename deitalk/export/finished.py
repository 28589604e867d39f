"""Sound in, finished curves out: a model, the measures of the voice and the rules in one graph.

Letters: S samples, T frames, A actors, C controls.
"""

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.held_sound import held_sound
from deitalk.audio.vocal_strength import strength_frames, vocal_strength
from deitalk.audio.voice_activity import active_frames
from deitalk.config.rules import HoldPose
from deitalk.emotions import LABELS
from deitalk.export.sound_measures import BandLevels, WindowProsody, frame_windows
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.network_graph import CurveGraph
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
from deitalk.postprocess.feeling import felt_intensity, voice_intensity
from deitalk.postprocess.gates import gates_of
from deitalk.postprocess.torch_columns import constant
from deitalk.postprocess.tracks import VoiceTracks, rest_rows

MIXTURES = trained_weights(np.eye(len(LABELS), dtype=np.float32))
"""Trained emotions (9, 5) of each label."""


LEVEL_DB = -23.0
"""Active level of the speech that a network of whole clips reads, dB re full scale."""


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
        phones, ways, side = torch.zeros_like(labels[:, :4]), variants[:, :-1], variants[:, -1]
        voice_rows = VoiceTracks(
            scale, opening, held, phones, labels, pose.back, pose.share, ways, side, felt
        ).columns()
        shown = torch.cat((mouth[:, None], share[:, None], motion), dim=1)
        curves, plain = self._finished(neutral, emotional, voice_rows, shown)
        return curves, plain, felt * expression

    def _gain(self, sound: Tensor, speaking: Tensor) -> Tensor:
        """`deitalk.audio.voice_activity.level_gain`, without a loop over the runs of speech."""
        frames = (3 * torch.arange(sound.shape[0]) + 2) // 1600  # of the samples
        is_speech = speaking[frames].float()
        energy, count = (sound * sound * is_speech).sum(), is_speech.sum()
        usual = 10 ** (LEVEL_DB / 20) * torch.sqrt(count / energy.clamp_min(1e-30))
        return torch.where(energy > 0, usual, torch.ones_like(usual))

    def _readings(
        self, sound: Tensor, styles: Tensor, speaking: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor | None]:
        """Readings of the network; a recording that ends in its speech is mirrored at its end."""
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
