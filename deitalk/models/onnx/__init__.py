"""Curve models as ONNX files.

::

    graph.py            the model as one graph: torch modules between its layers
    mel_graph.py                      parts of it
    causal_graph.py     one frame of a causal model, with its state
    export.py           graph -> file with metadata
    network.py          file -> `deitalk.models.protocol.CurveNetwork`; imports no torch
    causal_network.py   file -> `deitalk.models.protocol.CausalNetwork`, as little
    load.py             name, folder or file -> network; exports into the cache at the first use
"""

from deitalk.models.onnx.load import load_onnx
from deitalk.models.onnx.network import OnnxCausalNetwork, OnnxNetwork

__all__ = ["OnnxCausalNetwork", "OnnxNetwork", "load_onnx"]
