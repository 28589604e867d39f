"""Feature distillation: the speech features of a trained model, the teacher, as a second target.

Curves constrain an encoder weakly, so that one with random weights needs many hours of them. The
squared distance to the features of the teacher's frontend (as FitNets, Romero et al. 2015) is
added to the loss. The student's input is augmented by rooms and noise, the teacher's is not, so
that a student of the teacher's own kind becomes robust to them. The student is initialised with
the teacher's weights of equal name and shape (`deitalk.training.curve_losses.start_as`).

Not in the papers, which initialise with published wav2vec 2.0 weights.

Letters: B batch, S samples, T rig frames, D width of the features.
"""

import torch
from torch import Tensor

from deitalk.errors import ConfigError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.training.several_processes import in_precision


def read_teacher(name: str, student: DEITalk) -> DEITalk:
    """Read the teacher of `student`.

    Raises
    ------
    ConfigError
        If its speech features are of another width than the student's.
    CheckpointError
        If there is no such model.
    """
    teacher = require_model(name, DEITalk).requires_grad_(False)
    width, wanted = student.frontend.output_size, teacher.frontend.output_size
    if width != wanted:
        way_out = {
            "mel": f"time_hidden={wanted // 2}",
            "causal_whisper": f"width={wanted}",
            "whisper": f"width={wanted}",
            "wav2vec": f"encoder.hidden_size={wanted}",
        }
        raise ConfigError(
            f"train.teacher={name!r} has {wanted} features a frame, the model {width}; set "
            f"model.frontend.{way_out[student.config.frontend.kind]}"
        )
    return teacher


MOTION_WEIGHT = 4.0
"""Weight of the distance between frames; the paper's lambda_4 to its lambda_3 of 1. Much of the
features changes slowly (speaker, room); lips move faster."""


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
        # require_model returns it in evaluation mode, without dropout.
        frontend = model.get_submodule("frontend").to(device)
        self.frontend = in_precision(frontend, precision, device)

    def distance(self, clean: Tensor, speech: Tensor) -> Tensor:
        """Mean squared distance of the student's features and the teacher's, and of their motion.

        The teacher's features are those of the sound before augmentation.

        Parameters
        ----------
        clean : Tensor [shape=(B, S)]
            The student's input before augmentation; or the teacher's features (B, T, D).
        speech : Tensor [shape=(B, T, D)]
            The student's features; gradients flow into them alone.

        Returns
        -------
        Tensor, scalar
            In units of the teacher's features, whose variance is about 1.
        """
        with torch.no_grad():
            target: Tensor = clean if clean.dim() == 3 else self.frontend(clean, speech.shape[1])
        error = speech.float() - target.float()
        return error.square().mean() + MOTION_WEIGHT * error.diff(dim=1).square().mean()
