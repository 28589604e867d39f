"""Curve models in ONNX Runtime, without torch."""

import gzip
import json
import math
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import ValidationError

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.log_mel import loudest
from deitalk.config.rules import RulesConfig
from deitalk.errors import CheckpointError, MissingError
from deitalk.models.folder import (
    weight_files,
)
from deitalk.models.onnx.rules import LIVE, WHOLE, OnnxPass
from deitalk.models.protocol import (
    Product,
    Reading,
    Tracks,
    is_neutral,
    styles_of,
)
from rig import ControlSet, default_controls, limits
from rig.arrays import Float32
from rig.controls import DEFAULT_ID
from rig.errors import quoted
from rig.files.reading import check_file

SCHEMA, CAUSAL_SCHEMA = "deitalk.graph/1", "deitalk.graph-live/3"
NEXT = "next_"
"""Before the names of the outputs that are the state for the next call."""
WEIGHTS, STORED = "model.", "_stored"
"""Before the names of weights in a graph; after those that are cast."""
WEIGHTS_FILE = "model.safetensors"
"""What a graph calls the place of each weight that it is given."""


class GraphHeader(NamedTuple):
    """What is known of a graph before it is opened."""

    digest: str
    """`graph_digest` of the model folder that it was made for."""
    weights: tuple[str, ...]
    """Names of the weights that it is given."""
    is_causal: bool
    """Whether it predicts the next frames of streams."""


class OnnxFile:
    """The graph of a model in ONNX Runtime, with the weights of its folder.

    Parameters
    ----------
    path : Path
        Of `deitalk.models.onnx.engine_graph.write_graph`.
    folder : Path
        The model's.
    threads : int
        Processor threads.
    once : bool
        See `open_session`.

    Raises
    ------
    CheckpointError
        If a file is not there or damaged.
    MissingError
        If onnxruntime is not installed.
    """

    def __init__(self, path: Path, folder: Path, threads: int = 1, *, once: bool = False) -> None:
        header, graph = read_graph(path)
        once = once and not header.is_causal
        self.path, self.is_causal = path, header.is_causal
        self.open = partial(open_session, path=path, threads=threads, once=once)
        weights = stored_weights(folder)
        if missing := [name for name in header.weights if name not in weights]:
            raise CheckpointError(f"{folder}: no weight {quoted(missing[0])}; copy the model again")
        _check_graph(graph, len(header.weights), path)
        # ONNX Runtime does not copy them: they live as long as the session.
        self.weights = {name: weights[name] for name in header.weights}
        self.session = self.open(graph, weights=self.weights)
        self.metadata: Mapping[str, str] = self.session.get_modelmeta().custom_metadata_map
        if self.metadata.get("schema") != (CAUSAL_SCHEMA if self.is_causal else SCHEMA):
            raise damaged(path)
        try:
            self.rules = RulesConfig.model_validate(json.loads(self.metadata["rules"]))
            self.actors: tuple[str, ...] = tuple(json.loads(self.metadata["actors"]))
            self.emotions: tuple[str, ...] = tuple(json.loads(self.metadata["shown_emotions"]))
            self.controls = _controls(path, self.metadata)
        except (KeyError, ValueError, ValidationError):
            raise damaged(path) from None


