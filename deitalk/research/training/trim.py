"""Smaller mesh models: fewer components, 16 bits (SDFA §4.4 proposes both).

::

    python -m deitalk.research.training.trim runs/sdfa_small/best OUT stretch=22 rotation=32
"""

import sys
from pathlib import Path
from typing import TypeVar

from deitalk.config.load import load_model_config
from deitalk.config.mesh import SDFAConfig
from deitalk.errors import CheckpointError
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.deformation_decoder import InversePCA
from deitalk.models.folder import model_folder, read_about
from deitalk.models.mesh_folder import FROZEN
from deitalk.models.mesh_model import MeshModel

MeshT = TypeVar("MeshT", bound=MeshModel)

QUIET = 1e-4
"""Numbers of a frame whose standard deviation is below this are kept at rest: most of scalp and
neck. 0.006 degrees, a hundredth of a percent."""


def trimmed(model: MeshT, sizes: dict[str, int]) -> MeshT:
    """A copy of a model with the first components of its bases only (SDFA §4.4 proposes it).

    Parameters
    ----------
    model : SDFA or MeshHead
        Not changed; the copy shares its encoder.
    sizes : dict of str to int
        Components kept, by branch.

    Raises
    ------
    CheckpointError
        If there is no such branch, or it has fewer.
    """
    layers = {}
    state = model.state_dict()
    for branch, deviations in model.decoder.deviations.items():
        size = sizes.get(branch, len(deviations))
        if not 1 <= size <= len(deviations):
            raise CheckpointError(f"{branch}: {size} of {len(deviations)} components; keep fewer")
        prefix = f"decoder.branches.{branch}"
        last = f"{prefix}.coefficients.{len(model.config.branch_sizes) * 2}."
        for name in [n for n in state if n.startswith(last) or n.startswith(f"{prefix}.{FROZEN}")]:
            if state[name].shape[0] == len(deviations):
                state[name] = state[name][:size]
        components, mean = (state[f"{prefix}.{FROZEN}.{part}"] for part in ("components", "mean"))
        quiet = (components.square().sum(dim=0).sqrt() < QUIET) & (mean.abs() < QUIET)
        state[f"{prefix}.{FROZEN}.components"] = components.masked_fill(quiet, 0)
        state[f"{prefix}.{FROZEN}.mean"] = mean.masked_fill(quiet, 0)
        layers[branch] = InversePCA(*components.shape)
    unknown = sorted(sizes.keys() - layers.keys())
    if unknown:
        raise CheckpointError(f"{unknown[0]!r} is no branch; there are {', '.join(layers)}")
    small = type(model)(
        model.config, model.encoder, layers, model.templates, fps=model.fps, unit_mm=model.unit_mm
    )
    small.load_state_dict(state)
    return small.eval()


def trim(source: Path | str, out: Path, sizes: dict[str, int]) -> None:
    """Write a trimmed model in float16.

    Raises
    ------
    CheckpointError
        If there is no such model or branch, or `out` exists.
    """
    if out.exists():
        raise CheckpointError(f"{out}: exists already; name another folder")
    folder = model_folder(source)
    model = trimmed(require_model(source, MeshModel), sizes)
    config = load_model_config(folder / "config.yaml")
    assert isinstance(config, SDFAConfig)
    summary = dict(read_about(folder)["training"])
    save_model(out, model, config, summary | {"components": sizes}, half=True)


def main(arguments: list[str]) -> None:
    """Run the command of the module's docstring."""
    source, out, *given = arguments
    pairs = (item.partition("=") for item in given)
    trim(source, Path(out), {name: int(size) for name, _, size in pairs})


if __name__ == "__main__":
    main(sys.argv[1:])
