"""What a mesh model's folder holds besides `deitalk.models.folder`'s: bases and templates.

The frozen bases are half of the weights. Stored are only the numbers that a component moves,
which the tensor `moving` marks. ``templates.npz`` holds the expressionless vertices of every
speaker and the triangles.
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from deitalk.errors import CheckpointError
from deitalk.models.deformation_decoder import (
    InversePCA,
)
from deitalk.models.weight_file import Shapes, read_shapes
from rig import limits
from rig.files.reading import check_expansion, check_file, read_npz
from rig.mesh import TriMesh

if TYPE_CHECKING:
    pass
from deitalk.models.mesh_model import MeshModel

FROZEN = "inverse_pca"
"""Name of the frozen layers in the weights."""


def only_moving(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Weights without the numbers that no component moves: most of scalp, neck and back."""
    out = dict(weights)
    for name in [name for name in weights if name.endswith(f"{FROZEN}.components")]:
        layer = name.removesuffix(".components")
        components, mean = weights[name], weights[f"{layer}.mean"]
        moving = (components != 0).any(dim=0) | (mean != 0)
        out[name], out[f"{layer}.mean"] = components[:, moving], mean[moving]
        out[f"{layer}.moving"] = moving
    return out


def all_numbers(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Undo `only_moving`."""
    out = dict(weights)
    for name in [name for name in weights if name.endswith(f"{FROZEN}.moving")]:
        layer, moving = name.removesuffix(".moving"), out.pop(name).bool()
        for part in ("components", "mean"):
            kept = out[f"{layer}.{part}"]
            whole = kept.new_zeros((*kept.shape[:-1], len(moving)))
            whole[..., moving] = kept
            out[f"{layer}.{part}"] = whole
    return out


def whole_shapes(path: Path) -> Shapes:
    """Shapes of a weight file after `all_numbers`.

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


def empty_layers(shapes: Shapes) -> dict[str, InversePCA]:
    """Frozen layers of the sizes that the weights have, by branch."""
    end = f".{FROZEN}.components"
    return {
        name.removeprefix("decoder.branches.").removesuffix(end): InversePCA(*shape)
        for name, shape in shapes.items()
        if name.endswith(end)
    }


def read_rates(about: dict[str, Any]) -> dict[str, float]:
    """Frames per second `fps`, and millimetres in a unit of the templates `unit_mm`."""
    fps, unit_mm = float(about["fps"]), float(about["unit_mm"])
    if not limits.FPS_LOWEST <= fps <= limits.FPS_HIGHEST:
        raise ValueError(f"fps is {fps:g}")
    if not 0 < unit_mm <= limits.COORDINATE:
        raise ValueError(f"unit_mm is {unit_mm:g}")
    return {"fps": fps, "unit_mm": unit_mm}


def write_templates(folder: Path, model: MeshModel, *, half: bool) -> None:
    """Write ``templates.npz``; vertices in float32 if `half`."""
    meshes = [model.templates[speaker] for speaker in model.speakers]
    vertices = np.stack([mesh.vertices for mesh in meshes])
    np.savez_compressed(
        folder / "templates.npz",
        vertices=vertices.astype(np.float32) if half else vertices,
        faces=meshes[0].faces.astype(np.int32),
    )


def read_templates(folder: Path, speakers: Any) -> dict[str, TriMesh]:
    """Expressionless mesh of every speaker, from ``templates.npz``.

    Raises
    ------
    CheckpointError, MeshError, ValueError
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
