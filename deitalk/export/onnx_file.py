"""Export of a model to one ONNX file for other programs: sound in, finished curves out."""

import json
from collections import Counter
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import torch

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.config.rig_file import rig_text
from deitalk.emotions import LABELS
from deitalk.errors import CheckpointError
from deitalk.export.finished import FinishedClip
from deitalk.export.finished_live import FinishedLive
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.tracing import Axes, traced
from deitalk.postprocess.tracks import N_MOTION, N_VARIANTS
from rig.errors import quoted
from rig.files import atomic_write

CLIP_SCHEMA, LIVE_SCHEMA = "deitalk.onnx/3", "deitalk.onnx-live/4"
CLIP_INPUTS = "sound", "emotion", "intensity", "variants", "motion"
STATE, NEXT_STATE = "state", "next_state"
CLIP_OUTPUTS, LIVE_OUTPUTS = ("curves", "neutral", "predicted"), ("curves", "predicted")
Precision: TypeAlias = Literal["float32", "float16"]
PRECISIONS: tuple[Precision, ...] = get_args(Precision)
SMALLEST = 4096
"""Numbers of a weight that is stored with less precision."""


def export_onnx(
    model: DEITalk, path: Path, *, name: str = "", precision: str = "float32", n_frames: int = 1
) -> None:
    """Write a model as an ONNX file that gives finished curves; see docs/onnx.md.

    Parameters
    ----------
    model : DEITalk
        With a Whisper or causal frontend and an intensity module.
    path : Path
        Replaced if it exists.
    name : str
        Name of the model, for the metadata.
    precision : str
        Of the weights in the file: ``float32``, or ``float16`` with half the size, in which the
        embedded models are kept. Curves are computed in float32.
    n_frames : int
        Frames of a run of a causal model; see `deitalk.export.finished_live.FinishedLive`.

    Raises
    ------
    CheckpointError
        If the model has parts that are not exported, or the precision is unknown.
    MissingError
        If the package onnx is not installed.
    """
    if precision not in PRECISIONS:
        raise CheckpointError(
            f"precision {quoted(precision)} is unknown; use {', '.join(PRECISIONS)}"
        )
    model = model.cpu()
    content, texts = _live(model, n_frames) if model.is_causal else _clip(model)
    _store(content.graph, precision)
    for key, value in (metadata(model, name) | texts).items():
        content.metadata_props.add(key=key, value=value)
    with atomic_write(path) as beside:
        beside.write_bytes(content.SerializeToString())


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
        "emotions": list(LABELS),
        "actors": list(model.actors),
        "sample_rate": SAMPLE_RATE,
        "frame_rate": FRAME_RATE,
        "variants": N_VARIANTS + 1,
        "motion": N_MOTION,
    }
    texts = {key: json.dumps(value) for key, value in values.items()}
    return texts | {"name": name, "control_set": controls.id, "rig": rig_text(controls)}


def _clip(model: DEITalk) -> tuple[Any, dict[str, str]]:
    """Graph of whole recordings, and its metadata."""
    n_frames = FRAME_RATE
    example = (
        0.1 * torch.randn(SAMPLE_RATE),
        torch.full((n_frames, len(LABELS) + len(model.actors)), 0.1),
        torch.ones(3, n_frames),
        torch.zeros(n_frames, N_VARIANTS + 1),
        torch.zeros(n_frames, N_MOTION),
    )
    axes: Axes = {name: {0: "T"} for name in (*CLIP_INPUTS, *CLIP_OUTPUTS)}
    axes |= {"sound": {0: "S"}, "intensity": {1: "T"}}
    content = traced(FinishedClip(model), example, CLIP_INPUTS, CLIP_OUTPUTS, axes)
    return content, {"schema": CLIP_SCHEMA}


def _live(model: DEITalk, n_frames: int) -> tuple[Any, dict[str, str]]:
    """Graph of the next frames of streams, and its metadata."""
    graph, batch = FinishedLive(model, n_frames), 2
    rows = (batch,) if n_frames == 1 else (batch, n_frames)
    example = (
        torch.zeros(batch, graph.window),
        torch.full((*rows, len(LABELS) + len(model.actors)), 0.1),
        torch.ones(batch, 2),
        torch.zeros(*rows, N_VARIANTS + 1),
        torch.zeros(*rows, N_MOTION),
        graph.first(batch),
    )
    inputs, outputs = (*CLIP_INPUTS, STATE), (*LIVE_OUTPUTS, NEXT_STATE)
    axes: Axes = {name: {0: "B"} for name in (*inputs, *outputs)}
    content = traced(graph, example, inputs, outputs, axes)
    numbers = {
        "frames": n_frames,
        "window": graph.window,
        "before": graph.before,
        "delay": graph.delay,
        "behind": graph.behind,
        "state": example[-1].shape[1],
    }
    texts = {key: json.dumps(value) for key, value in numbers.items()}
    return content, texts | {"schema": LIVE_SCHEMA}


def _store(graph: Any, precision: str) -> None:
    """Store the large weights of a graph in half precision, with casts to float32."""
    from onnx import TensorProto, helper, numpy_helper

    if precision == "float32":
        return
    casts = []
    for weight in graph.initializer:
        values = numpy_helper.to_array(weight)
        if values.dtype != np.float32 or values.size < SMALLEST or "model." not in weight.name:
            continue
        name = weight.name
        weight.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}_half"))
        casts.append(helper.make_node("Cast", [weight.name], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
