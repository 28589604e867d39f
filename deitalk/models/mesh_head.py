"""A mesh head for DEITalk: emotion and intensity reach a mesh that is learnt, not acted by a rig.

SDFA's decoder (§3.4) on the features of a frozen DEITalk model (§3.2-3.4)::

    waveform -> DEITalk -> features (T, D), read neutrally and in the emotion
             -> decoder: coefficients (T, K) of both readings -> their blend by the intensity
             -> (T, 6 N), (T, 3 N) -> solve -> vertices (T, V, 3)

Letters: T frames, D features, K components, N triangles, V vertices.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deitalk.audio.load import SAMPLE_RATE, frame_times
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import normalise_level, speech_activity
from deitalk.emotions import (
    EMOTIONS,
    EmotionTrack,
    IntensityCurve,
    check_intensity,
    parse_emotion,
    read_intensity_curve,
)
from deitalk.models.curve_features import FPS, DEITalkFeatures
from deitalk.models.deformation_decoder import Coefficients
from deitalk.models.mesh_model import FRAMES_AT_ONCE, SDFA, checked_waveform
from deitalk.postprocess.curve_rules import LEAST_PREDICTED
from deitalk.postprocess.gates import expression_gate
from deitalk.postprocess.voice_intensity import heard_intensity


@dataclass(frozen=True)
class Direction:
    """What an actor is asked for.

    Parameters
    ----------
    emotion : EmotionTrack
        Weights of the emotional styles over time.
    intensity : float, range 0 to 4
        Factor on the intensity heard in the voice; 0 is the neutral reading.
    curve : IntensityCurve, optional
        Intensity instead of the one heard.
    """

    emotion: EmotionTrack
    intensity: float = 1.0
    curve: IntensityCurve | None = None

    @classmethod
    def of(
        cls,
        emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
        intensity: float = 1.0,
        intensity_curve: str | Path | IntensityCurve | None = None,
    ) -> "Direction":
        """As `deitalk.animate` is directed; raises EmotionError likewise."""
        if isinstance(intensity_curve, str | Path):
            intensity_curve = read_intensity_curve(intensity_curve)
        return cls(parse_emotion(emotion), check_intensity(intensity), intensity_curve)


class MeshHead(SDFA):
    """`SDFA` whose encoder is a trained DEITalk model."""

    encoder: DEITalkFeatures

    @torch.no_grad()
    def coefficients(
        self, waveform: Any, speaker: str | int = 0, direction: Direction | None = None
    ) -> Iterator[Coefficients]:
        """Coefficients (T, K) of some frames at a time, in order.

        Notes ----- The emotional reading shows as much as the network heard; it is scaled from
        the neutral one by the intensity asked for, in coefficients as
        `deitalk.postprocess.curve_rules.Expression.blend` does in controls. Where nobody speaks,
        all goes to the template.
        """
        asked = direction or Direction.of()
        samples = checked_waveform(waveform)
        activity = speech_activity(samples)
        sound = torch.from_numpy(normalise_level(samples, activity=activity)).to(self.device)
        n_frames = max(int(np.ceil(len(samples) / SAMPLE_RATE * FPS - 1e-9)), 1)
        times = frame_times(n_frames)
        weights = torch.from_numpy(asked.emotion.at(times)).to(self.device)
        neutral = torch.zeros_like(weights)
        neutral[:, EMOTIONS.index("neutral")] = 1
        analysis = self.encoder.analyse(sound, n_frames)
        shown = expression_gate(activity)[:n_frames]
        heard = np.ones(n_frames, np.float32)
        if analysis.strength is not None:
            heard = analysis.strength.cpu().numpy()
        strength = heard_intensity(heard, measure_prosody(samples, n_frames), activity) * shown
        applied = asked.intensity * (strength if asked.curve is None else asked.curve.at(times))
        scale = applied / np.maximum(heard * shown, LEAST_PREDICTED)
        readings = [self.encoder.read(analysis, each) for each in (neutral, weights)]
        label, rest = self.label(speaker).to(self.device), self.rest
        factors = np.stack((scale, shown), axis=1).astype(np.float32)
        for plain, emotional, factor in zip(
            *(torch.split(rows, FRAMES_AT_ONCE) for rows in readings),
            torch.split(torch.from_numpy(factors).to(self.device), FRAMES_AT_ONCE),
            strict=True,
        ):
            yield self._blended(plain, emotional, label.expand(len(plain), -1), factor, rest)

    def _blended(
        self, plain: Tensor, emotional: Tensor, label: Tensor, factor: Tensor, rest: Coefficients
    ) -> Coefficients:
        scale, shown = factor[:, :1], factor[:, 1:]
        readings = (self.encoder.standardised(rows) for rows in (plain, emotional))
        calm, moved = (self.decoder(rows, label) for rows in readings)
        blended = {name: calm[name] + scale * (moved[name] - calm[name]) for name in calm}
        return {name: rest[name] + shown * (rows - rest[name]) for name, rows in blended.items()}

    @property
    def rest(self) -> Coefficients:
        """Coefficients of the template itself, as near as the bases come, by branch."""
        return {name: branch.inverse_pca.rest() for name, branch in self.decoder.branches.items()}
