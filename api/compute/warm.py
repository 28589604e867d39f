"""Packages and models that every worker needs, read once before workers are forked.

The fork server of `multiprocessing` imports this module; what it holds is shared by the workers.
scipy's linear algebra is among them: its start below a limit of memory does not end.
"""

import gc

import numpy as np
import pandas
import torch
from huggingface_hub import constants
from scipy import linalg

from api.compute.order import Limits
from deitalk.errors import CheckpointError
from deitalk.models.checkpoint import Model, load_model, require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate

__all__ = ["linalg", "model_of", "pandas", "prepare"]

_models: dict[str, Model] = {}


def model_of(name: str, limits: Limits) -> Model:
    """Return a model by the name that requests use, on the settings' device.

    Raises
    ------
    CheckpointError
        If there is no such model or it cannot be read.
    """
    if name not in limits["models"]:
        raise CheckpointError(f"no model {name!r}; known models: {', '.join(limits['models'])}")
    folder = limits["models"][name]
    if folder not in _models:
        _models[folder] = load_model(folder)
    model = _models[folder]
    if limits["device"] != "cpu" and model.device.type == "cpu":
        model = _models[folder] = model.to(torch.device(limits["device"]))
    return model


def prepare(limits: Limits) -> None:
    """Read the models of the settings, in a worker; those read before the fork are there."""
    torch.set_num_threads(limits["threads"])
    for name in limits["preload"]:
        model_of(name, limits)


def _preload() -> None:
    """Read the default model and use it once, so that nothing is imported later."""
    constants.HF_HUB_OFFLINE = True  # no request fetches a model
    torch.set_num_threads(1)  # threads do not survive the fork
    model = require_model("default", DEITalk)
    animate(np.zeros(1600, np.float32), sample_rate=16000, model=model)
    _models["default"] = model
    # What is here now is never collected: a full collection would copy its pages into each worker.
    gc.collect()
    gc.freeze()


_preload()
