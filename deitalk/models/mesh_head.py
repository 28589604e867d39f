"""SDFA's decoder (§3.4) on the features of a frozen DEITalk model (§3.2-3.4): emotion on a mesh.

::

    waveform -> DEITalk -> features (T, D), neutral and emotional     deitalk.pipeline.speech
             -> decoder: coefficients (T, K) of both readings -> their blend by the intensity
             -> (T, 6 N), (T, 3 N) -> solve -> vertices (T, V, 3)

Deviation: neither paper gives emotion to a learnt mesh.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from deitalk.models.deformation_decoder import (
    Coefficients,
)

if TYPE_CHECKING:
    pass
from deitalk.models.mesh_model import FRAMES_AT_ONCE, DEITalkFeatures, MeshModel


class MeshHead(MeshModel):
    """`MeshModel` whose encoder is a trained DEITalk model."""

    has_emotion = True
    encoder: DEITalkFeatures

    def about(self) -> dict[str, Any]:
        """With the weights whose features it decodes."""
        return super().about() | {"decodes_sha256": self.encoder.fingerprint}

    @torch.no_grad()
    def coefficients(
        self, neutral: Tensor, emotional: Tensor, scale: Tensor, shown: Tensor, speaker: str | int
    ) -> Iterator[Coefficients]:
        """Blend the coefficients of two readings, `FRAMES_AT_ONCE` frames at a time.

        Parameters
        ----------
        neutral, emotional : Tensor [shape=(T, D)]
            Features of the same speech, from `DEITalk.describe`.
        scale : Tensor [shape=(T,)]
            Factor on the difference of the readings; see
            `deitalk.postprocess.factors.expression_scale`.
        shown : Tensor [shape=(T,), range 0 to 1]
            Share of the motion; at 0 the coefficients are those of the template.
        speaker : str or int
            Style, by name or number.

        Yields
        ------
        Coefficients [shape=(T, K)], by branch
        """
        label, rest = self.label(speaker), self.rest
        rows = (neutral, emotional, scale.unsqueeze(1), shown.unsqueeze(1))
        parts = (torch.split(each.to(self.device), FRAMES_AT_ONCE) for each in rows)
        for plain, moved, factor, gate in zip(*parts, strict=True):
            labels = label.expand(len(plain), -1)
            low = self.decoder(self.encoder.standardised(plain), labels)
            high = self.decoder(self.encoder.standardised(moved), labels)
            blend = {name: low[name] + factor * (high[name] - low[name]) for name in low}
            yield {name: rest[name] + gate * (row - rest[name]) for name, row in blend.items()}

    @property
    def rest(self) -> Coefficients:
        """Coefficients nearest to the template itself, by branch."""
        return {name: branch.inverse_pca.rest() for name, branch in self.decoder.branches.items()}
