"""Curve models as ONNX files.

::

    network.py          name or folder -> `deitalk.models.protocol` networks, without torch
    rules.py            the rules after them
    engine_graph.py     writes the graphs that these open, in torch
    network_graph.py    the network of a whole clip; what a causal one needs for a graph
    whisper_graph.py    its Whisper frontend; spectra.py, its Fourier transform
    tracing.py          a module as an ONNX model; fusing.py, with the operators of ONNX Runtime
"""

from deitalk.models.onnx.network import OnnxCausalNetwork, OnnxNetwork, load_onnx

__all__ = ["OnnxCausalNetwork", "OnnxNetwork", "load_onnx"]
