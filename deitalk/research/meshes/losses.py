"""The loss of SDFA: values and differences of every branch, weighed automatically (§4.2).

Letters: B segments, T frames, K components of a basis, P pairs of facing lip vertices.
"""

from collections.abc import Mapping
from types import MappingProxyType

import torch
from torch import Tensor, nn

from deitalk.models.deformation_decoder import Coefficients
from deitalk.models.mesh_model import MeshModel
from deitalk.research.config import MeshTrainConfig
from deitalk.research.meshes.folder import MeshFolder
from deitalk.research.meshes.lip_regression import LipRegression
from deitalk.research.meshes.segments import Segment, SegmentBatches
from deitalk.training.several_processes import mean_over_processes

LIPS = "lips"
"""Name of the term that the paper does not have."""
SEAL_MM = 1.0
"""Gap at which facing vertices weigh half as much as where they touch."""


def value_loss(predicted: Tensor, target: Tensor, deviations: Tensor) -> Tensor:
    """Squared error of a frame, over its triangles as the bases weigh them (Eq. 7).

    Parameters
    ----------
    predicted, target : Tensor [shape=(B, T, K)]
        Coefficients of adjacent frames.
    deviations : Tensor [shape=(K,)]
        Weighted standard deviation along each component.

    Notes
    -----
    The components are orthogonal under the weights, so this is the squared error of the 6 N or
    3 N numbers themselves, less what no coefficients can give, at a thousandth of the work.
    Deviation: by default triangles count by their area (``data.weigh_triangles``), where the paper
    weighs them alike; small dense ones on the rims of lips and lids then count most and show least.
    """
    return ((predicted - target) * deviations).square().sum(dim=-1).mean()


def difference_loss(predicted: Tensor, target: Tensor, deviations: Tensor) -> Tensor:
    """Squared error of x_t - x_(t-1) (Eq. 8); arguments as `value_loss`."""
    error = (predicted - target) * deviations
    return (error[:, 1:] - error[:, :-1]).square().sum(dim=-1).mean()


def motion_terms(
    predicted: Coefficients, target: Coefficients, deviations: dict[str, Tensor]
) -> dict[str, Tensor]:
    """The terms of §4.2: ``<branch>_value`` and ``<branch>_difference`` of every branch."""
    parts: dict[str, Tensor] = {}
    for name, given in predicted.items():
        arguments = given, target[name], deviations[name]
        parts[f"{name}_value"] = value_loss(*arguments)
        parts[f"{name}_difference"] = difference_loss(*arguments)
    return parts


def term_names(branches: list[str], *, lips: bool) -> tuple[str, ...]:
    """Names of `motion_terms`, and of the lips' term if `lips`."""
    names = [f"{name}_{kind}" for name in branches for kind in ("value", "difference")]
    return (*names, LIPS) if lips else tuple(names)


def lip_loss(predicted: Tensor, target: Tensor, rest_parting: Tensor) -> Tensor:
    """Squared error in mm of the lips' rims and of what parts them.

    Deviation: not in the paper. Lips are a hundredth of the surface and all of a /b/: an error
    that is nothing on the cheek leaves them open. The parting counts most where it is small.

    Parameters
    ----------
    predicted, target : Tensor [shape=(B, T, 2 P, 3)]
        Offsets of the upper, then of the lower rim, mm.
    rest_parting : Tensor [shape=(B, 1, P, 3)]
        Upper less lower rim of the templates, mm.
    """
    place = (predicted - target).square().sum(dim=-1).mean()
    given, wanted = (upper - lower for upper, lower in
                     (rims.chunk(2, dim=2) for rims in (predicted, target)))  # fmt: skip
    gap: Tensor = (wanted + rest_parting).norm(dim=-1)
    weight = 1 / (1 + gap / SEAL_MM)
    parting = ((given - wanted).square().sum(dim=-1) * weight).mean()
    return place + 4 * parting


EPSILON = 1e-8
"""Keeps the weight of a term of zero finite."""


