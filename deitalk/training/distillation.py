"""Learning what a trained model hears: its speech features are a second target.

Curves say little about a waveform, so an encoder that begins from nothing needs many hours of them.
A trained model's frontend says what of a sound moves a face: the squared distance to its features
(feature distillation, as FitNets, Romero et al. 2015) is added to the loss. The student hears the
sound through rooms and noise, the teacher without them, so that a student of the teacher's own kind
learns too: to hear in noise. It begins with the teacher's weights wherever they fit.

Not in the papers, which begin with published wav2vec 2.0 weights where we begin with these.

Letters: B batch, S samples, T rig frames, D width of the features.
"""

import torch
from torch import Tensor

from deitalk.errors import ConfigError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.training.processes import in_precision


def read_teacher(name: str | None, student: DEITalk) -> DEITalk | None:
    """Read the model that teaches `student`; None without a name.

    Raises
    ------
    ConfigError
        If its speech features are of another width than the student's.
    CheckpointError
        If there is no such model.
    """
    if name is None:
        return None
    teacher = require_model(name, DEITalk).requires_grad_(False)
    width, wanted = student.frontend.output_size, teacher.frontend.output_size
    if width != wanted:
        way_out = {
            "mel": f"time_hidden={wanted // 2}",
            "conformer": f"hidden_size={wanted}",
            "wav2vec": f"encoder.hidden_size={wanted}",
        }
        raise ConfigError(
            f"train.teacher={name!r} hears {wanted} features a frame, the model {width}; set "
            f"model.frontend.{way_out[student.config.frontend.kind]}"
        )
    return teacher


@torch.no_grad()
def start_as(student: DEITalk, teacher: DEITalk) -> list[str]:
    """Copy the teacher's weights to all places where they fit; a frontend's to its own kind.

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


MOTION_WEIGHT = 4.0
"""Of the distance between frames; the paper's lambda_4 to its lambda_3 of 1. Features say much that
changes slowly (who speaks, where); lips move faster."""


class Teacher:
    """The frozen frontend of a trained model.

    Parameters
    ----------
    model : DEITalk
        From `read_teacher`.
    device : torch.device
        Where batches are.
    precision : str
        ``float32`` or ``bfloat16``, as the student's.
    """

    def __init__(self, model: DEITalk, device: torch.device, precision: str = "float32") -> None:
        # require_model gave it in evaluation mode: no dropout while it teaches.
        frontend = model.get_submodule("frontend").to(device)
        self.frontend = in_precision(frontend, precision, device)

    def distance(self, clean: Tensor, speech: Tensor) -> Tensor:
        """Mean squared distance of the student's features and the teacher's, and of their motion.

        The teacher hears the sound before it was augmented: what it hears there is what the
        student is to hear through rooms and noise.

        Parameters
        ----------
        clean : Tensor [shape=(B, S)]
            What the student heard, before augmentation.
        speech : Tensor [shape=(B, T, D)]
            The student's features; gradients flow into them alone.

        Returns
        -------
        Tensor, scalar
            In units of the teacher's features, whose variance is about 1.
        """
        with torch.no_grad():
            target: Tensor = self.frontend(clean, speech.shape[1])
        error = speech.float() - target.float()
        return error.square().mean() + MOTION_WEIGHT * error.diff(dim=1).square().mean()
