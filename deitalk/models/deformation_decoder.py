"""Speech feature and speaker to coefficients of motion, and to motion (SDFA §3.4, Table 3).

B frames here. With the paper's sizes::

    z_att 512 + speaker 8 = 520 -> 512 = z_dec
    z_dec 512 + speaker 8 = 520 -> 512 -> 256 -> K ->  6 N  (stretch s,  K = 85)
                            520 -> 512 -> 256 -> K ->  3 N  (rotation r, K = 180)

Deviation: Table 3 prints 59865 for 6 N; with N = 9976 (§4.1) it is 59856. A model that predicts
vertex offsets has one branch, K -> 3 V.
"""

from collections.abc import Mapping
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn.utils.parametrizations import weight_norm

SLOPE = 0.2
"""Leak of every leaky ReLU (Table 3)."""

Coefficients = dict[str, Tensor]
"""By branch, each [shape=(..., K)]."""


class Deformation(NamedTuple):
    """Packed gradients of B frames, S - I and rotation vectors (SDFA §3.4)."""

    s: Tensor
    """Stretch S - I [shape=(B, 6 N)]."""
    r: Tensor
    """Rotation vectors [shape=(B, 3 N), radians]."""


class Offsets(NamedTuple):
    """Vertices of B frames minus the template's."""

    offsets: Tensor
    """[shape=(B, 3 V)], the templates' unit."""


Motion = Deformation | Offsets


class InversePCA(nn.Module):
    """The frozen last layer: coefficients of unit variance to gradients or offsets of a frame.

    Parameters
    ----------
    size : int
        K.
    width : int
        6 N, 3 N or 3 V.

    Notes
    -----
    Buffers, not parameters: nothing trains them. `deviations` are the weighted standard deviations
    along the components; only the loss uses them.

    Paper silent: the scale of the coefficients. Components carry their standard deviation, so that
    the layer before predicts numbers of one size; zeros give the mean shape.
    """

    mean: Tensor
    components: Tensor
    deviations: Tensor

    def __init__(self, size: int, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("components", torch.zeros(size, width))
        self.register_buffer("deviations", torch.ones(size))

    def rest(self) -> Tensor:
        """Coefficients [shape=(K,)] of the smallest motion that the basis can give."""
        across = self.components @ self.components.T
        nearest: Tensor = -torch.linalg.solve(across, self.components @ self.mean)
        return nearest

    def forward(self, coefficients: Tensor) -> Tensor:
        """Map (B, K) to (B, width)."""
        return torch.addmm(self.mean, coefficients, self.components)


class Branch(nn.Module):
    """One of the two parallel branches of Table 3.

    Parameters
    ----------
    in_size : int
        Width of z_dec and the speaker together.
    hidden : tuple of int
        Widths of the hidden layers; the last has tanh, those before leaky ReLU.
    last : InversePCA
        The frozen layer.
    """

    def __init__(self, in_size: int, hidden: tuple[int, ...], last: InversePCA) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        before = in_size
        for i, width in enumerate(hidden):
            is_last = i == len(hidden) - 1
            layers += [nn.Linear(before, width), nn.Tanh() if is_last else nn.LeakyReLU(SLOPE)]
            before = width
        self.coefficients = nn.Sequential(*layers, nn.Linear(before, len(last.components)))
        self.inverse_pca = last

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, in_size) to (B, width of the frozen layer)."""
        out: Tensor = self.inverse_pca(self.coefficients(x))
        return out


class MotionDecoder(nn.Module):
    """z_att and a one-hot speaker to the coefficients of every branch.

    Parameters
    ----------
    in_size : int
        Width of z_att.
    n_speakers : int
        Q.
    layers : mapping of str to InversePCA
        Frozen layers by branch: ``stretch`` and ``rotation``, or ``offsets``.
    shared : int or None
        Width of z_dec; None: the branches take z_att itself.
    hidden : tuple of int
        Widths within a branch.
    normalise_weights : bool
        Weight normalisation on every trained layer (§4.4).
    """

    branches: Mapping[str, Branch]
    """An `nn.ModuleDict`, typed by its modules."""

    def __init__(
        self,
        in_size: int,
        n_speakers: int,
        layers: Mapping[str, InversePCA],
        *,
        shared: int | None = 512,
        hidden: tuple[int, ...] = (512, 256),
        normalise_weights: bool = True,
    ) -> None:
        super().__init__()
        self.shared = (
            None
            if shared is None
            else nn.Sequential(nn.Linear(in_size + n_speakers, shared), nn.LeakyReLU(SLOPE))
        )
        joined = (in_size if shared is None else shared) + n_speakers
        branches = {name: Branch(joined, hidden, layer) for name, layer in layers.items()}
        self.branches = cast("Mapping[str, Branch]", nn.ModuleDict(branches))
        if normalise_weights:
            for module in [m for m in self.modules() if isinstance(m, nn.Linear)]:
                weight_norm(module)

    def forward(self, attended: Tensor, speaker: Tensor) -> Coefficients:
        """Map z_att (..., in_size) and one-hot speakers (..., Q) to coefficients (..., K)."""
        joined = torch.cat((attended, speaker), dim=-1)
        if self.shared is not None:
            joined = torch.cat((self.shared(joined), speaker), dim=-1)
        return {name: branch.coefficients(joined) for name, branch in self.branches.items()}

    def expand(self, coefficients: Coefficients) -> Motion:
        """Gradients or offsets of B frames from coefficients (B, K): the frozen layers."""
        rows = {
            name: branch.inverse_pca(coefficients[name]) for name, branch in self.branches.items()
        }
        if "offsets" in rows:
            return Offsets(rows["offsets"])
        return Deformation(rows["stretch"], rows["rotation"])

    @property
    def deviations(self) -> dict[str, Tensor]:
        """Weighted standard deviation of every branch's components, each [shape=(K,)]."""
        return {name: branch.inverse_pca.deviations for name, branch in self.branches.items()}
