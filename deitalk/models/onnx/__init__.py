"""Curve models as ONNX files.

::

    whisper_graph.py    the Whisper frontend as layers of a graph
    export.py           the model as one graph, or one frame of a causal model with its state; file
    network.py          name, folder or file -> `deitalk.models.protocol` networks, without torch;
                        exports into the cache at the first use
"""

from deitalk.models.onnx.network import OnnxCausalNetwork, OnnxNetwork, load_onnx

__all__ = ["OnnxCausalNetwork", "OnnxNetwork", "load_onnx"]