class AutomaticWeights(nn.Module):
    """Scale every term by how large it has lately been (the dynamic scalars of Karras et al. 2017).

    The form used, for every term l of step t::

        v_t = decay v_(t-1) + (1 - decay) l_t^2        v_0 = 0
        scaled = l_t / (sqrt(v_t / (1 - decay^t)) + epsilon)

    as Adam scales gradients by their second moment. v is no part of the gradient. The total is the
    sum of the scaled terms, so that each weighs about 1 whatever its unit, and keeps that weight
    as it falls.

    Paper silent: SDFA §4.2 has no more than "the dynamic scalars proposed by Karras et al."; it
    prints no formula, decay or epsilon. The form is that of Karras et al.'s loss normalisation as
    remembered: their paper is not at hand to check it against.

    Parameters
    ----------
    names : sequence of str
        Terms that `forward` will be given.
    decay : float
        Karras et al.'s beta_2.
    """

    second_moment: Tensor
    steps: Tensor

    def __init__(self, names: tuple[str, ...], decay: float = 0.99) -> None:
        super().__init__()
        self.names, self.decay = names, decay
        self.register_buffer("second_moment", torch.zeros(len(names), dtype=torch.float64))
        self.register_buffer("steps", torch.zeros((), dtype=torch.int64))

    def forward(
        self, parts: dict[str, Tensor], factors: Mapping[str, float] = MappingProxyType({})
    ) -> Tensor:
        """Sum of the scaled terms; when training, the means move on first.

        A step whose terms are not finite leaves the means as they were. `factors` weigh scaled
        terms that shall not weigh 1 (not in the paper).
        """
        terms = torch.stack([parts[name] for name in self.names])
        sizes = mean_over_processes(terms.detach())  # one scale for the whole batch
        if self.training and bool(sizes.isfinite().all()):
            squared = sizes.double().square().to(self.second_moment.device)
            self.second_moment.lerp_(squared, 1 - self.decay)
            self.steps += 1
        weights = self.weights().to(terms)
        weights = weights * weights.new_tensor([factors.get(name, 1.0) for name in self.names])
        return (terms * weights).sum()

    def weights(self) -> Tensor:
        """Factor of every term now; 1 before the first step."""
        if not int(self.steps):
            return torch.ones_like(self.second_moment)
        moment = self.second_moment / (1 - self.decay ** int(self.steps))
        return 1 / (moment.sqrt() + EPSILON)


class MeshLoss(nn.Module):
    """The terms of §4.2, that of the lips where it has a weight, and their scaled sum.

    Parameters
    ----------
    model : SDFA or MeshHead
        What is trained.
    settings : MeshTrainConfig
        Weight of the lips, decay of the automatic weights.
    folder : MeshFolder
        Templates and lips.
    segments : SegmentBatches
        The training clips.
    """

    def __init__(
        self,
        model: MeshModel,
        settings: MeshTrainConfig,
        folder: MeshFolder,
        segments: SegmentBatches,
    ) -> None:
        super().__init__()
        self.lip_weight, self.places = settings.lip_weight, segments.places
        names = term_names(list(model.decoder.deviations), lips=self.lip_weight > 0)
        self.balance = AutomaticWeights(names, decay=settings.loss_decay)
        self.lips: LipRegression | None = None
        if self.lip_weight:
            clips = [(clip.motion, clip.speaker) for clip in segments.clips]
            self.lips = LipRegression.fit(clips, folder, motion=model.config.motion)

    def forward(self, model: MeshModel, network: nn.Module, batch: Segment) -> dict[str, Tensor]:
        """Every term of one batch, not yet scaled, and the sum of the scaled terms as ``total``.

        Parameters
        ----------
        model : SDFA or MeshHead
            What is trained.
        network : Module
            Called in its place.
        batch : Segment
            On the device.
        """
        rows = network(batch.features, self.places.to(batch.features.device), batch.speaker)
        target = {name: getattr(batch, name) for name in rows}
        parts = motion_terms(rows, target, model.decoder.deviations)
        if self.lips is not None:
            predicted = self.lips(rows, batch.speaker)
            wanted = batch.lips * model.unit_mm
            parts[LIPS] = lip_loss(predicted, wanted, self.lips.rest_parting(batch.speaker))
        return parts | {"total": self.balance(parts, {LIPS: self.lip_weight})}
