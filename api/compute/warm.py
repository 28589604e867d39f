"""Packages and the default model, read once before workers are forked.

The fork server of `multiprocessing` imports this module; what it holds is shared by the workers.
scipy's linear algebra is among them: its start below a limit of memory does not end.
"""

import gc

import numpy as np
import pandas
import torch
from huggingface_hub import constants
from scipy import linalg

from api.compute.models import models
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate

__all__ = ["linalg", "pandas"]


def _preload() -> None:
    """Read the default model and use it once, so that nothing is imported later."""
    constants.HF_HUB_OFFLINE = True  # no request fetches a model
    torch.set_num_threads(1)  # threads do not survive the fork
    model = require_model("default", DEITalk)
    animate(np.zeros(1600, np.float32), sample_rate=16000, model=model)
    models["default"] = model
    # What is here now is never collected: a full collection would copy its pages into each worker.
    gc.collect()
    gc.freeze()


_preload()
