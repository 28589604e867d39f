"""Dynamic emotional intensity: which frames carry the emotion (DEITalk §3.3, Eq. 4-6).

A linear layer maps speech features to emotion features S_emo; a motion encoder maps captured
curves to M_emo. Contrastive learning pulls their pooled embeddings together. The cosine between
a frame and the clip's embedding is the emotional saliency, and saliency times feature is the
intensity the decoder is guided by.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.models.joined import JoinedClips
from deitalk.models.temporal_conv import TemporalConv


class Intensity(NamedTuple):
    """Output of `DynamicIntensity`."""

    features: Tensor
    """S_emo [shape=(B, T, E)]."""
    embedding: Tensor
    """s_max [shape=(B, E)], the clip's (Eq. 4)."""
    saliency: Tensor
    """e_sim [shape=(B, T), range -1 to 1] (Eq. 5)."""
    guidance: Tensor
    """E_in [shape=(B, T, E)] (Eq. 6); that of a kept projection follows, (B, T, 2 E)."""
    strength: Tensor
    """Predicted intensity [shape=(B, T), range 0 to 1]: the saliency, calibrated."""
    effort: Tensor | None = None
    """Strength of the voice [shape=(B, T)], dB above the usual, where there is a readout."""


def temporal_maximum(features: Tensor) -> Tensor:
    """Largest value of every feature over the clip: (B, T, E) to (B, E) (Eq. 4)."""
    return features.amax(dim=1)


def local_maximum(features: Tensor, frames: int) -> Tensor:
    """Largest value of every feature within ``frames // 2`` frames of each frame, (B, T, E)."""
    half = frames // 2
    pooled = F.max_pool1d(features.transpose(1, 2), 2 * half + 1, stride=1, padding=half)
    return pooled.transpose(1, 2)


def past_maximum(features: Tensor, frames: int) -> Tensor:
    """Largest value of every feature within the last `frames` of each frame, (B, T, E)."""
    return _running_maximum(F.pad(features, (0, 0, frames - 1, 0), value=-torch.inf), frames)


def _running_maximum(rows: Tensor, frames: int) -> Tensor:
    """Largest value of each column within `frames` rows on from each (B, T, E)."""
    return F.max_pool1d(rows.transpose(1, 2), frames, stride=1).transpose(1, 2)


def emotional_saliency(features: Tensor, embedding: Tensor) -> Tensor:
    """Cosine of every frame with the embedding around it (Eq. 5).

    Parameters
    ----------
    features : Tensor [shape=(B, T, E)]
        S_emo, any scale.
    embedding : Tensor [shape=(B, E) or (B, T, E)]
        Pooled over the clip, or around every frame.

    Returns
    -------
    Tensor [shape=(B, T), range -1 to 1]

    Notes
    -----
    Paper silent: a zero vector; its saliency is 0.
    """
    if embedding.dim() == 2:
        embedding = embedding.unsqueeze(1)
    return F.cosine_similarity(features, embedding, dim=-1)


