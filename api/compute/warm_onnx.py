"""Packages that every worker with the backend onnx needs, read once before workers are forked.

See `api.compute.warm`; here no torch is imported.
"""

from contextlib import suppress

import onnxruntime
import pandas
from scipy import linalg

from api.compute.exports import network_of
from api.compute.order import Limits
from deitalk.errors import CheckpointError
from deitalk.pipeline.curves import animate

__all__ = ["animate", "linalg", "onnxruntime", "pandas", "prepare"]


def prepare(limits: Limits) -> None:
    """Read the models of the settings, in a worker."""
    for name in limits["preload"]:
        with suppress(CheckpointError):  # a mesh model: a request for it gets the error
            network_of(name, limits)
