"""Curve models as ONNX files.

::

    graph.py     the model as one graph: torch modules between its layers
    export.py    graph -> file with metadata
    network.py   file -> `deitalk.models.network.CurveNetwork`; imports no torch
    load.py      name, folder or file -> network; exports into the cache at the first use
"""

from deitalk.models.onnx.load import load_onnx
from deitalk.models.onnx.network import OnnxNetwork

__all__ = ["OnnxNetwork", "load_onnx"]
