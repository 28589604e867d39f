"""Graph of a model for `deitalk.models.onnx.network`: network and rules, without the weights.

The weights stay in the model's folder and are given to the graph where it is opened: a file of a
network is a hundredth of them, and another one for a fine-tuned model is not needed.
"""

import base64
import gzip
import json
from collections.abc import Collection
from pathlib import Path
from typing import Any, cast

import torch

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.config.rig_file import rig_text
from deitalk.emotions import EMOTIONS
from deitalk.frontends.whisper import WhisperFrontend
from deitalk.models.causal_model import CausalStep, causal_frontend, grid_of
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.fusing import fused
from deitalk.models.onnx.graphs import graph_digest
from deitalk.models.onnx.network import (
    CAUSAL_SCHEMA,
    NEXT,
    SCHEMA,
    STORED,
    WEIGHTS,
    WEIGHTS_FILE,
    GraphHeader,
    stored_types,
)
from deitalk.models.onnx.network_graph import (
    EFFORT,
    OUTPUTS,
    CurveGraph,
    causal_graph,
    first_states,
)
from deitalk.models.onnx.rules import INPUTS as RULES_INPUTS
from deitalk.models.onnx.rules import LIVE, WHOLE
from deitalk.models.onnx.rules import OUTPUTS as RULES_OUTPUTS
from deitalk.models.onnx.tracing import Axes, traced
from deitalk.models.onnx.whisper_graph import parts_of
from deitalk.postprocess.curve_pass import CurvePass
from rig.files import atomic_write


def write_graph(model: DEITalk, folder: Path, path: Path) -> None:
    """Write the graph of a model folder.

    Parameters
    ----------
    model : DEITalk
        Of the folder, with a Whisper or causal frontend and an intensity module.
    folder : Path
        Whose weights the graph will be given.
    path : Path
        Replaced if it exists.

    Raises
    ------
    CheckpointError
        If the model has parts that have no graph.
    MissingError
        If the package onnx is not installed.
    """
    model, types = model.cpu(), stored_types(folder)
    stored = {WEIGHTS + name for name in types}
    content, texts = (_causal if model.is_causal else _whole)(model, stored)
    texts[WHOLE] = rules_entry(model)
    if model.is_causal:
        texts[LIVE] = rules_entry(model, grid_of(model).rules_ahead)
    content = fused(content, stored)
    left = _leave_weights(content.graph, types)
    for key, value in (metadata(model) | texts).items():
        content.metadata_props.add(key=key, value=value)
    with atomic_write(path) as beside:
        header = json.dumps(GraphHeader(graph_digest(folder), left, model.is_causal)._asdict())
        written = f"{header}\n".encode() + content.SerializeToString()
        beside.write_bytes(gzip.compress(written, mtime=0))


def metadata(model: DEITalk) -> dict[str, str]:
    """What a network is asked besides curves: texts, most of them JSON."""
    values: dict[str, Any] = {
        "actors": list(model.actors),
        "shown_emotions": list(model.emotions),
        "rules": model.rules.model_dump(mode="json"),
    }
    texts = {key: json.dumps(value) for key, value in values.items()}
    return texts | {"control_set": model.controls.id, "rig": rig_text(model.controls)}


def _whole(model: DEITalk, stored: Collection[str]) -> tuple[Any, dict[str, str]]:
    """Graph of whole recordings, without weights that are stored; metadata of its frontend."""
    example = (
        torch.zeros(SAMPLE_RATE),
        torch.full((FRAME_RATE, len(EMOTIONS) + len(model.actors)), 0.2),
        torch.arange(FRAME_RATE) / FRAME_RATE,
        torch.tensor(0.0),
    )
    inputs = "sound", "emotion", "place"
    outputs = (*OUTPUTS, *[EFFORT] * model.config.effort)
    axes: Axes = {name: {0: "T"} for name in (*inputs, *outputs)} | {"sound": {0: "S"}}
    around = model.decoder.margin + (model.config.saliency_frames or 0) // 2
    content = traced(CurveGraph(model), example, (*inputs, "peak"), outputs, axes, stored)
    frontend = cast("WhisperFrontend", model.frontend)
    sizes = {"n_mels": frontend.config.n_mels, "mel_rate": frontend.mel.rate}
    parts = parts_of(around)._asdict() | sizes
    return content, {"schema": SCHEMA, "parts": json.dumps(parts)}


def _causal(model: DEITalk, stored: Collection[str]) -> tuple[Any, dict[str, str]]:
    """Graph of any number of frames of any number of streams; its metadata."""
    grid, states, batch, n_frames = grid_of(model), first_states(model), 2, 3
    example = (
        torch.zeros(batch, n_frames * grid.spectra, grid.length),
        torch.full((batch, n_frames, len(EMOTIONS) + len(model.actors)), 0.2),
        *(first.expand(batch, *first.shape).clone() for first in states.values()),
    )
    inputs = ("windows", "emotion", *states)
    outputs = (*OUTPUTS, EFFORT, *(NEXT + name for name in states))
    axes: Axes = {name: {0: "B"} for name in (*inputs, *outputs)}
    axes["windows"][1] = "S"
    rings = dict(zip(states, causal_frontend(model).rings[1:], strict=False))
    for name in (name for name, axis in rings.items() if axis):
        axes[NEXT + name][rings[name]] = "T"
    for name in ("emotion", *OUTPUTS, EFFORT):
        axes[name][1] = "T"
    content = traced(CausalStep(causal_graph(model)), example, inputs, outputs, axes, stored)
    described = [
        {"name": name, "shape": list(first.shape), "first": _first_value(first)}
        for name, first in states.items()
    ]
    texts = {"grid": json.dumps(grid._asdict()), "state": json.dumps(described)}
    texts["rings"] = json.dumps(causal_frontend(model).rings)
    texts["effort"] = json.dumps(model.config.effort)
    return content, texts | {"schema": CAUSAL_SCHEMA}


def _first_value(first: torch.Tensor) -> Any:
    """One number if all are equal, else nested lists."""
    low = float(first.min())
    return low if bool((first == low).all()) else first.tolist()


def rules_entry(model: DEITalk, ahead: int | None = None) -> str:
    """The rules of a model as a graph for any streams and frames: an entry of the metadata."""
    rules = CurvePass(model.controls, model.rules, ahead)
    example = rules.example()
    axes: Axes = {name: {0: "B"} for name in (*RULES_INPUTS, *RULES_OUTPUTS)}
    for name in (*RULES_INPUTS[:4], *RULES_OUTPUTS[:3]):
        axes[name][1] = "T"
    content = fused(traced(rules, example, RULES_INPUTS, RULES_OUTPUTS, axes))
    graph = base64.b64encode(content.SerializeToString()).decode()
    return json.dumps({"behind": rules.behind, "ahead": rules.ahead, "graph": graph})


def _leave_weights(graph: Any, types: dict[str, str]) -> tuple[str, ...]:
    """Leave the weights of the folder out, and return their names; float16 is cast."""
    from onnx import TensorProto, helper

    casts, left = [], []
    for weight in graph.initializer:
        if (kind := types.get(weight.name.removeprefix(WEIGHTS))) is None:
            continue
        name = weight.name
        left.append(name.removeprefix(WEIGHTS))
        weight.data_location = TensorProto.EXTERNAL
        weight.external_data.add(key="location", value=WEIGHTS_FILE)
        if kind == "F16":
            weight.name, weight.data_type = name + STORED, TensorProto.FLOAT16
            casts.append(helper.make_node("Cast", [weight.name], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
    return tuple(left)
