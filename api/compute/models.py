"""Models of a worker process by the names of requests, on the settings' backend and device."""

from contextlib import suppress
from typing import Any

from api.compute.order import Limits
from deitalk.errors import CheckpointError
from deitalk.models.folder import is_causal, model_folder, product_of
from deitalk.models.load import chosen_backend
from rig.errors import UserError

models: dict[str, Any] = {}
"""Models that were read, by name or folder as in the settings."""


def model_of(name: str, limits: Limits) -> Any:
    """Return a model, of curves or of a mesh, where it was read.

    Raises
    ------
    CheckpointError
        If there is no such model, it cannot be read, or is not exported for ONNX Runtime.
    """
    if name not in limits["models"]:
        raise CheckpointError(f"no model {name!r}; known models: {', '.join(limits['models'])}")
    folder = limits["models"][name]
    if folder in models:
        return models[folder]
    if chosen_backend(folder, limits["backend"], limits["device"]) == "torch":
        from deitalk.models.checkpoint import load_model

        _begin_torch(limits)
        models[folder] = load_model(folder)
        return models[folder]
    from deitalk.models.onnx.graphs import load_onnx, ready_graph

    if product_of(folder) != "curves" or ready_graph(model_folder(folder)) is None:
        raise CheckpointError(
            f"model {name!r} is not in ONNX; this service has the backend onnx, another with torch "
            "can use it"
        )
    models[folder] = load_onnx(folder, threads=limits["threads"])
    return models[folder]


def placed(model: Any, limits: Limits) -> Any:
    """The model, moved to the device of the settings."""
    return model if limits["device"] == "cpu" else model.to(limits["device"])


def prepare(limits: Limits) -> None:
    """Read the models of the settings; those read before the fork are there."""
    if limits["backend"] == "torch":
        _begin_torch(limits)
    for name in limits["preload"]:
        with suppress(CheckpointError):  # a request for it gets the error
            placed(model_of(name, limits), limits)


def _begin_torch(limits: Limits) -> None:
    import torch

    torch.set_num_threads(limits["threads"])
    torch.backends.cudnn.allow_tf32 = False  # else a GPU rounds to ten bits


def export_all(limits: Limits, *, only_live: bool = False) -> None:
    """Write graphs that models lack into the cache; torch runs in other processes."""
    from deitalk.models.onnx.graphs import cached_graph, ready_graph

    for folder in limits["models"].values():
        with suppress(UserError, OSError):  # a request for that model gets the error
            path = model_folder(folder)
            if product_of(folder) != "curves" or ready_graph(path):
                continue
            if is_causal(folder) or not only_live:
                cached_graph(path, folder)
