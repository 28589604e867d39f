"""Curve models in ONNX Runtime, without torch."""

import hashlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import ValidationError

from deitalk import postprocess
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.log_mel import loudest
from deitalk.config.rig_file import parse_controls
from deitalk.config.rules import RulesConfig
from deitalk.emotions import EMOTIONS
from deitalk.errors import CheckpointError, DeitalkError, MissingError
from deitalk.installed import __version__
from deitalk.models.folder import model_folder, weights_hash
from deitalk.models.onnx.rules import LIVE, WHOLE, OnnxPass
from deitalk.models.protocol import (
    NetworkRows,
    Product,
    Reading,
    SpectraGrid,
    State,
    Tracks,
    is_neutral,
    styles_of,
)
from rig import ControlSet, default_controls, limits
from rig.arrays import Float32
from rig.controls import DEFAULT_ID
from rig.errors import quoted
from rig.files import cache_folder
from rig.files.reading import check_file

SCHEMA, CAUSAL_SCHEMA = "deitalk.onnx/2", "deitalk.onnx-live/3"
NEXT = "next_"
"""Before the names of the outputs that are the state for the next call."""
PART_FRAMES, CONTEXT_FRAMES = 8640, 2880
"""Frames of a recording that are predicted at once, and frames on either side of them that are
predicted as context only (96 s), unless the file says otherwise. The memory of a recurrent network
is long: with this context, parts and whole differ by at most 0.02 of a range. Both are multiples of
3, so that parts begin on a sample."""


