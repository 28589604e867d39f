"""Export of a curve model to one ONNX file, with all that a reader needs beside the numbers."""

import json
import warnings
from collections import Counter
from copy import deepcopy
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.config.rig_file import rig_text
from deitalk.emotions import EMOTIONS
from deitalk.errors import MissingError
from deitalk.frontends.whisper import WhisperFrontend
from deitalk.installed import __version__
from deitalk.models.causal_torch import TensorState, advance, causal_frontend, first_state, grid_of
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.graph import CurveGraph, GraphOutput
from deitalk.models.onnx.network import CAUSAL_SCHEMA, NEXT, SCHEMA
from deitalk.models.onnx.whisper_graph import ProductMel, parts_of
from rig.files import atomic_write

# One frame of a causal curve model as a graph for ONNX: sound and state in, curves and state out.
#
# The level of the sound follows itself from frame to frame, so a graph of several frames would
# need a loop; one frame a call needs none.

OUTPUTS = ("curves", "neutral", "saliency", "intensity")


class CausalGraph(nn.Module):
    """A causal curve model, one frame of B streams a call.

    Parameters
    ----------
    model : DEITalk
        With a causal frontend.
    """

    def __init__(self, model: DEITalk) -> None:
        super().__init__()
        self.model = deepcopy(model)
        frontend = causal_frontend(self.model)
        frontend.mel = ProductMel.of(frontend.mel)

    def forward(self, windows: Tensor, emotion: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        """Predict the next frame.

        Parameters
        ----------
        windows : Tensor [shape=(B, P, W)]
            Samples of the spectra of one rig frame.
        emotion : Tensor [shape=(B, 5 + actors)]
            Weights of the styles.
        state : Tensor
            From the call before; see `first_states`.
        """
        before = TensorState.of(state, causal_frontend(self.model).n_states)
        rows, after = advance(self.model, windows, emotion[:, None], before)
        frame = (rows.emotional, rows.neutral, rows.saliency, rows.strength)
        return (*(part[:, 0] for part in frame), *after.tensors())


def first_states(model: DEITalk) -> dict[str, Tensor]:
    """Names and first values of a stream's state, without the stream's axis."""
    state = first_state(model, 1)
    layers = range(len(state.frontend.layers) // 3)
    names = ["level", "mel", "place"]
    names += [f"{part}_{k}" for k in layers for part in ("rows", "keys", "values")]
    names += ["saliency_past"]
    names += [f"{k}_{i}" for k in ("neutral", "emotional") for i in range(len(state.neutral))]
    finite = (part[0].clamp_min(torch.finfo(torch.float32).min) for part in state.tensors())
    return dict(zip(names, cast("list[Tensor]", list(finite)), strict=True))


OPSET = 17
"""The first with LayerNormalization; read by ONNX Runtime 1.12 and later."""
LEVEL_DB = -23.0
"""Active level of the speech in the input, dB re full scale."""


def export_onnx(model: DEITalk, path: Path, *, name: str = "") -> None:
    """Write a model as an ONNX file.

    Parameters
    ----------
    model : DEITalk
        With a Whisper, mel or causal frontend and an intensity module.
    path : Path
        Replaced if it exists.
    name : str
        Name of the model, for the metadata.

    Raises
    ------
    CheckpointError
        If the model has parts that are not exported (see `CurveGraph` and `CausalGraph`).
    MissingError
        If the package onnx is not installed.
    """
    try:
        import onnx
    except ImportError:
        raise MissingError(
            "the export needs the package onnx; install it with pip install 'deitalk[onnx]'"
        ) from None
    model = model.cpu()
    with atomic_write(path) as beside:
        if model.is_causal:
            texts = _trace_causal(model, beside)
        else:
            texts = {"schema": SCHEMA, "level_db": json.dumps(LEVEL_DB)}
            texts |= _trace(CurveGraph(model).eval(), beside)
        content = onnx.load(str(beside))
        for key, value in (metadata(model, name) | texts).items():
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
        "frame_rate": FRAME_RATE,
        "rules": model.rules.model_dump(mode="json"),
    }
    texts = {key: json.dumps(value) for key, value in values.items()}
    texts |= {"name": name, "control_set": controls.id}
    return texts | {"rig": rig_text(controls)}


def _trace(graph: CurveGraph, path: Path) -> dict[str, str]:
    """Write the graph for any length of its inputs; return metadata of its frontend."""
    n_frames, model = FRAME_RATE, graph.model
    example: tuple[torch.Tensor, ...] = (
        torch.zeros(SAMPLE_RATE),
        torch.full((n_frames, len(EMOTIONS) + len(model.actors)), 0.2),
        torch.arange(n_frames) / n_frames,
    )
    inputs = {"sound": "S", "emotion": "T", "place": "T"}
    axes = {name: {0: size} for name, size in inputs.items()}
    axes |= {name: {0: "T"} for name in GraphOutput._fields}
    names, texts = list(inputs), {}
    if model.config.frontend.kind == "whisper":
        example, names = (*example, torch.tensor(0.0)), [*names, "peak"]
        around = model.decoder.margin + (model.config.saliency_frames or 0) // 2
        frontend = cast("WhisperFrontend", model.frontend)
        sizes = {"n_mels": frontend.config.n_mels, "mel_rate": frontend.mel.rate}
        parts = parts_of(around)._asdict() | sizes
        texts = {"parts": json.dumps(parts)}
    _export(graph, example, path, names, list(GraphOutput._fields), axes)
    return texts


def _trace_causal(model: DEITalk, path: Path) -> dict[str, str]:
    """Write the graph of one frame, for any number of streams; return its metadata."""
    graph, grid, states = CausalGraph(model).eval(), grid_of(model), first_states(model)
    batch = 2
    example = (
        torch.zeros(batch, grid.spectra, grid.length),
        torch.full((batch, len(EMOTIONS) + len(model.actors)), 0.2),
        *(first.expand(batch, *first.shape).clone() for first in states.values()),
    )
    inputs = ["windows", "emotion", *states]
    outputs = [*OUTPUTS, *(NEXT + name for name in states)]
    axes = {name: {0: "B"} for name in (*inputs, *outputs)}
    _export(graph, example, path, inputs, outputs, axes)
    described = [
        {"name": name, "shape": list(first.shape), "first": _first_value(first)}
        for name, first in states.items()
    ]
    texts = {"grid": json.dumps(grid._asdict()), "state": json.dumps(described)}
    texts["frontend_states"] = str(list(states).index("saliency_past"))
    return texts | {"schema": CAUSAL_SCHEMA}


def _first_value(first: torch.Tensor) -> Any:
    """One number if all are equal, else nested lists."""
    low = float(first.min())
    return low if bool((first == low).all()) else first.tolist()


def _export(
    graph: torch.nn.Module,
    example: tuple[torch.Tensor, ...],
    path: Path,
    inputs: list[str],
    outputs: list[str],
    axes: dict[str, dict[int, str]],
) -> None:
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter's own, on constants that are meant
        torch.onnx.export(
            graph,
            example,
            path,
            dynamo=False,  # the newer exporter unrolls LSTMs over time
            opset_version=OPSET,
            input_names=inputs,
            output_names=outputs,
            dynamic_axes=axes,
        )
