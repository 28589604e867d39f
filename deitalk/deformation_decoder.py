"""Speech feature and speaker to packed deformation gradients (SDFA §3.4, Table 3).

Letters: B frames, P speakers, N triangles, K components of a basis. With the paper's sizes::

    z_att 512 + speaker 8 = 520 -> 512 = z_dec
    z_dec 512 + speaker 8 = 520 -> 512 -> 256 -> K ->  6 N  (stretch s,  K = 85)
                            520 -> 512 -> 256 -> K ->  3 N  (rotation r, K = 180)

Deviation: Table 3 prints 59865 for 6 N; with N = 9976 (§4.1) it is 59856.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils.parametrizations import weight_norm

from rig.mesh import Bases, GradientBasis

SLOPE = 0.2
"""Leak of every leaky ReLU (Table 3)."""


class Deformation(NamedTuple):
    """Packed gradients of B frames, as `rig.mesh.pack` packs them."""

    s: Tensor
    """Stretch S - I [shape=(B, 6 N)]."""
    r: Tensor
    """Rotation vectors [shape=(B, 3 N), radians]."""


class InversePCA(nn.Module):
    """The frozen last layer: coefficients of unit variance to numbers of a frame.

    Parameters
    ----------
    size : int
        K.
    width : int
        6 N or 3 N.

    Notes
    -----
    Buffers, not parameters: nothing trains them. `weights` are the roots of the triangles' areas
    that the basis was fitted with; only the loss uses them.

    Paper silent: the scale of the coefficients. Components carry their standard deviation, so that
    the layer before predicts numbers of one size; zeros give the mean shape.
    """

    mean: Tensor
    components: Tensor
    weights: Tensor

    def __init__(self, size: int, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("components", torch.zeros(size, width))
        self.register_buffer("weights", torch.ones(width))

    @classmethod
    def of(cls, basis: GradientBasis) -> "InversePCA":
        """Take the numbers of a fitted basis."""
        layer = cls(*basis.components.shape)
        layer.mean = torch.from_numpy(basis.mean.copy())
        layer.components = torch.from_numpy(basis.components.astype("float32"))
        layer.weights = torch.from_numpy(basis.weights.copy())
        return layer

    def forward(self, coefficients: Tensor) -> Tensor:
        """Map (B, K) to (B, width)."""
        return torch.addmm(self.mean, coefficients, self.components)


class Branch(nn.Module):
    """One of the two parallel branches of Table 3.

    Parameters
    ----------
    in_size : int
        Width of z_dec and the speaker together.
    hidden : (int, int)
        Widths of the two hidden layers.
    last : InversePCA
        The frozen layer.
    """

    def __init__(self, in_size: int, hidden: tuple[int, int], last: InversePCA) -> None:
        super().__init__()
        wide, narrow = hidden
        self.coefficients = nn.Sequential(
            nn.Linear(in_size, wide),
            nn.LeakyReLU(SLOPE),
            nn.Linear(wide, narrow),
            nn.Tanh(),
            nn.Linear(narrow, len(last.components)),
        )
        self.inverse_pca = last

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in_size) to (B, width of the frozen layer)."""
        out: Tensor = self.inverse_pca(self.coefficients(x))
        return out


class DeformationDecoder(nn.Module):
    """z_att and a one-hot speaker to s and r.

    Parameters
    ----------
    in_size : int
        Width of z_att.
    n_speakers : int
        P.
    layers : (InversePCA, InversePCA)
        Frozen layers of stretch and of rotation.
    shared : int
        Width of z_dec.
    hidden : (int, int)
        Widths within a branch.
    normalise_weights : bool
        Weight normalisation on every layer that learns (§4.4); the frozen ones have none.
    """

    def __init__(
        self,
        in_size: int,
        n_speakers: int,
        layers: tuple[InversePCA, InversePCA],
        *,
        shared: int = 512,
        hidden: tuple[int, int] = (512, 256),
        normalise_weights: bool = True,
    ) -> None:
        super().__init__()
        self.shared = nn.Sequential(nn.Linear(in_size + n_speakers, shared), nn.LeakyReLU(SLOPE))
        self.stretch = Branch(shared + n_speakers, hidden, layers[0])
        self.rotation = Branch(shared + n_speakers, hidden, layers[1])
        if normalise_weights:
            for module in [m for m in self.modules() if isinstance(m, nn.Linear)]:
                weight_norm(module)

    def forward(self, attended: Tensor, speaker: Tensor) -> Deformation:
        """Map z_att (B, in_size) and one-hot speakers (B, P) to s (B, 6 N) and r (B, 3 N)."""
        decoded = self.shared(torch.cat((attended, speaker), dim=1))
        joined = torch.cat((decoded, speaker), dim=1)
        return Deformation(self.stretch(joined), self.rotation(joined))


def frozen_layers(bases: Bases) -> tuple[InversePCA, InversePCA]:
    """The two last layers of fitted bases."""
    return InversePCA.of(bases.stretch), InversePCA.of(bases.rotation)