class DynamicIntensity(nn.Module):
    """Speech features to emotional saliency and guidance.

    Parameters
    ----------
    in_size : int
        Width of the speech features.
    emotion_size : int
        Width E of S_emo.
    classifier_size : int
        Hidden width of the emotion classifier (§4.1: 64, then 5).
    n_emotions : int
    saliency_frames : int or None
        Frames that Eq. 5 compares with. None pools over the whole clip, as printed.
        Deviation: with a number the embedding is pooled around every frame, so that a long take
        keeps the contrast that a training window had and can be computed in chunks.
    causal : bool
        The number of frames ends with each frame instead of being around it.
    kept : bool
        A second projection, that of the model before its fine-tuning, gives the guidance of the
        decoder that was kept too (`deitalk.models.rig_decoder.RigDecoder`; not in the paper).
    effort : bool
        A linear readout of the speech features is the strength of the voice. Not in the paper,
        whose saliency compares frames of one clip, not clips.
    """

    def __init__(
        self,
        in_size: int,
        emotion_size: int,
        classifier_size: int,
        n_emotions: int,
        saliency_frames: int | None,
        causal: bool = False,
        kept: bool = False,
        effort: bool = False,
    ) -> None:
        super().__init__()
        self.saliency_frames, self.causal = saliency_frames, causal
        self.project = nn.Linear(in_size, emotion_size)
        self.kept = nn.Linear(in_size, emotion_size) if kept else None
        self.effort = nn.Linear(in_size, 1) if effort else None
        self.classifier = nn.Sequential(
            nn.Linear(emotion_size, classifier_size),
            nn.ReLU(),
            nn.Linear(classifier_size, n_emotions),
        )
        # Deviation: two numbers turn the cosine into an intensity of 0 to 1 that can be edited;
        # the slope is kept positive, so that intensity rises with saliency.
        self.slope = nn.Parameter(torch.tensor(1.0))
        self.offset = nn.Parameter(torch.tensor(0.0))

    def forward(
        self, speech: Tensor, embedding: Tensor | None = None, clips: JoinedClips | None = None
    ) -> Intensity:
        """Map speech features (B, T, D) to `Intensity`.

        `embedding` (B, E) is the whole clip's where `speech` is a piece of it. With `clips` the
        frames are those of several (1, K, D), each compared with its own.
        """
        features = self.project(speech)
        if embedding is None:
            embedding = temporal_maximum(features)
        around = embedding
        if self.saliency_frames is not None:
            around = self._around(features, self.saliency_frames, clips)
        intensity = self._compared(speech, features, embedding, around)
        if self.kept is None or self.saliency_frames is None:
            return intensity
        before = self.kept(speech)
        saliency = emotional_saliency(before, self._around(before, self.saliency_frames, clips))
        guidance = torch.cat((intensity.guidance, saliency.unsqueeze(-1) * before), dim=-1)
        return intensity._replace(guidance=guidance)

    def _around(self, features: Tensor, frames: int, clips: JoinedClips | None) -> Tensor:
        """Largest value of every feature around each frame, or before it."""
        maximum = past_maximum if self.causal else local_maximum
        if clips is None:
            return maximum(features, frames)
        return clips.taken(maximum(clips.spread(features, frames, -torch.inf), frames), frames)

    def first_past(self, batch: int) -> Tensor:
        """Features before the first frame of streams (B, saliency_frames - 1, E): none."""
        assert self.saliency_frames is not None
        shape = batch, self.saliency_frames - 1, self.project.out_features
        return self.project.weight.new_full(shape, -torch.inf)

    def advance(self, speech: Tensor, past: Tensor) -> tuple[Intensity, Tensor]:
        """Map the next speech features (B, T, D) of streams; `past` is for the next call."""
        assert self.saliency_frames is not None
        features = self.project(speech)
        rows = torch.cat((past, features), dim=1)
        around = _running_maximum(rows, self.saliency_frames)
        kept = rows[:, 1 - self.saliency_frames :] if self.saliency_frames > 1 else past
        return self._compared(speech, features, around[:, -1], around), kept

    def _compared(
        self, speech: Tensor, features: Tensor, embedding: Tensor, around: Tensor
    ) -> Intensity:
        saliency = emotional_saliency(features, around)
        strength = torch.sigmoid(4 * (F.softplus(self.slope) * saliency + self.offset))
        guidance = saliency.unsqueeze(-1) * features
        effort = None if self.effort is None else self.effort(speech).squeeze(-1)
        return Intensity(features, embedding, saliency, guidance, strength, effort)

    def classify(self, features: Tensor) -> Tensor:
        """Emotion logits (B, n_emotions) from S_emo (B, T, E).

        Paper silent: how frames become one decision; we average the frames' logits.
        """
        logits: Tensor = self.classifier(features).mean(dim=1)
        return logits


class MotionEncoder(nn.Module):
    """Captured curves to M_emo: a four-layer TCN and a linear layer (§3.3, §4.1).

    Parameters
    ----------
    n_controls : int
    channels : sequence of int
        One per layer; the dilations are 1, 2, 4, 8, ...
    kernel_size : int
    emotion_size : int
    """

    def __init__(
        self, n_controls: int, channels: Sequence[int], kernel_size: int, emotion_size: int
    ) -> None:
        super().__init__()
        sizes = [n_controls, *channels]
        self.layers = nn.Sequential(
            *(
                TemporalConv(sizes[i], sizes[i + 1], kernel_size, 2**i, dropout=0.0)
                for i in range(len(channels))
            )
        )
        self.project = nn.Linear(sizes[-1], emotion_size)

    def forward(self, curves: Tensor) -> Tensor:
        """Map curves (B, T, C) to M_emo (B, T, E)."""
        out: Tensor = self.project(self.layers(curves.transpose(1, 2)).transpose(1, 2))
        return out
