"""Causal curve networks: the next frames of many streams from explicit state.

::

    network.py    what live needs of one: arrays in, arrays out; imports no torch
    in_torch.py   a causal `deitalk.models.curve_model.DEITalk` that does it

`deitalk.models.onnx.causal_network` does it in ONNX Runtime.
"""
