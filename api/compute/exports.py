"""Models in ONNX Runtime for workers that import no torch (`backend: onnx`)."""

from contextlib import suppress

from api.compute.order import Limits
from deitalk.errors import CheckpointError
from deitalk.models.folder import product_of
from deitalk.models.onnx.load import cached_export, cached_path, load_onnx
from deitalk.models.onnx.network import OnnxCausalNetwork, OnnxNetwork
from rig.errors import UserError

_networks: dict[str, OnnxNetwork | OnnxCausalNetwork] = {}


def export_all(limits: Limits) -> None:
    """Write the files of all models that have one into the cache; torch runs in other processes."""
    for folder in limits["models"].values():
        with suppress(UserError, OSError):  # a request for that model gets the error
            if product_of(folder) == "curves" and not folder.endswith(".onnx"):
                cached_export(folder)


def network_of(name: str, limits: Limits) -> OnnxNetwork | OnnxCausalNetwork:
    """Return a model by the name that requests use.

    Raises
    ------
    CheckpointError
        If there is no such model, or it is not exported.
    """
    if name not in limits["models"]:
        raise CheckpointError(f"no model {name!r}; known models: {', '.join(limits['models'])}")
    folder = limits["models"][name]
    if folder not in _networks:
        if product_of(folder) != "curves" or not cached_path(folder).is_file():
            raise CheckpointError(
                f"model {name!r} is not in ONNX; this service has the backend onnx, another with "
                "torch can use it"
            )
        _networks[folder] = load_onnx(cached_path(folder), threads=limits["threads"])
    return _networks[folder]
