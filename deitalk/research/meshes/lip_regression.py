"""The lips' rims from coefficients of motion: a linear map for the loss.

The lips follow from coefficients of gradients by a sparse solve of the whole face. Over the
motion of a speaker it is nearly linear, so that the loss uses a least-squares fit of it;
predictions are solved in full. Letters: B segments, T frames, K coefficients, P facing pairs of
the rims.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.models.deformation_decoder import Coefficients
from deitalk.research.meshes.folder import MeshFolder
from rig.arrays import Float32, Float64

RIDGE = 1e-3
"""Over the mean square of the coefficients, which is about 1."""


class LipRegression(nn.Module):
    """One linear map a speaker.

    Parameters
    ----------
    maps : Tensor [shape=(speakers, K + 1, 6 P)]
        The last row is the constant; mm.
    partings : Tensor [shape=(speakers, P, 3)]
        Upper less lower rim of the templates, mm.
    names : tuple of str
        Branches, in the order of the map's rows.
    residual_mm : float
        Root of the mean squared error per vertex that the fit leaves.
    """

    maps: Tensor
    partings: Tensor

    def __init__(
        self, maps: Tensor, partings: Tensor, names: tuple[str, ...], residual_mm: float
    ) -> None:
        super().__init__()
        self.register_buffer("maps", maps)
        self.register_buffer("partings", partings)
        self.names, self.residual_mm = names, residual_mm

    @classmethod
    def fit(
        cls,
        clips: Sequence[tuple[dict[str, Float32], int]],
        folder: MeshFolder,
        *,
        motion: str,
    ) -> "LipRegression":
        """Fit to the motion of clips and the places of their speakers.

        Parameters
        ----------
        clips : sequence of (dict, int)
            What `MeshClip.motion` gives, and the speaker's place.
        folder : MeshFolder
            Templates and lips; these must be known.
        motion : str
            ``gradients`` or ``offsets``.
        """
        assert folder.lips is not None
        names = ("offsets",) if motion == "offsets" else ("stretch", "rotation")
        maps, partings, errors = [], [], []
        for place, speaker in enumerate(folder.training_speakers):
            rows = [m for m, who in clips if who == place]
            given = np.concatenate([np.hstack([m[name] for name in names]) for m in rows])
            given = np.hstack([given, np.ones((len(given), 1))]).astype(np.float64)
            wanted = folder.unit_mm * np.concatenate(
                [m["lips"].reshape(len(m["lips"]), -1) for m in rows]
            ).astype(np.float64)
            square = given.T @ given + RIDGE * len(given) * np.eye(given.shape[1])
            maps.append(np.linalg.solve(square, given.T @ wanted))
            errors.append((given @ maps[-1] - wanted).reshape(-1, 3))
            rest = folder.templates[speaker].vertices
            partings.append(folder.unit_mm * (rest[folder.lips.upper] - rest[folder.lips.lower]))
        residual = float(np.sqrt((np.concatenate(errors) ** 2).sum(axis=1).mean()))
        return cls(_stacked(maps), _stacked(partings), names, residual)

    def forward(self, coefficients: Coefficients, speaker: Tensor) -> Tensor:
        """Map coefficients (B, T, K) and one-hot speakers (B, P) to rims (B, T, 2 P, 3), mm."""
        rows = torch.cat([coefficients[name] for name in self.names], dim=-1)
        rows = torch.cat((rows, torch.ones_like(rows[..., :1])), dim=-1)
        out = torch.bmm(rows, self.maps[speaker.argmax(dim=1)])
        return torch.unflatten(out, -1, (-1, 3))

    def rest_parting(self, speaker: Tensor) -> Tensor:
        """Upper less lower rim of the templates [shape=(B, 1, P, 3)], mm."""
        return self.partings[speaker.argmax(dim=1)].unsqueeze(1)


def _stacked(rows: list[Float64]) -> Tensor:
    return torch.from_numpy(np.stack(rows)).float()
