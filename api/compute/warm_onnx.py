"""Packages that workers with the backend onnx are forked with; see `api.compute.warm`. No torch."""

import onnxruntime
import pandas
from scipy import linalg

from api.compute import tasks
from deitalk.pipeline.curves import animate

__all__ = ["animate", "linalg", "onnxruntime", "pandas", "tasks"]
