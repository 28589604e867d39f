"""A module of torch as an ONNX model."""

import io
import warnings
from typing import Any

import torch
from torch import Tensor, nn

from deitalk.errors import MissingError
from deitalk.installed import __version__

OPSET = 17
"""The first with LayerNormalization; read by ONNX Runtime 1.12 and later."""
Axes = dict[str, dict[int, str]]
"""Names of the axes of any length, by input or output and place."""


def traced(
    graph: nn.Module,
    example: tuple[Tensor, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    axes: Axes,
) -> Any:
    """A module as an ONNX model, its weights by their names in the module.

    Raises
    ------
    MissingError
        If the package onnx is not installed.
    """
    try:
        import onnx
    except ImportError:
        raise MissingError(
            "the export needs the package onnx; install it with pip install 'deitalk[onnx]'"
        ) from None
    file = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter's own, on constants that are meant
        torch.onnx.export(
            graph.eval(),
            example,
            file,  # type: ignore[arg-type]
            dynamo=False,  # the newer exporter needs packages more
            opset_version=OPSET,
            do_constant_folding=False,  # runtimes do that; weights keep their names
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_axes=axes,
        )
    content = onnx.ModelProto.FromString(file.getbuffer())  # no second copy of the weights
    for node in content.graph.node:
        node.ClearField("name")
        node.ClearField("doc_string")
    content.producer_name, content.producer_version = "deitalk", __version__
    return content
