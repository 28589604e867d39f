"""Export of a curve model to one ONNX file, with all that a reader needs beside the numbers."""

import base64
import io
import json
import math
import warnings
from collections import Counter
from collections.abc import Callable
from copy import copy, deepcopy
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.mel import FLOOR, MEAN, SPREAD, MelSpectrogram, derivative
from deitalk.config.rig_file import rig_text
from deitalk.emotions import EMOTIONS
from deitalk.errors import CheckpointError, MissingError
from deitalk.frontends.mel_bilstm import MelFrontend, TemporalAttention
from deitalk.frontends.whisper import WhisperFrontend
from deitalk.installed import __version__
from deitalk.models.curve_model import (
    DEITalk,
    TensorState,
    advance,
    causal_frontend,
    first_state,
    grid_of,
)
from deitalk.models.intensity import local_maximum
from deitalk.models.onnx.network import CAUSAL_SCHEMA, NEXT, SCHEMA
from deitalk.models.onnx.rules import INPUTS as RULES_INPUTS
from deitalk.models.onnx.rules import LIVE, WHOLE
from deitalk.models.onnx.rules import OUTPUTS as RULES_OUTPUTS
from deitalk.models.onnx.whisper_graph import ProductMel, WhisperGraph, parts_of
from deitalk.models.protocol import neutral_weights
from deitalk.postprocess.curve_pass import CurvePass
from deitalk.postprocess.tracks import LIVE_AHEAD, N_SHOWN
from rig.files import atomic_write

# Mel spectra in a graph: the Fourier transform is a product with two matrices.

MARGIN = 4096
"""Zeros on either side of the sound, longer than any window and shift."""


