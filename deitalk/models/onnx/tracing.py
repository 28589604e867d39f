"""A module of torch as an ONNX model."""

import io
import warnings
from collections.abc import Collection
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
    left: Collection[str] = (),
) -> Any:
    """A module as an ONNX model, its weights by their names in the module.

    The values of those that are `left` are not in it.

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
            export_params=False,  # weights become inputs: the exporter copies values three times
            dynamo=False,  # the newer exporter needs packages more
            opset_version=OPSET,
            do_constant_folding=False,  # runtimes do that; weights keep their names
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_axes=axes,
        )
    content = onnx.ModelProto.FromString(file.getvalue())
    values = dict(graph.named_parameters()) | dict(graph.named_buffers())
    given = list(content.graph.input)
    del content.graph.input[len(inputs) :]
    for each in given[len(inputs) :]:
        # The exporter numbers a weight of the name of an input or output.
        value = values[each.name if each.name in values else each.name.rpartition(".")[0]]
        weight = content.graph.initializer.add(name=each.name, dims=value.shape)
        weight.data_type = each.type.tensor_type.elem_type
        if each.name not in left:
            weight.raw_data = value.detach().contiguous().numpy().tobytes()
    for node in content.graph.node:
        node.ClearField("name")
        node.ClearField("doc_string")
    content.producer_name, content.producer_version = "deitalk", __version__
    return content
