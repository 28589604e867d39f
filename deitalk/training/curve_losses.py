"""The four-part loss (DEITalk §3.5, Eq. 8-13) and the parts we add.

Letters: B batch, T frames, C controls, E width of the joint embedding.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.config.curves import LossConfig
from deitalk.data.windows import Window
from deitalk.models.curve_model import DEITalk, Output


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
    return copied


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


class CurveLoss:
    """The configured loss (Eq. 8).

    Parameters
    ----------
    config : LossConfig
        Weights of the parts.
    hold : float
        Weight, in Eq. 12-13, of controls that are not known; no other part depends on them.
    """

    def __init__(self, config: LossConfig, hold: float = 0.0) -> None:
        self.config, self.hold = config, hold

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

    def weights(self, known: Tensor) -> Tensor:
        """Weight of every control in Eq. 12-13 [shape=(B, 1, C)], of those known (B, C)."""
        return (known + self.hold * (1 - known))[:, None]

    def parts(self, output: Output, batch: Window, known: Tensor) -> dict[str, Tensor]:
        """Every part of the loss of a network's output, and ``total``.

        Parameters
        ----------
        output : Output
            Of the network, given the curves too.
        batch : Window
            Its targets.
        known : Tensor [shape=(B, C)]
            1 for controls that a clip's curves hold, else 0.
        """
        config, weights = self.config, self.weights(known)
        parts = {
            "position": position_loss(batch.curves, output.curves, weights),
            "velocity": velocity_loss(batch.curves, output.curves, weights),
        }
        found = output.intensity
        if config.contrast and found is not None and output.motion_embedding is not None:
            parts["contrast"] = contrast_loss(
                found.embedding, output.motion_embedding, config.temperature
            )
        if output.emotion_logits is not None:
            parts["classification"] = classification_loss(output.emotion_logits, batch.voice)
        if found is not None:
            parts["intensity"] = intensity_loss(batch.intensity, found.strength)
        total = [getattr(config, name) * part for name, part in parts.items()]
        return parts | {"total": torch.stack(total).sum()}