class OnnxFile:
    """A file of ``deitalk model export --onnx`` in ONNX Runtime.

    Parameters
    ----------
    path : Path
        An ``.onnx`` file.
    threads : int
        Processor threads.

    Raises
    ------
    CheckpointError
        If there is no such file, or it is no export of a curve model.
    MissingError
        If onnxruntime is not installed.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        check_file(path, limits.WEIGHTS_BYTES, error=CheckpointError)
        self.path, self.threads = path, threads
        self.session = open_session(str(path), path, threads)
        self.metadata: Mapping[str, str] = self.session.get_modelmeta().custom_metadata_map
        if self.metadata.get("schema") not in (SCHEMA, CAUSAL_SCHEMA):
            raise CheckpointError(f"{path}: no exported deitalk model ({SCHEMA}); export it again")
        try:
            self.rules = RulesConfig.model_validate(json.loads(self.metadata["rules"]))
            self.actors: tuple[str, ...] = tuple(json.loads(self.metadata["actors"]))
            shown = self.metadata.get("shown_emotions") or json.dumps(EMOTIONS)
            self.emotions: tuple[str, ...] = tuple(json.loads(shown))
            self.controls = _controls(path, self.metadata)
        except (KeyError, ValueError, ValidationError):
            raise damaged(path) from None

    @property
    def is_causal(self) -> bool:
        """Whether it predicts one frame a call."""
        return self.metadata["schema"] == CAUSAL_SCHEMA


def damaged(path: Path) -> CheckpointError:
    """Error of a file whose metadata lack something."""
    return CheckpointError(f"{path}: damaged metadata; export the model again")


class _Network:
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
        self._threads = file.threads
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

    def curve_pass(self, *, live: bool = False) -> OnnxPass:
        """Rules after the network; see `deitalk.models.protocol.Network`."""
        try:
            return OnnxPass(self.metadata[LIVE if live else WHOLE], self.controls, self._open)
        except (KeyError, TypeError, ValueError):
            raise damaged(self.path) from None

    def _open(self, graph: bytes) -> Any:
        return open_session(graph, self.path, self._threads)


class OnnxNetwork(_Network):
    """A model for whole recordings; a `deitalk.models.protocol.CurveNetwork`."""

    is_causal = False

    def _read_metadata(self) -> None:
        parts = json.loads(self.metadata.get("parts", "{}"))
        self._mel = parts.get("n_mels"), parts.get("mel_rate")
        self._part: int = parts.get("frames", PART_FRAMES)
        self._before: int = parts.get("before", CONTEXT_FRAMES)
        self._after: int = parts.get("after", CONTEXT_FRAMES)

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
        """What a part must know of the whole recording: of a Whisper frontend, its peak."""
        n_mels, rate = self._mel
        if n_mels is None:
            return {}
        n_frames = frame_count(len(sound)) * rate // FRAME_RATE
        peak = loudest(sound, n_mels, n_frames, rate) + 2 * math.log10(gain)
        return {"peak": np.array(peak, np.float32)}


def open_session(graph: str | bytes, path: Path, threads: int) -> Any:
    """Session of ONNX Runtime of a file or of bytes; `path` is for messages."""
    try:
        import onnxruntime
    except ImportError:
        raise MissingError(
            "the backend onnx needs onnxruntime; install it with pip install 'deitalk[onnx]'"
        ) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 3
    # beyond constant folding, the search for fusions takes longer than they save in a minute
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
    try:
        return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its errors have classes of its own, derived from Exception
        reason = " ".join(str(error).split())[:160]
        raise CheckpointError(
            f"{path}: cannot be read as ONNX ({reason}); export it again"
        ) from None


def _controls(path: Path, metadata: Mapping[str, str]) -> ControlSet:
    if metadata["control_set"] == DEFAULT_ID:
        return default_controls()
    return parse_controls(metadata["rig"], path)


# Causal curve models in ONNX Runtime, one frame a call, without torch.
#
# Letters: B streams, G frames of a call, P spectra of a frame, W samples of a spectrum.

PROGRESS_FRAMES = 300


class OnnxCausalNetwork(_Network):
    """A causal model; a `CausalNetwork`, and a `CurveNetwork` for whole recordings."""

    is_causal = True

    def _read_metadata(self) -> None:
        self.grid = SpectraGrid(**json.loads(self.metadata["grid"]))
        states = json.loads(self.metadata["state"])
        self._frontend = int(self.metadata["frontend_states"])
        self._reads_effort = self.metadata["effort"] == "true"
        self._names = [str(state["name"]) for state in states]
        self._first = [np.full(state["shape"], state["first"], np.float32) for state in states]

    def first_state(self, batch: int) -> State:
        """See `CausalNetwork`; so the next two methods."""
        return tuple(np.repeat(first[None], batch, axis=0) for first in self._first)

    def begin(self, windows: Float32, state: State) -> State:
        """Read the first groups, which change the states of the frontend, the first ones, alone."""
        groups = windows.shape[1] // self.grid.spectra
        shape = len(windows), groups, 5 + len(self.actors)
        _, after = self.advance(windows, np.zeros(shape, np.float32), state)
        return (*after[: self._frontend], *state[self._frontend :])

    def advance(self, windows: Float32, styles: Float32, state: State) -> tuple[NetworkRows, State]:
        """Read the next frames."""
        frames = []
        for k in range(styles.shape[1]):
            group = windows[:, k * self.grid.spectra : (k + 1) * self.grid.spectra]
            inputs = {"windows": np.ascontiguousarray(group), "emotion": styles[:, k]}
            found = self._session.run(None, inputs | dict(zip(self._names, state, strict=True)))
            frames.append(found[: len(NetworkRows._fields)])
            state = tuple(found[len(NetworkRows._fields) :])
        curves, neutral, *others = (np.stack(part, axis=1) for part in zip(*frames, strict=True))
        return NetworkRows(neutral, curves, *others), state

    def read(
        self,
        sound: Float32,
        weights: Float32,
        actor: str = "",
        progress: Callable[[float], None] = lambda share: None,
        gain: float = 1.0,
    ) -> Reading:
        """Curves of a whole recording; see `deitalk.models.protocol.CurveNetwork`."""
        grid, total = self.grid, len(weights)
        styles = styles_of(weights, self.actors, actor)[None]
        centres = np.arange((total + grid.delay) * grid.spectra) * SAMPLE_RATE / grid.rate
        starts = np.round(centres).astype(np.int64) - grid.length // 2
        after = max(int(starts[-1]) + grid.length - len(sound), 0)
        before = grid.length // 2
        padded = np.pad(sound * np.float32(gain), (before, after))
        rows = np.lib.stride_tricks.sliding_window_view(padded, grid.length)
        first = grid.delay * grid.spectra
        state = self.begin(rows[starts[:first] + before][None], self.first_state(1))
        parts = []
        for start in range(0, total, PROGRESS_FRAMES):
            stop = min(start + PROGRESS_FRAMES, total)
            places = starts[first + start * grid.spectra : first + stop * grid.spectra] + before
            found, state = self.advance(rows[places][None], styles[:, start:stop], state)
            parts.append([part[0] for part in found])
            progress(stop / total)
        neutral, curves, saliency, strength, effort = (
            np.concatenate(part) for part in zip(*parts, strict=True)
        )
        emotional = neutral if is_neutral(weights) else curves
        tracks = Tracks(saliency, strength, effort if self._reads_effort else None)
        return Reading(neutral, emotional, tracks)


# Networks of ONNX Runtime by the names of models.


EXPORT = """
import sys
from pathlib import Path
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.export import export_onnx
from rig.errors import UserError
folder, path, name = sys.argv[1:]
try:
    export_onnx(require_model(Path(folder), DEITalk), Path(path), name=name)
