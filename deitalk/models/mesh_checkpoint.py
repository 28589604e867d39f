"""Folders of SDFA models: as `deitalk.models.checkpoint`, with the templates beside the weights.

::

    config.yaml          every setting (kind: sdfa)
    model.safetensors    weights and the frozen bases, float16 if asked for; of these only the
                         numbers that move, which `moving` marks
    templates.npz        expressionless vertices of every speaker, and the triangles
    model.json           format version, speakers, frame rate, unit, training summary; of a mesh
                         head, the hash of the DEITalk weights whose features it decodes
"""

import json
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from safetensors.torch import save

from deitalk.config import DEITalkFeaturesConfig, SDFAConfig, SDFAModelConfig, load_config
from deitalk.errors import CheckpointError
from deitalk.models.checkpoint import FORMAT_VERSION, model_folder, read_about
from deitalk.models.deformation_decoder import InversePCA
from deitalk.models.devices import require_device
from deitalk.models.mesh_head import MeshHead
from deitalk.models.mesh_model import SDFA
from deitalk.models.weights_file import Shapes, check_fit, network_shapes, read_shapes, read_weights
from rig import limits
from rig.errors import shorten
from rig.files import output_folder
from rig.files.reading import check_expansion, check_file, read_npz
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
    weights_path = path / "model.safetensors"
    shapes = whole_shapes(weights_path)
    try:
        templates = read_templates(path, about["speakers"])
        fps, unit_mm = _rates(about)
        build = partial(mesh_kind(config.model), config.model)

        def make() -> SDFA:
            layers = _empty_layers(shapes)
            return build(layers, tuple(templates), templates, fps=fps, unit_mm=unit_mm)

        check_fit(weights_path, shapes, network_shapes(make))
        weights = _all_numbers(read_weights(weights_path))
        model = make()
        model.load_state_dict(weights)
    except CheckpointError:
        raise
    except (OSError, ValueError, LookupError, TypeError, RuntimeError) as error:
        reason = shorten(" ".join(str(error).split()), 160)
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


def _empty_layers(shapes: Shapes) -> dict[str, InversePCA]:
    """Frozen layers of the sizes that the weights have, by branch."""
    end = f".{FROZEN}.components"
    return {
        name.removeprefix("decoder.branches.").removesuffix(end): InversePCA(*shape)
        for name, shape in shapes.items()
        if name.endswith(end)
    }


def whole_shapes(path: Path) -> Shapes:
    """Shapes of a weight file once `_all_numbers` has put back what it leaves out.

    Raises
    ------
    CheckpointError
        As `read_shapes`; or if a frozen layer expands to far more than the file.
    """
    shapes = read_shapes(path)
    end = f"{FROZEN}.moving"
    total = 0
    for name in [name for name in shapes if name.endswith(end)]:
        layer, width = name.removesuffix(".moving"), shapes.pop(name)
        for part in ("components", "mean"):
            kept = shapes.get(f"{layer}.{part}", ())
            shapes[f"{layer}.{part}"] = (*kept[:-1], *width)
            total += math.prod(shapes[f"{layer}.{part}"])
    size = check_file(path, limits.WEIGHTS_BYTES, error=CheckpointError)
    check_expansion(4 * total, size, path, error=CheckpointError)
    return shapes


def read_templates(folder: Path, speakers: Any) -> dict[str, TriMesh]:
    """Expressionless mesh of every speaker, from ``templates.npz``.

    Raises
    ------
    CheckpointError, MeshError
        If the file is damaged, or has not one mesh for each name.
    """
    arrays = read_npz(folder / "templates.npz", limit=limits.MESH_BYTES, error=CheckpointError)
    vertices, faces = arrays["vertices"], arrays["faces"]
    is_list = isinstance(speakers, list) and all(isinstance(name, str) for name in speakers)
    if not is_list or not 0 < len(speakers) <= limits.SPEAKERS:
        raise ValueError(f"speakers must be 1 to {limits.SPEAKERS} names")
    if vertices.dtype.kind != "f" or vertices.ndim != 3 or len(set(speakers)) != len(vertices):
        raise ValueError(f"templates of shape {vertices.shape} for {len(speakers)} speakers")
    meshes = [TriMesh(rows.astype(np.float64), faces) for rows in vertices]
    return dict(zip(speakers, meshes, strict=True))


def _rates(about: dict[str, Any]) -> tuple[float, float]:
    """Frames per second, and millimetres in a unit of the templates."""
    fps, unit_mm = float(about["fps"]), float(about["unit_mm"])
    if not limits.FPS_LOWEST <= fps <= limits.FPS_HIGHEST:
        raise ValueError(f"fps is {fps:g}")
    if not 0 < unit_mm <= limits.COORDINATE:
        raise ValueError(f"unit_mm is {unit_mm:g}")
    return fps, unit_mm
