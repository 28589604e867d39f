"""Curve models as ONNX files.

::

    graphs.py           name or folder -> its network, without torch where its graph is written
    network.py          networks of whole recordings: `deitalk.models.protocol.CurveNetwork`
    causal_network.py   those of voices that have not ended
    rules.py            the rules after them
    engine_graph.py     writes the graphs that these open, in torch
    network_graph.py    the network of a whole clip; what a causal one needs for a graph
    whisper_graph.py    its Whisper frontend; spectra.py, its Fourier transform
    tracing.py          a module as an ONNX model; fusing.py, with the operators of ONNX Runtime
"""

from deitalk.models.onnx.causal_network import OnnxCausalNetwork
from deitalk.models.onnx.graphs import load_onnx
from deitalk.models.onnx.network import OnnxNetwork

__all__ = ["OnnxCausalNetwork", "OnnxNetwork", "load_onnx"]
