"""Curve networks of a worker by the backend of the settings."""

from api.compute.order import Limits
from deitalk.models.load import load_causal
from deitalk.models.protocol import CausalNetwork, CurveNetwork


def curve_network(name: str, limits: Limits) -> CurveNetwork:
    """Return a network for whole recordings by the name that requests use.

    Raises
    ------
    CheckpointError
        If there is no such model, or it is no curve model.
    """
    if limits["backend"] == "onnx":
        from api.compute.exports import network_of

        return network_of(name, limits)
    from api.compute.warm import model_of
    from deitalk.models.checkpoint import require_model
    from deitalk.models.curve_model import DEITalk

    return require_model(model_of(name, limits), DEITalk)


def causal_network(name: str, limits: Limits) -> CausalNetwork:
    """Return a network for voices that have not ended; errors as `curve_network`."""
    return load_causal(curve_network(name, limits))
