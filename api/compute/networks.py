"""Models of a worker process by the names of requests, on the settings' backend and device."""

from contextlib import suppress
from typing import Any, cast

from api.compute.order import Limits
from deitalk.errors import CheckpointError
from deitalk.models.folder import product_of
from deitalk.models.load import load_causal
from deitalk.models.protocol import CausalNetwork, CurveNetwork
from rig.errors import UserError

models: dict[str, Any] = {}
"""Models that were read, by name or folder as in the settings."""


def model_of(name: str, limits: Limits) -> Any:
    """Return a model, of curves or of a mesh.

    Raises
    ------
    CheckpointError
        If there is no such model, it cannot be read, or is not exported for ONNX Runtime.
    """
    if name not in limits["models"]:
        raise CheckpointError(f"no model {name!r}; known models: {', '.join(limits['models'])}")
    folder = limits["models"][name]
    if folder not in models:
        models[folder] = _read(name, folder, limits)
    model = models[folder]
    if limits["device"] != "cpu" and model.device.type == "cpu":  # read before the fork
        model = models[folder] = model.to(limits["device"])
    return model


def _read(name: str, folder: str, limits: Limits) -> Any:
    if limits["backend"] == "torch":
        from deitalk.models.checkpoint import load_model

        return load_model(folder)
    from deitalk.models.onnx.network import cached_path, load_onnx

    if product_of(folder) != "curves" or not cached_path(folder).is_file():
        raise CheckpointError(
            f"model {name!r} is not in ONNX; this service has the backend onnx, another with torch "
            "can use it"
        )
    return load_onnx(cached_path(folder), threads=limits["threads"])


def curve_network(name: str, limits: Limits) -> CurveNetwork:
    """Return a network for whole recordings.

    Raises
    ------
    CheckpointError
        As `model_of`, or if the model makes a mesh.
    """
    model = model_of(name, limits)
    if limits["backend"] == "torch":
        from deitalk.models.checkpoint import require_model
        from deitalk.models.curve_model import DEITalk

        model = require_model(model, DEITalk)
    return cast("CurveNetwork", model)


def causal_network(name: str, limits: Limits) -> CausalNetwork:
    """Return a network for voices that have not ended; errors as `curve_network`."""
    return load_causal(curve_network(name, limits))


def prepare(limits: Limits) -> None:
    """Read the models of the settings; those read before the fork are there."""
    if limits["backend"] == "torch":
        import torch

        torch.set_num_threads(limits["threads"])
    for name in limits["preload"]:
        with suppress(CheckpointError):  # a request for it gets the error
            model_of(name, limits)


def export_all(limits: Limits) -> None:
    """Write the files of all models that have one into the cache; torch runs in other processes."""
    from deitalk.models.onnx.network import cached_export

    for folder in limits["models"].values():
        with suppress(UserError, OSError):  # a request for that model gets the error
            if product_of(folder) == "curves" and not folder.endswith(".onnx"):
                cached_export(folder)
