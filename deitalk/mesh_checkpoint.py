"""Folders of SDFA models: as `deitalk.checkpoint`, with the templates beside the weights.

::

    config.yaml          every setting (kind: sdfa)
    model.safetensors    weights and the frozen bases, float16 if asked for
    templates.npz        expressionless vertices of every speaker, and the triangles
    model.json           format version, speakers, frame rate, unit, training summary
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from safetensors.torch import save_file

from deitalk.checkpoint import FORMAT_VERSION, model_folder, read_about, read_weights
from deitalk.config import SDFAConfig, load_config
from deitalk.deformation_decoder import InversePCA
from deitalk.errors import CheckpointError
from deitalk.sdfa import SDFA
from rig.files import atomic_write
from rig.mesh import TriMesh

CONTROL_SET = "none (meshes)"
"""Stands where other models name their controls."""


def save_sdfa(
    folder: Path, model: SDFA, config: SDFAConfig, summary: dict[str, Any], *, half: bool = True
) -> None:
    """Write a model folder; an existing one is replaced at once.

    Parameters
    ----------
    folder : Path
        Its parent must exist.
    model : SDFA
        On any device.
    config : SDFAConfig
        What built the model.
    summary : dict
        What trained it: steps, data, scores.
    half : bool
        Store the frozen bases in float16, which is what they were fitted in; all else stays
        float32.
    """
    weights = {
        name: value.detach().cpu().half()
        if half and "inverse_pca" in name
        else value.detach().cpu()
        for name, value in model.state_dict().items()
    }
    about = {
        "format_version": FORMAT_VERSION,
        "kind": "sdfa",
        "control_set": CONTROL_SET,
        "controls": [],
        "speakers": list(model.speakers),
        "fps": model.fps,
        "unit_mm": model.unit_mm,
        "parameters": sum(p.numel() for p in model.parameters()),
        "training": summary,
    }
    meshes = [model.templates[speaker] for speaker in model.speakers]
    with atomic_write(folder) as beside:
        beside.mkdir(parents=True)
        contiguous = {name: value.contiguous() for name, value in weights.items()}
        save_file(contiguous, beside / "model.safetensors")
        np.savez_compressed(
            beside / "templates.npz",
            vertices=np.stack([mesh.vertices for mesh in meshes]),
            faces=meshes[0].faces.astype(np.int32),
        )
        settings = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
        (beside / "config.yaml").write_text(settings)
        (beside / "model.json").write_text(json.dumps(about, indent=1) + "\n")


def load_sdfa(folder: Path | str, *, device: str = "cpu") -> SDFA:
    """Read a model, ready to predict.

    Raises
    ------
    CheckpointError
        If there is no such model, it is of another kind, or a file is damaged.
    """
    path = model_folder(folder)
    about = read_about(path)
    config = load_config(path / "config.yaml")
    if not isinstance(config, SDFAConfig):
        raise CheckpointError(f"{path}: no SDFA model but curves; use deitalk.load_model")
    weights = read_weights(path / "model.safetensors")
    try:
        with np.load(path / "templates.npz", allow_pickle=False) as file:
            vertices, faces = file["vertices"], file["faces"]
        meshes = [TriMesh(rows, faces) for rows in vertices]
        templates = dict(zip(about["speakers"], meshes, strict=True))
        layers = _empty_layers(weights)
        fps, unit_mm = float(about["fps"]), float(about["unit_mm"])
        model = SDFA(config.model, layers, about["speakers"], templates, fps=fps, unit_mm=unit_mm)
        model.load_state_dict({name: value.float() for name, value in weights.items()})
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise CheckpointError(f"{path}: files do not fit one another ({reason})") from None
    try:
        return model.to(torch.device(device)).eval()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise CheckpointError(f"device {device!r}: {reason}; use --device cpu") from None


def _empty_layers(weights: dict[str, torch.Tensor]) -> tuple[InversePCA, InversePCA]:
    stretch, rotation = (
        weights[f"decoder.{branch}.inverse_pca.components"].shape
        for branch in ("stretch", "rotation")
    )
    return InversePCA(*stretch), InversePCA(*rotation)
