"""Standardised features of a frozen DEITalk model (DEITalk §3.4), the input of a mesh decoder."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from deitalk.models.curve_model import DEITalk

LEAST_DEVIATION = 1e-3


class DEITalkFeatures(nn.Module):
    """Standardised input of the last layer of a frozen DEITalk model.

    The features hold speech, emotional style and intensity, after eight convolutions along time.

    Parameters
    ----------
    network : DEITalk
        Frozen here; neither trained nor saved as a part of this module.
    fingerprint : str
        SHA-256 of its weights, which a mesh head's folder stores.

    Attributes
    ----------
    output_size : int
        D.
    mean, deviation : Tensor [shape=(D,)]
        By which every feature is standardised; set by `fit`.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, network: "DEITalk", fingerprint: str) -> None:
        super().__init__()
        self._frozen = (network.requires_grad_(False),)  # a tuple: no module of this one
        self.fingerprint = fingerprint
        self.output_size = network.config.decoder_channels
        self.register_buffer("mean", torch.zeros(self.output_size))
        self.register_buffer("deviation", torch.ones(self.output_size))

    @property
    def network(self) -> "DEITalk":
        """The DEITalk model, in evaluation mode, on the device of the buffers."""
        return self._frozen[0].to(self.mean.device)

    def fit(self, rows: Tensor) -> None:
        """Set mean and deviation from features (T, D) of many clips.

        A feature of deviation 0 is divided by `LEAST_DEVIATION`.
        """
        self.mean.copy_(rows.mean(dim=0))
        self.deviation.copy_(rows.std(dim=0) + LEAST_DEVIATION)

    def standardised(self, rows: Tensor) -> Tensor:
        """Features (..., D) of mean 0 and deviation 1."""
        return (rows - self.mean) / self.deviation

    def forward(self, features: Tensor, places: Tensor) -> Tensor:
        """Map features (B, 1, D, T) to standardised rows (B, len(places), D) at `places`."""
        return self.standardised(features[:, 0].transpose(1, 2)[:, places])
