"""Feature distillation: the speech features of a trained model, the teacher, as a second target.

Curves constrain an encoder weakly, so that one with random weights needs many hours of them. The
squared distance to the features of the teacher's frontend (as FitNets, Romero et al. 2015) is added
to the loss. The student's input is augmented by rooms and noise, the teacher's is not, so that a
student of the teacher's own kind becomes robust to them. The student is initialised with the
teacher's weights of equal name and shape.

Not in the papers, which initialise with published wav2vec 2.0 weights.

Letters: B batch, S samples, T rig frames, D width of the features.
"""

import torch
from torch import Tensor

from deitalk.errors import ConfigError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.temporal_conv import TemporalConv
from deitalk.training.processes import in_precision


def read_teacher(name: str | None, student: DEITalk) -> DEITalk | None:
    """Read the teacher of `student`; None without a name.

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
            "causal_mel": f"time_hidden={wanted}",
            "whisper": f"width={wanted}",
            "wav2vec": f"encoder.hidden_size={wanted}",
        }
        raise ConfigError(
            f"train.teacher={name!r} has {wanted} features a frame, the model {width}; set "
            f"model.frontend.{way_out[student.config.frontend.kind]}"
        )
    return teacher


@torch.no_grad()
def start_as(student: DEITalk, teacher: DEITalk) -> list[str]:
    """Copy the teacher's weights of equal name and shape; the frontend's if it is of one kind.

    A causal frontend takes the layers that gather one spectrum from a mel frontend.

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
        if name.startswith("frontend.") and not alike and ".spectral." not in name:
            continue
        value.copy_(given)
        copied.append(name)
    if student.is_causal and not teacher.is_causal:
        for module in student.decoder.modules():
            if isinstance(module, TemporalConv):
                # Move the taps of a symmetric kernel (..., K) to a causal one's, in place.
                # The taps after the centre are added to it: what does not change with time has the
                # same result.
                kernel = module.conv.weight
                half = kernel.shape[-1] // 2
                symmetric = kernel.clone()
                kernel.zero_()
                kernel[..., half:] = symmetric[..., : half + 1]
                kernel[..., -1] = symmetric[..., half:].sum(dim=-1)
    return copied


MOTION_WEIGHT = 4.0
"""Of the distance between frames; the paper's lambda_4 to its lambda_3 of 1. Much of the features
changes slowly (speaker, room); lips move faster."""


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
