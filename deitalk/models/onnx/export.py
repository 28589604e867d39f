"""Export of a curve model to one ONNX file, with all that a reader needs beside the numbers."""

import json
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import torch

from deitalk import __version__
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.config.rig_file import rig_text
from deitalk.emotions import EMOTIONS
from deitalk.errors import MissingError
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.graph import CurveGraph, GraphOutput
from deitalk.models.onnx.network import SCHEMA
from rig.files import atomic_write

OPSET = 17
"""The first with LayerNormalization; read by ONNX Runtime 1.12 and later."""
LEVEL_DB = -23.0
"""Active level of the speech in the input, dB re full scale."""


def export_onnx(model: DEITalk, path: Path, *, name: str = "") -> None:
    """Write a model as an ONNX file.

    Parameters
    ----------
    model : DEITalk
        With a mel frontend and an intensity module.
    path : Path
        Replaced if it exists.
    name : str
        Name of the model, for the metadata.

    Raises
    ------
    CheckpointError
        If the model has parts that are not exported (see `CurveGraph`).
    MissingError
        If the package onnx is not installed.
    """
    try:
        import onnx
    except ImportError:
        raise MissingError(
            "the export needs the package onnx; install it with pip install 'deitalk[onnx]'"
        ) from None
    graph = CurveGraph(model.cpu()).eval()
    with atomic_write(path) as beside:
        _trace(graph, beside, len(model.actors))
        content = onnx.load(str(beside))
        for key, value in metadata(model, name).items():
            content.metadata_props.add(key=key, value=value)
        content.producer_name, content.producer_version = "deitalk", __version__
        onnx.save(content, str(beside))


def operators(path: Path) -> dict[str, int]:
    """Count of each operator in a file, most frequent first; constants are left out."""
    import onnx

    nodes = onnx.load(str(path)).graph.node
    names = Counter(node.op_type for node in nodes if node.op_type not in ("Constant", "Identity"))
    return dict(names.most_common())


def metadata(model: DEITalk, name: str) -> dict[str, str]:
    """Metadata of the file: texts, most of them JSON."""
    controls = model.controls
    values: dict[str, Any] = {
        "controls": list(controls.names),
        "rest": controls.rest.tolist(),
        "minimum": controls.minimum.tolist(),
        "maximum": controls.maximum.tolist(),
        "emotions": list(EMOTIONS),
        "actors": list(model.actors),
        "sample_rate": SAMPLE_RATE,
        "level_db": LEVEL_DB,
        "frame_rate": FRAME_RATE,
        "rules": model.rules.model_dump(mode="json"),
    }
    texts = {key: json.dumps(value) for key, value in values.items()}
    texts |= {"schema": SCHEMA, "name": name, "control_set": controls.id}
    return texts | {"rig": rig_text(controls)}


def _trace(graph: CurveGraph, path: Path, n_actors: int) -> None:
    """Write the graph for any length of its inputs."""
    n_frames = FRAME_RATE
    example = (
        torch.zeros(SAMPLE_RATE),
        torch.full((n_frames, len(EMOTIONS) + n_actors), 0.2),
        torch.arange(n_frames) / n_frames,
    )
    inputs = {"sound": "S", "emotion": "T", "place": "T"}
    axes = {name: {0: size} for name, size in inputs.items()}
    axes |= {name: {0: "T"} for name in GraphOutput._fields}
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter's own, on constants that are meant
        torch.onnx.export(
            graph,
            example,
            path,
            dynamo=False,  # the newer exporter unrolls LSTMs over time
            opset_version=OPSET,
            input_names=list(inputs),
            output_names=list(GraphOutput._fields),
            dynamic_axes=axes,
        )