except UserError as error:
    sys.exit(str(error))
"""
"""Program of the process that exports a model."""


def load_onnx(
    model: str | Path, *, device: str = "cpu", threads: int = 1
) -> OnnxNetwork | OnnxCausalNetwork:
    """Return a network of ONNX Runtime: for whole recordings, or a causal one for those too.

    Parameters
    ----------
    model : str or Path
        An ``.onnx`` file; or a name or a folder as for `deitalk.models.checkpoint.load_model`,
        which is exported into the cache folder once, with torch.
    device : str
        ``cpu``.
    threads : int
        Processor threads.

    Raises
    ------
    CheckpointError
        If there is no such model, or it cannot be exported or read.
    DeitalkError
        If the device is another, or a package of the extra ``onnx`` is not installed.
    """
    if device != "cpu":
        raise DeitalkError(f"device {quoted(device)}: the backend onnx runs on cpu only")
    path = Path(model)
    if path.suffix != ".onnx":
        path = cached_export(model)
    file = OnnxFile(path, threads)
    return OnnxCausalNetwork(file) if file.is_causal else OnnxNetwork(file)


def cached_export(model: str | Path) -> Path:
    """File of a model in the cache folder, written if it is not there; errors as `load_onnx`.

    It is written by a process of its own, so that torch is not imported here.
    """
    path = cached_path(model)
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        command = [
            sys.executable,
            "-P",
            "-c",
            EXPORT,
            str(model_folder(model)),
            str(path),
            str(model),
        ]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = (done.stderr or "it was ended").strip().splitlines()
            raise CheckpointError(f"model {quoted(str(model))} is not exported: {lines[-1]}")
    return path


def cached_path(model: str | Path) -> Path:
    """Where `cached_export` keeps the file of a model.

    Another for other weights, settings, rules, or another form of the file.
    """
    folder = model_folder(model)
    digest = hashlib.sha256(f"{__version__} {SCHEMA} {CAUSAL_SCHEMA}".encode())
    digest.update(weights_hash(folder).encode() + (folder / "config.yaml").read_bytes())
    for path in sorted(Path(postprocess.__file__).parent.rglob("*.[cp][sy]*")):
        if path.suffix != ".pyc":  # a checkout whose rules change
            digest.update(path.read_bytes())
    return cache_folder() / f"model-{digest.hexdigest()[:20]}.onnx"