def fourier_products(mel: MelSpectrogram) -> tuple[Tensor, Tensor]:
    """Matrices of mel power: samples (W,) to parts of each taper's spectrum, squares to (F,)."""
    angle = 2 * math.pi / mel.n_fft * torch.arange(mel.n_fft // 2 + 1, dtype=torch.float64)
    angle = torch.arange(mel.length, dtype=torch.float64)[:, None] * angle
    waves = torch.cat((angle.cos(), angle.sin()), dim=1)
    tapers = mel.tapers.double()
    transform = torch.cat([taper[:, None] * waves for taper in tapers], dim=1).float()
    return transform, mel.filters.repeat(2 * len(tapers), 1) / (mel.length * len(tapers))


class MelGraph(nn.Module):
    """`MelSpectrogram` of a whole sound, at several shifts side by side."""

    index: Tensor
    transform: Tensor
    filters: Tensor

    def __init__(self, mel: MelSpectrogram, shifts: list[int]) -> None:
        super().__init__()
        step = Fraction(SAMPLE_RATE) / Fraction(mel.frame_rate).limit_denominator(1000)
        self.period, self.count, self.phases = step.numerator, step.denominator, len(shifts)
        self.length = mel.length
        starts = torch.round(torch.arange(self.count, dtype=torch.float64) * float(step)).long()
        within = torch.arange(mel.length) - mel.length // 2 + MARGIN
        index = torch.tensor(shifts)[:, None, None] + starts[:, None] + within
        self.register_buffer("index", index.flatten())
        transform, filters = fourier_products(mel)
        self.register_buffer("transform", transform)
        self.register_buffer("filters", filters)

    def forward(self, sound: Tensor, n_spectra: int) -> Tensor:
        """Map (S,) to (phases, 3, F, n_spectra)."""
        mel = self.scaled(sound, n_spectra)
        slope = derivative(mel)
        return torch.stack((mel, slope, derivative(slope)), dim=1)

    def scaled(self, sound: Tensor, n_spectra: int) -> Tensor:
        """Map (S,) to (phases, F, n_spectra), without the derivatives."""
        periods = torch.arange((n_spectra + self.count - 1) // self.count) * self.period
        padded = F.pad(sound, (MARGIN, MARGIN))
        frames = padded[(periods[:, None] + self.index).flatten()]
        frames = frames.view(-1, self.phases, self.count, self.length)
        frames = frames.transpose(0, 1).reshape(self.phases, -1, self.length)[:, :n_spectra]
        power = (frames @ self.transform).square() @ self.filters
        return ((torch.log(power + FLOOR) - MEAN) / SPREAD).transpose(1, 2)


BLOCK = 64
"""Frames whose attention is applied in one product."""


OUTPUTS, EFFORT = ("curves", "neutral", "saliency", "intensity"), "effort"
"""Outputs of the graphs, in their order; a whole clip has the last one where a model reads it."""


class MelFrontendGraph(nn.Module):
    """`MelFrontend` of a whole clip, averaged over its phases."""

    query_weight: Tensor
    query_bias: Tensor

    def __init__(self, frontend: MelFrontend) -> None:
        super().__init__()
        config = frontend.config
        steps = config.frame_rate / config.time_stack / FRAME_RATE
        if config.recurrence != "segment" or steps != round(steps):
            raise CheckpointError(
                "only models with recurrence: segment and a multiple of 30 spectra a second are "
                "exported"
            )
        self.frontend, self.steps, self.stack = frontend, round(steps), config.time_stack
        self.window = config.window_frames // config.time_stack
        self.mel = MelGraph(frontend.mel, frontend.shifts)
        with torch.no_grad():
            weight, bias = frontend.attention.joined_query()
        self.register_buffer("query_weight", weight)
        self.register_buffer("query_bias", bias)
        self.gather = copy(frontend.spectral.gather)
        self.gather.batch_first = False

    def forward(self, sound: Tensor, n_frames: int) -> Tensor:
        """Map (S,) to (1, T, D)."""
        frontend = self.frontend
        length = self.steps * (n_frames - 1) + 1
        spectral = self._spectral(self.mel(sound, length * self.stack))
        memory, _ = frontend.recurrent(
            spectral.reshape(self.mel.phases, -1, frontend.recurrent.input_size)
        )
        attended = self._attended(frontend.attention, memory)
        rows: Tensor = frontend.rig(frontend.centred(attended, memory[:, :: self.steps]))
        return rows.mean(dim=0, keepdim=True)

    def _spectral(self, mel: Tensor) -> Tensor:
        """`SpectralGathering`, with the frequencies in front for its LSTM."""
        spectral = self.frontend.spectral
        x = spectral.convolve(mel).permute(2, 0, 3, 1)  # (F / 4, B, L, C)
        x, _ = self.gather(x.flatten(1, 2))
        rows: Tensor = spectral.project(x.transpose(0, 1).flatten(1))
        return rows.view(mel.shape[0], mel.shape[3], -1)

    def _attended(self, attention: TemporalAttention, memory: Tensor) -> Tensor:
        """`TemporalAttention.along` around every `steps`-th state."""
        half, before = attention.query_frames // 2, self.window // 2
        padded = F.pad(memory.transpose(1, 2), (half, half))
        query = F.conv1d(padded, self.query_weight, self.query_bias, stride=self.steps)
        query = query.transpose(1, 2)  # (B, T, C_att)
        sides = (0, 0, before, self.window - before)
        keys = F.pad(attention.key_project(memory), sides)
        outside = F.pad(torch.zeros_like(memory[:, :, :1]), sides, value=-1e9)
        n_frames = query.shape[1]
        scores = [
            attention.score(torch.tanh(self._at(keys, i, n_frames) + query))
            + self._at(outside, i, n_frames)
            for i in range(self.window)
        ]
        weights = torch.cat(scores, dim=-1).softmax(dim=-1)  # (B, T, window)
        return self._weighted(
            weights, F.pad(memory, (0, 0, before, BLOCK * self.steps + self.window))
        )

    def _weighted(self, weights: Tensor, memory: Tensor) -> Tensor:
        """Sum of the memory's windows by the weights: products of banded blocks.

        A block's rows of weights, each padded to one window and the block's steps, become a band
        when they are read as rows that are `steps` shorter.
        """
        batch, n_frames, size = weights.shape[0], weights.shape[1], memory.shape[-1]
        n_blocks = (n_frames + BLOCK - 1) // BLOCK
        width = self.window + BLOCK * self.steps
        rows = F.pad(weights, (0, BLOCK * self.steps, 0, BLOCK))[:, : n_blocks * BLOCK]
        band = rows.reshape(batch, n_blocks, BLOCK * width)[:, :, : BLOCK * (width - self.steps)]
        band = band.reshape(batch, n_blocks, BLOCK, width - self.steps)
        starts = torch.arange(n_blocks) * (BLOCK * self.steps)
        places = starts[:, None] + torch.arange(width - self.steps)
        parts = memory[:, places.flatten()].reshape(batch, n_blocks, width - self.steps, size)
        return (band @ parts).reshape(batch, n_blocks * BLOCK, size)[:, :n_frames]

    def _at(self, padded: Tensor, offset: int, n_frames: int) -> Tensor:
        last = offset + self.steps * (n_frames - 1) + 1
        return padded[:, offset : last : self.steps]


GRAPHS: dict[str, Callable[[Any], nn.Module]] = {"mel": MelFrontendGraph, "whisper": WhisperGraph}
"""By the kinds of frontends that are exported."""


# A curve model as one graph for ONNX: sound and emotion of a whole clip in, curves out.
#
# The layers are those of the model; what lies between them is written without operations that
# other runtimes lack: the Fourier transform is a product with two matrices, windows along time
# are strided slices.


class CurveGraph(nn.Module):
    """A curve model, arguments and results without a batch.

    Parameters
    ----------
    model : DEITalk
        With a Whisper or mel frontend and an intensity module.

    Raises
    ------
    CheckpointError
        If it has other ones.
    """

    neutral: Tensor
    frequency: Tensor

    def __init__(self, model: DEITalk) -> None:
        super().__init__()
        self.model = model
        graph = GRAPHS.get(model.config.frontend.kind)
        if graph is None or not model.config.intensity:
            raise CheckpointError(
                "only models with a Whisper or mel frontend and an intensity module are exported, "
                "such as default and live"
            )
        self.frontend = graph(model.frontend)
        self.register_buffer("neutral", torch.from_numpy(neutral_weights(1)))
        size = model.frontend.output_size
        exponent = torch.arange(0, size, 2, dtype=torch.float32) / size
        self.register_buffer("frequency", 20 * math.pi * 10000.0**-exponent)

    def forward(
        self, sound: Tensor, emotion: Tensor, place: Tensor, peak: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Predict a clip: `OUTPUTS`, and `EFFORT`.

        Parameters
        ----------
        sound : Tensor [shape=(S,)]
            16 kHz, level-normalised.
        emotion : Tensor [shape=(T, 5 + actors)]
            Weights of the styles.
        place : Tensor [shape=(T,), range 0 to 1]
            Frame i of T as i / T.
        peak : Tensor [shape=()]
            Of a Whisper frontend: see `WhisperGraph.forward`.
        """
        known = () if peak is None else (peak,)
        speech = self.frontend(sound, emotion.shape[0], *known)
        intensity = self._intensity(speech)
        placed = speech
        if self.model.config.positions:
            angle = place[:, None] * self.frequency
            waves = torch.stack((angle.sin(), angle.cos()), dim=-1).flatten(-2)
            placed = speech + waves[:, : speech.shape[-1]]
        n_emotions = self.neutral.shape[1]
        plain = torch.cat((0 * emotion[:, :n_emotions] + self.neutral, emotion[:, n_emotions:]), 1)
        saliency, strength, guidance = intensity
        readings = self.model.decoder(
            placed.expand(2, -1, -1), torch.stack((plain, emotion)), guidance.expand(2, -1, -1)
        )
        if self.model.lips is not None:
            readings = self.model.lips.correct(readings, self.model.lips(speech)[0])
        rows = readings[1], readings[0], saliency[0], strength[0]
        effort = self.model.intensity.effort
        return rows if effort is None else (*rows, effort(speech)[0, :, 0])

    def _intensity(self, speech: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Saliency, strength (1, T) and guidance (1, T, E or 2 E), as `DynamicIntensity`."""
        module = self.model.intensity
        features = module.project(speech)
        saliency = self._saliency(features)
        strength = torch.sigmoid(4 * (F.softplus(module.slope) * saliency + module.offset))
        guidance = saliency.unsqueeze(-1) * features
        if module.kept is not None:
            before = module.kept(speech)
            kept = self._saliency(before).unsqueeze(-1) * before
            guidance = torch.cat((guidance, kept), dim=-1)
        return saliency, strength, guidance

    def _saliency(self, features: Tensor) -> Tensor:
        """Cosine of every frame with the largest values around it (1, T)."""
        frames = self.model.intensity.saliency_frames
        if frames is None:
            around = features.amax(dim=1, keepdim=True)
        else:
            around = local_maximum(features, frames)
        return (features * around).sum(dim=-1) / (_norm(features) * _norm(around))


def _norm(features: Tensor) -> Tensor:
    return features.square().sum(dim=-1).sqrt().clamp_min(1e-8)


# One frame of a causal curve model as a graph for ONNX: sound and state in, curves and state out.
#
# The level of the sound follows itself from frame to frame, so a graph of several frames would
# need a loop; one frame a call needs none.


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
        frame = (rows.emotional, rows.neutral, rows.saliency, rows.strength, rows.effort)
        return (*(part[:, 0] for part in frame), *after.tensors())


def first_states(model: DEITalk) -> dict[str, Tensor]:
    """Names and first values of a stream's state, without the stream's axis."""
    state = first_state(model, 1)
    layers = range(len(state.frontend.layers) // 3)
    names = ["level", "mel", "place"]
    names += [f"{part}_{k}" for k in layers for part in ("rows", "keys", "values")]
    names += ["saliency_past"]
    names += [f"{k}_{i}" for k in ("neutral", "emotional") for i in range(len(state.neutral))]
    names += ["lips_past"] * len(state.lips)
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
        texts[WHOLE] = pass_entry(model)
        if model.is_causal:
            texts[LIVE] = pass_entry(model, LIVE_AHEAD)
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
        "shown_emotions": list(model.emotions),
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
    outputs = [*OUTPUTS, *[EFFORT] * model.config.effort]
    axes |= {name: {0: "T"} for name in outputs}
    names, texts = list(inputs), {}
    if model.config.frontend.kind == "whisper":
        example, names = (*example, torch.tensor(0.0)), [*names, "peak"]
        around = model.decoder.margin + (model.config.saliency_frames or 0) // 2
        frontend = cast("WhisperFrontend", model.frontend)
        sizes = {"n_mels": frontend.config.n_mels, "mel_rate": frontend.mel.rate}
        parts = parts_of(around)._asdict() | sizes
        texts = {"parts": json.dumps(parts)}
    _export(graph, example, path, names, outputs, axes)
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
    outputs = [*OUTPUTS, EFFORT, *(NEXT + name for name in states)]
    axes = {name: {0: "B"} for name in (*inputs, *outputs)}
    _export(graph, example, path, inputs, outputs, axes)
    described = [
        {"name": name, "shape": list(first.shape), "first": _first_value(first)}
        for name, first in states.items()
    ]
    texts = {"grid": json.dumps(grid._asdict()), "state": json.dumps(described)}
    texts["frontend_states"] = str(list(states).index("saliency_past"))
    texts["effort"] = json.dumps(model.config.effort)
    return texts | {"schema": CAUSAL_SCHEMA}


def pass_entry(model: DEITalk, ahead: int | None = None) -> str:
    """The rules of a model as a graph for any streams and frames: an entry of the metadata."""
    rules = CurvePass(model.controls, model.rules, ahead).eval()
    batch, n_frames = 2, 3
    face = rules.rest.expand(batch, n_frames, -1).clone()
    shown = torch.zeros(batch, n_frames, N_SHOWN)
    said = rules.first(batch)[:, :n_frames, 2 * rules.size :]
    example = face, face, said, shown, face[:, 0], torch.ones(batch), rules.first(batch)
    axes = {name: {0: "B"} for name in (*RULES_INPUTS, *RULES_OUTPUTS)}
    for name in (*RULES_INPUTS[:4], *RULES_OUTPUTS[:3]):
        axes[name][1] = "T"
    graph = io.BytesIO()
    _export(rules, example, graph, [*RULES_INPUTS], [*RULES_OUTPUTS], axes)
    content = base64.b64encode(graph.getvalue()).decode()
    return json.dumps({"behind": rules.behind, "ahead": rules.ahead, "graph": content})


def _first_value(first: torch.Tensor) -> Any:
    """One number if all are equal, else nested lists."""
    low = float(first.min())
    return low if bool((first == low).all()) else first.tolist()


def _export(
    graph: torch.nn.Module,
    example: tuple[torch.Tensor, ...],
    path: Path | io.BytesIO,
    inputs: list[str],
    outputs: list[str],
    axes: dict[str, dict[int, str]],
) -> None:
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter's own, on constants that are meant
        torch.onnx.export(
            graph,
            example,
            cast("Any", path),
            dynamo=False,  # the newer exporter unrolls LSTMs over time
            opset_version=OPSET,
            input_names=inputs,
            output_names=outputs,
            dynamic_axes=axes,
        )
