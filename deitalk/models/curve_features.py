"""The features of a trained DEITalk model as what a mesh is decoded from (DEITalk §3.4).

Letters: B segments, T frames, D features.
"""

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from deitalk.config import DEITalkFeaturesConfig
from deitalk.models.checkpoint import describe_model, load_model

if TYPE_CHECKING:
    from deitalk.models.curve_model import Analysis, DEITalk

FPS = 30.0
"""Feature rows per second."""
LEAST_DEVIATION = 1e-3


class DEITalkFeatures(nn.Module):
    """A DEITalk model up to its last layer, frozen: it is neither trained nor saved here.

    The features are what the last layer of its decoder reads: speech, emotional style and
    intensity, after eight convolutions along time.

    Parameters
    ----------
    config : DEITalkFeaturesConfig
        Names the model.

    Attributes
    ----------
    output_size : int
        D.
    mean, deviation : Tensor [shape=(D,)]
        What every feature is standardised by; `fit` finds them.
    fingerprint : str
        SHA-256 of the model's weights, by which a mesh head knows what it was trained on.

    Raises
    ------
    deitalk.errors.CheckpointError
        If there is no such model.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, config: DEITalkFeaturesConfig) -> None:
        super().__init__()
        self.config = config
        network = load_model(config.model).requires_grad_(False)
        self._frozen = (network,)  # in a tuple, it is no module of this one
        self.output_size = network.config.decoder_channels
        self.register_buffer("mean", torch.zeros(self.output_size))
        self.register_buffer("deviation", torch.ones(self.output_size))
        self.fingerprint = str(describe_model(config.model)["sha256"])

    @property
    def network(self) -> "DEITalk":
        """The model, in evaluation mode."""
        return self._frozen[0]

    def analyse(self, waveform: Tensor, n_frames: int) -> "Analysis":
        """What it hears in a whole recording (S,), level-normalised, on the waveform's device."""
        return self.network.to(waveform.device).analyse(waveform, n_frames)

    def read(self, analysis: "Analysis", emotion: Tensor) -> Tensor:
        """Features (T, D) of what was heard, in an emotion of weights (T, 5)."""
        return self.network.describe(analysis, emotion)

    def fit(self, rows: Tensor) -> None:
        """Standardise by features (T, D) of many clips; one that never varies stays small."""
        self.mean.copy_(rows.mean(dim=0))
        self.deviation.copy_(rows.std(dim=0) + LEAST_DEVIATION)

    def standardised(self, rows: Tensor) -> Tensor:
        """Features (..., D) of mean 0 and deviation 1."""
        return (rows - self.mean) / self.deviation

    def forward(self, features: Tensor, places: Tensor) -> Tensor:
        """Map features (B, 1, D, T) to standardised rows (B, len(places), D) at `places`."""
        return self.standardised(features[:, 0].transpose(1, 2)[:, places])