def read_graph(path: Path) -> tuple[GraphHeader, bytes]:
    """Header and ONNX file of a graph file."""
    check_file(path, limits.GRAPH_BYTES, error=CheckpointError)
    try:
        with gzip.open(path) as stream:
            content = stream.read(limits.GRAPH_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise CheckpointError(f"{path}: damaged ({error}); remove it") from None
    if len(content) > limits.GRAPH_BYTES:
        raise CheckpointError(f"{path}: unpacks to more than {limits.GRAPH_BYTES} bytes; remove it")
    line, _, graph = content.partition(b"\n")
    try:
        header = json.loads(line)
        weights = tuple(map(str, header["weights"]))
        return GraphHeader(str(header["digest"]), weights, bool(header["is_causal"])), graph
    except (ValueError, KeyError, TypeError):
        raise damaged(path) from None


def _check_graph(graph: bytes, n_weights: int, path: Path) -> None:
    """Refuse a graph that names files, or repeats a part of itself: those of deitalk do neither.

    A model folder may be a stranger's. Operators of other libraries are refused by ONNX Runtime,
    which is given none.
    """
    name = WEIGHTS_FILE.encode()
    place = b"\n\x08location\x12%c%s" % (len(name), name)
    if not graph.count(b"location") == graph.count(place) == n_weights:
        raise CheckpointError(f"{path}: its graph reads other files than the weights; remove it")
    if b"Loop" in graph or b"Scan" in graph:
        raise CheckpointError(f"{path}: its graph has loops, which deitalk writes none; remove it")


def stored_weights(folder: Path) -> dict[str, np.ndarray]:
    """Weights of a model folder as they are stored, by their names.

    Raises
    ------
    CheckpointError
        If a file is damaged, or a weight has another type than `TYPES`.
    """
    from safetensors import SafetensorError

    found: dict[str, np.ndarray] = {}
    for path in weight_files(folder):
        check_file(path, limits.WEIGHTS_BYTES, error=CheckpointError)
        try:
            found |= _mapped(path)
        except (SafetensorError, OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise CheckpointError(
                f"{path}: no safetensors file ({reason}); copy it again"
            ) from None
    return found


TYPES = {"F16": np.float16, "F32": np.float32, "F64": np.float64, "I64": np.int64, "BOOL": np.bool_}
"""Types of numpy by their names in safetensors files."""


def _mapped(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a safetensors file, which share the pages of the file."""
    from safetensors import safe_open

    with safe_open(path, "np"):  # its checks of the header
        content = np.memmap(path, np.uint8, "r")
    size = int.from_bytes(content[:8].tobytes(), "little")
    entries: dict[str, Any] = json.loads(content[8 : 8 + size].tobytes())
    found = {}
    for name in entries.keys() - {"__metadata__"}:
        (first, last), kind = entries[name]["data_offsets"], entries[name]["dtype"]
        if kind not in TYPES:
            raise ValueError(f"{quoted(name)} has the type {kind}; use one of {', '.join(TYPES)}")
        part: np.ndarray = content[8 + size :][first:last].view(TYPES[kind])
        found[name] = part.reshape(entries[name]["shape"])
    return found


def stored_types(folder: Path) -> dict[str, str]:
    """Type of each weight of a model folder, as safetensors names it: ``F16``, ``F32``."""
    from safetensors import safe_open

    found: dict[str, str] = {}
    for path in weight_files(folder):
        with safe_open(path, "np") as file:
            found |= {name: file.get_slice(name).get_dtype() for name in file.keys()}
    return found


def damaged(path: Path) -> CheckpointError:
    """Error of a file whose metadata lack something."""
    return CheckpointError(f"{path}: damaged metadata; remove it")


class OpenedGraph:
    """What both kinds of models have.

    Parameters
    ----------
    file : OnnxFile

    Raises
    ------
    CheckpointError
        If its metadata are damaged.
    """

    product: Product = "curves"

    def __init__(self, file: OnnxFile) -> None:
        self.path, self.metadata, self._session = file.path, file.metadata, file.session
        self._open = file.open
        self._passes: dict[str, OnnxPass] = {}
        self.controls, self.rules = file.controls, file.rules
        self.actors, self.emotions = file.actors, file.emotions
        try:
            self._read_metadata()
        except (AttributeError, KeyError, TypeError, ValueError):
            raise damaged(self.path) from None

    def _read_metadata(self) -> None:
        raise NotImplementedError

    def eval(self) -> Self:
        """The network itself: it has no other mode."""
        return self

    def _opened(self, graph: bytes) -> Any:
        _check_graph(graph, 0, self.path)
        return self._open(graph)

    def curve_pass(self, *, live: bool = False) -> OnnxPass:
        """Rules after the network, opened once; see `deitalk.models.protocol.Network`."""
        entry = LIVE if live else WHOLE
        try:
            if entry not in self._passes:
                made = OnnxPass(self.metadata[entry], self.controls, self._opened)
                self._passes[entry] = made
            return self._passes[entry]
        except (KeyError, TypeError, ValueError):
            raise damaged(self.path) from None


class OnnxNetwork(OpenedGraph):
    """A model for whole recordings; a `deitalk.models.protocol.CurveNetwork`."""

    is_causal = False

    def _read_metadata(self) -> None:
        parts = json.loads(self.metadata["parts"])
        self._mel = int(parts["n_mels"]), int(parts["mel_rate"])
        self._part, self._before, self._after = (
            int(parts[name]) for name in ("frames", "before", "after")
        )

    def read(
        self,
        sound: Float32,
        weights: Float32,
        actor: str = "",
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Reading:
        """Curves of a whole recording; see `deitalk.models.protocol.CurveNetwork`."""
        total = len(weights)
        styles = styles_of(weights, self.actors, actor)
        place = np.arange(total, dtype=np.float32) / np.float32(total)
        known = self._known(sound, gain)
        parts = []
        for start in range(0, total, self._part):
            stop = min(start + self._part, total)
            first, last = max(start - self._before, 0), min(stop + self._after, total)
            begin, end = (frame * SAMPLE_RATE // FRAME_RATE for frame in (first, last))
            piece = sound[begin:] if last == total else sound[begin:end]
            piece = piece * np.float32(gain)
            inputs = {"sound": piece, "emotion": styles[first:last], "place": place[first:last]}
            rows = self._session.run(None, inputs | known)
            parts.append([row[start - first : stop - first] for row in rows])
            progress(stop / total)
        curves, neutral, *tracks = (
            np.concatenate(part) if len(part) > 1 else part[0] for part in zip(*parts, strict=True)
        )
        emotional = neutral if is_neutral(weights) else curves
        return Reading(neutral, emotional, Tracks(*tracks))

    def _known(self, sound: Float32, gain: float) -> dict[str, Float32]:
        """What a part must know of the whole recording: its peak."""
        n_mels, rate = self._mel
        n_frames = frame_count(len(sound)) * rate // FRAME_RATE
        peak = loudest(sound, n_mels, n_frames, rate) + 2 * math.log10(gain)
        return {"peak": np.array(peak, np.float32)}


def open_session(
    graph: bytes,
    path: Path,
    threads: int,
    weights: Mapping[str, np.ndarray] = {},
    *,
    once: bool = False,
) -> Any:
    """Session of ONNX Runtime of a graph and its weights; `path` is for messages.

    `once` opens it in a third of the time (25 ms for 80), and each run takes 5 ms more.
    """
    try:
        import onnxruntime
    except ImportError:
        raise MissingError(
            "the backend onnx needs onnxruntime; pip install onnxruntime, or use --backend torch"
        ) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 3
    # beyond constant folding, the search for fusions takes longer than they save in a minute
    level = onnxruntime.GraphOptimizationLevel
    options.graph_optimization_level = level.ORT_DISABLE_ALL if once else level.ORT_ENABLE_BASIC
    if weights:
        names = [WEIGHTS + name + STORED * (x.dtype == np.float16) for name, x in weights.items()]
        values = [onnxruntime.OrtValue.ortvalue_from_numpy(x) for x in weights.values()]
        options.add_external_initializers(names, values)
    try:
        return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its errors have classes of its own, derived from Exception
        reason = " ".join(str(error).split())[:160]
        raise CheckpointError(f"{path}: cannot be read as ONNX ({reason}); remove it") from None


def _controls(path: Path, metadata: Mapping[str, str]) -> ControlSet:
    if metadata["control_set"] == DEFAULT_ID:
        return default_controls()
    from deitalk.config.rig_file import parse_controls

    return parse_controls(metadata["rig"], path)
