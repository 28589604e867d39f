"""Model folders: configuration, weights and their history, without pickle.

::

    config.yaml          every setting of the model
    model.safetensors    weights (float16 in shipped models)
    model.json           format version, control set, training summary
"""

import hashlib
import json
from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from deitalk.config import Config, load_config
from deitalk.errors import CheckpointError
from deitalk.models.weights_file import check_fit, network_shapes, read_shapes, read_weights
from rig import ControlSet, default_controls, limits
from rig.errors import quoted
from rig.files import output_folder
from rig.files.reading import check_file, open_file, read_json

if TYPE_CHECKING:
    from deitalk.models.curve_model import DEITalk

FORMAT_VERSION = 1
EMBEDDED = ("default", "compact", "sdfa", "mesh_head")
"""Models that come with the package; `embedded_models` lists those that are there."""


def embedded_models() -> list[str]:
    """Names of the models inside the package."""
    folder = resources.files("deitalk.models").joinpath("weights")
    return [name for name in EMBEDDED if folder.joinpath(name, "model.safetensors").is_file()]


def save_model(
    folder: Path, model: "DEITalk", config: Config, summary: dict[str, Any], *, half: bool = False
) -> None:
    """Write a model folder; the files of one that was written before are replaced.

    Parameters
    ----------
    folder : Path
        Its parent must exist.
    model : DEITalk
        On any device.
    config : Config
        What built the model.
    summary : dict
        What trained it: steps, data, scores.
    half : bool
        Store float16.

    Raises
    ------
    rig.errors.TargetError
        If the folder holds files that deitalk did not write, or edited ones.
    """
    import torch
    from safetensors.torch import save

    weights = {
        name: value.half() if half and value.dtype == torch.float32 else value
        for name, value in model.state_dict().items()
    }
    weights = {name: value.detach().cpu().contiguous() for name, value in weights.items()}
    about = {
        "format_version": FORMAT_VERSION,
        "control_set": model.controls.id,
        "controls": list(model.controls.names),
        "parameters": sum(p.numel() for p in model.parameters()),
        "training": summary,
    }
    with output_folder(folder, kind="model", force=True) as beside:
        # save_file would make a file that nobody else may read.
        (beside / "model.safetensors").write_bytes(save(weights))
        settings = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
        (beside / "config.yaml").write_text(settings)
        (beside / "model.json").write_text(json.dumps(about, indent=1) + "\n")


def model_folder(name_or_path: str | Path) -> Path:
    """Folder of an embedded model or of one on disk.

    Raises
    ------
    CheckpointError
        If there is neither; it lists the embedded ones.
    """
    if str(name_or_path) in EMBEDDED:
        folder = Path(str(resources.files("deitalk.models").joinpath("weights", str(name_or_path))))
    else:
        folder = Path(name_or_path)
    if not (folder / "model.safetensors").is_file() or not (folder / "config.yaml").is_file():
        raise CheckpointError(
            f"{name_or_path}: no model there (config.yaml and model.safetensors); name a folder "
            f"or one of {', '.join(embedded_models()) or 'no embedded models'}"
        )
    return folder


def describe_model(name_or_path: str | Path) -> dict[str, Any]:
    """What ``model.json`` says, with the hash and size of the weights; imports no torch."""
    folder = model_folder(name_or_path)
    about = read_about(folder)
    weights = folder / "model.safetensors"
    about.pop("controls", None)
    size = check_file(weights, limits.WEIGHTS_BYTES, error=CheckpointError)
    with open_file(weights, limits.WEIGHTS_BYTES, error=CheckpointError) as stream:
        digest = hashlib.sha256()
        while part := stream.read(limits.MIB):
            digest.update(part)
    return {
        "name": str(name_or_path),
        **about,
        "bytes": size,
        "sha256": digest.hexdigest(),
    }


def read_about(folder: Path) -> dict[str, Any]:
    """What a folder's ``model.json`` says, if this version reads it."""
    path = folder / "model.json"
    try:
        about = read_json(path, limits.MODEL_JSON_BYTES, error=CheckpointError)
        version, _, _ = about["format_version"], about["control_set"], about["controls"]
    except (CheckpointError, KeyError, TypeError):
        raise CheckpointError(
            f"{path}: missing or damaged; save the model again with `deitalk train`"
        ) from None
    if version != FORMAT_VERSION:
        raise CheckpointError(
            f"{path}: format version {quoted(version)}, this deitalk reads {FORMAT_VERSION}; "
            "use the deitalk that wrote it, or train again"
        )
    return dict(about)


def load_model(name_or_path: str | Path = "default", *, device: str = "cpu") -> "DEITalk":
    """Read a model, ready to predict.

    Parameters
    ----------
    name_or_path : str or Path
        ``default``, or a folder that `save_model` wrote.
    device : str
        ``cpu``, ``cuda``, ``cuda:N`` or ``mps``.

    Raises
    ------
    CheckpointError
        If there is no such model, its weights are damaged or too large, they do not fit its
        configuration, or it belongs to another control set.
    """
    import torch

    from deitalk.models.curve_model import DEITalk
    from deitalk.models.devices import require_device

    folder = model_folder(name_or_path)
    require_device(device)
    config = load_config(folder / "config.yaml")
    if not isinstance(config, Config):
        raise CheckpointError(
            f"{name_or_path}: an SDFA model moves meshes, not controls; animate a mesh with it"
        )
    controls = default_controls()
    _check_controls(folder, controls)
    make = partial(DEITalk, config.model, controls, pretrained=False)
    path = folder / "model.safetensors"
    check_fit(path, read_shapes(path), network_shapes(make))
    with torch.device("cpu"):  # also where another network is only sized
        model = make()
        model.load_state_dict(read_weights(path))  # half precision becomes float32
    try:
        return model.to(device).eval()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise CheckpointError(f"device {device!r}: {reason}; use the device cpu") from None


def _check_controls(folder: Path, controls: ControlSet) -> None:
    about = read_about(folder)
    if about["control_set"] != controls.id or about["controls"] != list(controls.names):
        raise CheckpointError(
            f"{folder}: made for control set {quoted(about['control_set'])}, this deitalk drives "
            f"{controls.id!r}; train on curves of that set"
        )
