"""Folders of SDFA models: as `deitalk.checkpoint`, with the templates beside the weights.

::

    config.yaml          every setting (kind: sdfa)
    model.safetensors    weights and the frozen bases, float16 if asked for; of these only the
                         numbers that move, which `moving` marks
    templates.npz        expressionless vertices of every speaker, and the triangles
    model.json           format version, speakers, frame rate, unit, training summary; of a mesh
                         head, the hash of the DEITalk weights whose features it decodes
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from safetensors.torch import save

from deitalk.checkpoint import FORMAT_VERSION, model_folder, read_about, read_weights
from deitalk.config import DEITalkFeaturesConfig, SDFAConfig, SDFAModelConfig, load_config
from deitalk.deformation_decoder import InversePCA
from deitalk.devices import require_device
from deitalk.errors import CheckpointError
from deitalk.mesh_head import MeshHead
from deitalk.sdfa import SDFA
from rig.files import output_folder
from rig.mesh import TriMesh

FROZEN = "inverse_pca"
"""Name of the frozen layers in the weights."""
CONTROL_SET = "none (meshes)"
"""Stands where other models name their controls."""


def mesh_kind(config: SDFAModelConfig) -> type[SDFA]:
    """The class of model a configuration asks for: with an encoder of its own, or DEITalk's."""
    return MeshHead if isinstance(config.frontend, DEITalkFeaturesConfig) else SDFA


def save_sdfa(
    folder: Path,
    model: SDFA,
    config: SDFAConfig,
    summary: dict[str, Any],
    *,
    half: bool = True,
    small: bool = False,
) -> None:
    """Write a model folder; the files of one that was written before are replaced.

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
        Store the frozen bases in float16, which is what they were fitted in.
    small : bool
        Store all else in float16 too.
    """
    weights = _only_moving(
        {name: value.detach().cpu() for name, value in model.state_dict().items()}
    )
    weights = {
        name: value.half()
        if value.is_floating_point() and (half if FROZEN in name else small)
        else value
        for name, value in weights.items()
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
    if isinstance(model, MeshHead):
        about["decodes_sha256"] = model.encoder.fingerprint
    meshes = [model.templates[speaker] for speaker in model.speakers]
    vertices = np.stack([mesh.vertices for mesh in meshes])
    with output_folder(folder, kind="model", force=True) as beside:
        contiguous = {name: value.contiguous() for name, value in weights.items()}
        (beside / "model.safetensors").write_bytes(save(contiguous))
        np.savez_compressed(
            beside / "templates.npz",
            vertices=vertices.astype(np.float32) if small else vertices,
            faces=meshes[0].faces.astype(np.int32),
        )
        settings = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
        (beside / "config.yaml").write_text(settings)
        (beside / "model.json").write_text(json.dumps(about, indent=1) + "\n")


def _only_moving(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Leave out the numbers that no component moves: most of a head's scalp, neck and back."""
    out = dict(weights)
    for name in [name for name in weights if name.endswith(f"{FROZEN}.components")]:
        layer = name.removesuffix(".components")
        components, mean = weights[name], weights[f"{layer}.mean"]
        moving = (components != 0).any(dim=0) | (mean != 0)
        out[name], out[f"{layer}.mean"] = components[:, moving], mean[moving]
        out[f"{layer}.moving"] = moving
    return out


def _all_numbers(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Undo `_only_moving`."""
    out = dict(weights)
    for name in [name for name in weights if name.endswith(f"{FROZEN}.moving")]:
        layer, moving = name.removesuffix(".moving"), out.pop(name).bool()
        for part in ("components", "mean"):
            kept = out[f"{layer}.{part}"]
            whole = kept.new_zeros((*kept.shape[:-1], len(moving)))
            whole[..., moving] = kept
            out[f"{layer}.{part}"] = whole
    return out


def load_sdfa(folder: Path | str, *, device: str = "cpu") -> SDFA:
    """Read a model, ready to predict.

    Raises
    ------
    CheckpointError
        If there is no such model, it is of another kind, or a file is damaged.
    """
    path = model_folder(folder)
    require_device(device)
    about = read_about(path)
    config = load_config(path / "config.yaml")
    if not isinstance(config, SDFAConfig):
        raise CheckpointError(f"{path}: no SDFA model but curves; use deitalk.load_model")
    weights = _all_numbers(read_weights(path / "model.safetensors"))
    try:
        with np.load(path / "templates.npz", allow_pickle=False) as file:
            vertices, faces = file["vertices"], file["faces"]
        meshes = [TriMesh(rows.astype(np.float64), faces) for rows in vertices]
        templates = dict(zip(about["speakers"], meshes, strict=True))
        layers = _empty_layers(weights)
        fps, unit_mm = float(about["fps"]), float(about["unit_mm"])
        model = mesh_kind(config.model)(
            config.model, layers, about["speakers"], templates, fps=fps, unit_mm=unit_mm
        )
        model.load_state_dict(weights)
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise CheckpointError(f"{path}: files do not fit one another ({reason})") from None
    if isinstance(model, MeshHead) and model.encoder.fingerprint != about.get("decodes_sha256"):
        raise CheckpointError(
            f"{path}: decodes the features of other weights than those of "
            f"{model.encoder.config.model!r} now; train it again"
        )
    try:
        return model.to(torch.device(device)).eval()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise CheckpointError(f"device {device!r}: {reason}; use the device cpu") from None


def _empty_layers(weights: dict[str, torch.Tensor]) -> dict[str, InversePCA]:
    """Frozen layers of the sizes that the weights have, by branch."""
    end = f".{FROZEN}.components"
    return {
        name.removeprefix("decoder.branches.").removesuffix(end): InversePCA(*value.shape)
        for name, value in weights.items()
        if name.endswith(end)
    }
