"""EmoTalk: emotion and content of a voice disentangled by cross-reconstruction (Peng et al. 2023).

Two encoders read the speech, one the content and one the emotion. In training the curves of a
recording are predicted from its content and from the emotion of *another* recording, whose voice
acts the emotion that the curves show; so the emotion encoder cannot pass words on. The decoder
joins both, and attends to the emotion a second time.

Deviations: one speech frontend is before both encoders, which are two convolutions each, instead
of two wav2vec 2.0 models; our curves of another emotion have the times of the recording, so that
nothing is stretched; there is no label of the emotion's level; the style of the speaker is left
out, or is the emotion's (``model.decoder_labelled``), which the paper's network is not given.

Letters: B batch, T frames, D speech features, E emotion features, W width.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.config.rules import RulesConfig
from deitalk.emotions import EMOTIONS
from deitalk.models.curve_model import Analysis, Output
from deitalk.models.rig_decoder import Decoder
from deitalk.models.temporal_conv import TemporalConv
from deitalk.research.comparison.biased_attention import BiasedLayer
from deitalk.research.comparison.faceformer import CONTEXT_FRAMES, output_layer, style_layers
from deitalk.research.comparison.network import ComparedNetwork
from deitalk.research.config import ComparedModelConfig
from rig import ControlSet

CONTENT_SHARE = 4
"""The emotion has one of so many parts of the decoder's input."""


def emotion_sources(shown: Tensor, voice: Tensor) -> tuple[Tensor, Tensor]:
    """Choose for every window the window whose voice acts the emotion that its curves show.

    Windows of odd rows take the next one in the batch and themselves only if there is no other
    (the paper's cross-reconstruction); those of even rows themselves where they can (its
    self-reconstruction).

    Parameters
    ----------
    shown, voice : Tensor [shape=(B, 5)]
        Weights of the emotions that the curves show and the voices act.

    Returns
    -------
    source : Tensor [shape=(B,), dtype=int64]
        Rows of the chosen windows.
    found : Tensor [shape=(B,)]
        0 where no voice of the batch acts the emotion, else 1.
    """
    fits = voice.argmax(dim=1) == shown.argmax(dim=1, keepdim=True)  # (B, B)
    size = len(fits)
    row = torch.arange(size, device=fits.device)
    turn = (row - row.unsqueeze(1)) % size
    turn[row, row] = size * (row % 2)
    source = turn.masked_fill(~fits, size + 1).argmin(dim=1)
    return source, fits.any(dim=1).to(shown.dtype)


class EmotionEncoder(nn.Module):
    """Speech features to emotion features, and to the emotion that the voice acts.

    Parameters
    ----------
    in_size, emotion_size, classifier_size : int
        Widths D and E, and hidden width of the classifier.
    dropout : float
    """

    def __init__(
        self, in_size: int, emotion_size: int, classifier_size: int, dropout: float
    ) -> None:
        super().__init__()
        self.layers = convolutions(in_size, emotion_size, dropout)
        self.classifier = nn.Sequential(
            nn.Linear(emotion_size, classifier_size),
            nn.ReLU(),
            nn.Linear(classifier_size, len(EMOTIONS)),
        )

    def forward(self, speech: Tensor) -> Tensor:
        """Map (B, T, D) to (B, T, E)."""
        features: Tensor = self.layers(speech.transpose(1, 2)).transpose(1, 2)
        return features

    def classify(self, features: Tensor) -> Tensor:
        """Logits of the emotions (B, 5) from the mean of features (B, T, E)."""
        logits: Tensor = self.classifier(features.mean(dim=1))
        return logits


class EmoTalkDecoder(Decoder):
    """Content, emotion and style to curves: one transformer layer, guided by the emotion.

    Parameters
    ----------
    config, in_size, rest
        As for `deitalk.research.comparison.faceformer.FaceFormerDecoder`.
    """

    def __init__(self, config: ComparedModelConfig, in_size: int, rest: Tensor) -> None:
        super().__init__()
        width = config.decoder_channels
        style_size = config.style_size if config.decoder_labelled else 0
        emotion_size = width // CONTENT_SHARE
        self.margin = CONTEXT_FRAMES
        self.style, self.actors = None, None
        if config.decoder_labelled:
            self.style, self.actors = style_layers(config, style_size)
        self.content = convolutions(in_size, width - emotion_size - style_size, config.dropout)
        self.emotion = nn.Linear(config.emotion_size, emotion_size)
        self.layer = BiasedLayer(
            width, config.emotion_size, config.decoder_heads, config.decoder_period, config.dropout
        )
        self.output = output_layer(width, rest)

    def hidden(self, speech: Tensor, emotion: Tensor, guidance: Tensor | None) -> Tensor:
        """Input of the last layer [shape=(B, T, W)]; guidance is of `EmotionEncoder`."""
        assert guidance is not None
        content = self.content(speech.transpose(1, 2)).transpose(1, 2)
        parts = [content, F.relu(self.emotion(guidance))]
        if self.style is not None:
            parts.append(self.styles(emotion, speech.shape[1]))
        rows: Tensor = self.layer(torch.cat(parts, dim=-1), guidance)
        return rows


class EmoTalk(ComparedNetwork):
    """The network with both encoders; parameters as for `DEITalk`."""

    def __init__(
        self,
        config: ComparedModelConfig,
        controls: ControlSet | None = None,
        *,
        pretrained: bool = True,
        rules: RulesConfig = RulesConfig(),
    ) -> None:
        super().__init__(config, controls, pretrained=pretrained, rules=rules)
        self.emotion = EmotionEncoder(
            self.frontend.output_size, config.emotion_size, config.classifier_size, config.dropout
        )

    def new_decoder(self) -> Decoder:
        """Make EmoTalk's decoder."""
        rest = torch.tensor(self.controls.rest)
        return EmoTalkDecoder(self.config, self.frontend.output_size, rest)

    def forward(
        self,
        waveform: Tensor,
        emotion: Tensor,
        frames: Tensor,
        total: Tensor,
        curves: Tensor | None = None,
        voice: Tensor | None = None,
    ) -> Any:
        """Predict one batch.

        With `voice` [shape=(B, 5)], the emotion that the voices act, the emotion is that of
        `emotion_sources`, and its `found` [shape=(B,)] is returned too.
        """
        is_encoded = waveform.dim() == 3
        speech = waveform if is_encoded else self.frontend(waveform, frames.shape[1])
        features = self.emotion(speech)
        logits, found = self.emotion.classify(features), None
        if voice is not None:
            source, found = emotion_sources(emotion[:, : len(EMOTIONS)], voice)
            features = features[source]
        output = Output(self.decoder(speech, emotion, features), None, logits, None, speech)
        return output if found is None else (output, found)

    def reads_together(self, n_frames: int) -> bool:
        """No recordings are read together."""
        return False

    @torch.no_grad()
    def analyse(
        self,
        waveform: Tensor,
        n_frames: int,
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Analysis:
        """Analyse a whole clip; its guidance are the emotion features of the voice."""
        analysis = super().analyse(waveform, n_frames, progress, gain)
        features = self.emotion(analysis.speech.float().unsqueeze(0))
        return analysis._replace(guidance=features[0])


def convolutions(in_size: int, out_size: int, dropout: float) -> nn.Sequential:
    """Two convolutions over time, of 7 frames together: (B, in_size, T) to (B, out_size, T)."""
    return nn.Sequential(
        TemporalConv(in_size, out_size, 3, 1, dropout),
        TemporalConv(out_size, out_size, 3, 2, 0.0),
    )
