"""The four-part loss (DEITalk §3.5, Eq. 8-13) and the parts we add.

Letters: B batch, T frames, C controls, E width of the joint embedding.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.config.curves import LossConfig
from deitalk.data.windows import Window
from deitalk.errors import ConfigError
from deitalk.models.curve_model import DEITalk, Output
from deitalk.models.rig_decoder import TemporalConv
from deitalk.training.several_processes import gather_rows
from rig import ControlSet


@torch.no_grad()
def start_as(student: DEITalk, teacher: DEITalk) -> list[str]:
    """Copy the teacher's weights of equal name and shape; the frontend's if it is of one kind.

    Returns
    -------
    list of str
        Names of the weights that were copied.
    """
    theirs = teacher.state_dict()
    alike = teacher.config.frontend.kind == student.config.frontend.kind
    copied = []
    for name, value in student.state_dict().items():
        given = theirs.get(name)
        if given is None or given.shape != value.shape:
            continue
        if name.startswith("frontend.") and not alike:
            continue
        value.copy_(given)
        copied.append(name)
    if student.is_causal and not teacher.is_causal:
        turn_to_the_past(student.decoder)
    return copied


@torch.no_grad()
def turn_to_the_past(decoder: nn.Module) -> None:
    """Move the taps of symmetric kernels (..., K) to those of causal ones, in place.

    The taps after the centre are added to it: what does not change with time has the same result.
    """
    for module in decoder.modules():
        if isinstance(module, TemporalConv):
            kernel = module.conv.weight
            half, symmetric = kernel.shape[-1] // 2, kernel.clone()
            kernel.zero_()
            kernel[..., half:] = symmetric[..., : half + 1]
            kernel[..., -1] = symmetric[..., half:].sum(dim=-1)


def contrast_loss(speech: Tensor, motion: Tensor, temperature: float) -> Tensor:
    """Pull the embeddings of one clip together, push those of others apart (Eq. 9-10).

    Parameters
    ----------
    speech, motion : Tensor [shape=(B, E)]
        s_max and m_max; row i of both belongs to clip i.
    temperature : float
        tau > 0.

    Returns
    -------
    Tensor, scalar
        0 for perfect pairs and tau -> 0; log B where every pair is alike.
    """
    similarity = F.normalize(speech, dim=-1) @ F.normalize(motion, dim=-1).T / temperature
    target = torch.arange(len(similarity), device=similarity.device)
    return (F.cross_entropy(similarity, target) + F.cross_entropy(similarity.T, target)) / 2


def classification_loss(logits: Tensor, emotion: Tensor) -> Tensor:
    """Cross entropy of the predicted emotional style (Eq. 11).

    Parameters
    ----------
    logits : Tensor [shape=(B, 5)]
        Before the softmax.
    emotion : Tensor [shape=(B, 5)]
        One-hot, or weights that sum to 1.
    """
    return F.cross_entropy(logits, emotion)


def position_loss(target: Tensor, predicted: Tensor, weights: Tensor | None = None) -> Tensor:
    """Squared distance of the curves, summed over controls, averaged over frames (Eq. 12).

    Parameters
    ----------
    target, predicted : Tensor [shape=(B, T, C)]
        Captured and predicted curves.
    weights : Tensor [shape=(C,) or (B, 1, C)] or None
        Weight of every control's square; the paper's are 1.
    """
    square = (target - predicted).square()
    return (square if weights is None else square * weights).sum(-1).mean()


def velocity_loss(target: Tensor, predicted: Tensor, weights: Tensor | None = None) -> Tensor:
    """`position_loss` of the differences between successive frames (Eq. 13)."""
    return position_loss(target.diff(dim=1), predicted.diff(dim=1), weights)


def intensity_loss(target: Tensor, strength: Tensor) -> Tensor:
    """Squared error of the predicted intensity where one is labelled.

    Not in the paper, which has no labels; a corpus of synthesised prosody has.

    Parameters
    ----------
    target : Tensor [shape=(B, T)]
        Labelled intensity in 0..1; NaN where there is none.
    strength : Tensor [shape=(B, T)]
        Predicted intensity in 0..1.
    """
    known = torch.isfinite(target)
    square = (torch.where(known, target, 0.0) - strength).square() * known
    return square.sum() / known.sum().clamp(min=1)


def contact_loss(target: Tensor, predicted: Tensor, known: Tensor | None = None) -> Tensor:
    """Penalise lips that do not meet in bilabials.

    Not in the paper. Where the target's lips are closed (> 0.9), falling short of 0.95 costs the
    square of what is missing;
    everywhere, the prediction's side of one half is scored by a cross entropy, so that the curve
    is decided rather than blurred.

    Parameters
    ----------
    target, predicted : Tensor [shape=(B, T, K)]
        The lips-together controls.
    known : Tensor [shape=(B, K)] or None
        1 where the clip holds the control, else 0; None is 1 everywhere.
    """
    shut = F.relu(0.95 - predicted).square() * (target > 0.9)
    decided = F.binary_cross_entropy_with_logits(
        8 * (predicted - 0.5), target.clamp(0, 1), reduction="none"
    )
    cost = (shut + 0.1 * decided).mean(dim=1)
    known = torch.ones_like(cost) if known is None else known
    return (cost * known).sum() / known.sum().clamp(min=1)


def total_loss(
    output: Output,
    curves: Tensor,
    emotion: Tensor,
    intensity: Tensor,
    *,
    config: LossConfig,
    known: Tensor,
    weights: Tensor,
    hold: float = 0.0,
    contact_controls: Tensor,
) -> dict[str, Tensor]:
    """Every part, and their weighted sum as ``total`` (Eq. 8).

    Parameters
    ----------
    output : Output
        Of the network, given `curves` too.
    curves : Tensor [shape=(B, T, C)]
        Captured.
    emotion : Tensor [shape=(B, 5)]
        Captured emotion, the target of the classifier.
    intensity : Tensor [shape=(B, T)]
        NaN where unknown.
    config : LossConfig
        Weights of the parts.
    known : Tensor [shape=(B, C)]
        1 for controls that a clip's curves hold, else 0.
    weights : Tensor [shape=(C,)]
        Of the controls, in Eq. 12-13.
    hold : float
        Weight of controls that are not known, in Eq. 12-13; no other part depends on them.
    contact_controls : Tensor [shape=(K,)]
        Indices of the lips-together controls.
    """
    weights = weights * (known + hold * (1 - known))[:, None]
    parts = {
        "position": position_loss(curves, output.curves, weights),
        "velocity": velocity_loss(curves, output.curves, weights),
    }
    if config.contrast and output.intensity is not None and output.motion_embedding is not None:
        parts["contrast"] = contrast_loss(
            output.intensity.embedding, output.motion_embedding, config.temperature
        )
    if output.emotion_logits is not None:
        parts["classification"] = classification_loss(output.emotion_logits, emotion)
    if output.intensity is not None:
        parts["intensity"] = intensity_loss(intensity, output.intensity.strength)
    if config.contact and len(contact_controls):
        parts["contact"] = contact_loss(
            curves[..., contact_controls],
            output.curves[..., contact_controls],
            known[:, contact_controls],
        )
    settings = config.model_dump()
    parts["total"] = torch.stack([settings[name] * part for name, part in parts.items()]).sum()
    return parts


class CurveLoss:
    """The configured loss on one device.

    Parameters
    ----------
    config : LossConfig
        Weights of the parts.
    controls : ControlSet
        Columns of the curves.
    device : torch.device
        Where batches are.
    hold : float
        As for `total_loss`.

    Raises
    ------
    ConfigError
        If a control weight's name is unknown.
    """

    def __init__(
        self,
        config: LossConfig,
        controls: ControlSet,
        device: torch.device,
        hold: float = 0.0,
    ) -> None:
        self.config, self.hold = config, hold
        self.weights = control_weights(config.control_weights, controls).to(device)
        self.contact = torch.tensor(
            [i for i, name in enumerate(controls.names) if "lipsTogether" in name], device=device
        )

    def __call__(
        self, network: nn.Module, batch: Window, motion: Tensor | None = None
    ) -> dict[str, Tensor]:
        """Every part of the loss of one batch, and their weighted sum as ``total``.

        `motion` [shape=(B, T, C)] is what the voice belongs to, where the targets are other curves.
        """
        motion = batch.curves if motion is None else motion
        curves = motion if self.config.contrast else None
        output = network(batch.waveform, batch.emotion, batch.frames, batch.total, curves)
        return self.parts(output, batch, batch.known)

    def parts(self, output: Output, batch: Window, known: Tensor) -> dict[str, Tensor]:
        """Every part of the loss of a network's output; `known` as for `total_loss`."""
        return total_loss(
            across_processes(output),
            batch.curves,
            batch.voice,
            batch.intensity,
            config=self.config,
            known=known,
            weights=self.weights,
            hold=self.hold,
            contact_controls=self.contact,
        )


def across_processes(output: Output) -> Output:
    """Embeddings of all processes' clips: contrast (Eq. 9-10) is of the whole batch."""
    if output.intensity is None or output.motion_embedding is None:
        return output
    speech, motion = gather_rows(output.intensity.embedding), gather_rows(output.motion_embedding)
    return output._replace(
        intensity=output.intensity._replace(embedding=speech), motion_embedding=motion
    )


def control_weights(weights: dict[str, float], controls: ControlSet) -> Tensor:
    """Weight of every control from names of controls and of subsets; later entries win.

    Raises
    ------
    ConfigError
        If a name is neither.
    """
    out = torch.ones(len(controls.names))
    for name, value in weights.items():
        if name in controls.names:
            out[controls.index(name)] = value
        elif name in controls.subset_names:
            out[torch.as_tensor(controls.subset(name).copy())] = value
        else:
            matching = [i for i, control in enumerate(controls.names) if name in control]
            if not matching:
                raise ConfigError(
                    f"loss.control_weights: {name!r} is no control, part of one, or subset; "
                    f"subsets are {', '.join(controls.subset_names)}"
                )
            out[matching] = value
    return out
