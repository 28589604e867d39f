"""Networks of ONNX Runtime by the names of models, whose graphs are written where they lack."""

import hashlib
import json
import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

from deitalk.errors import CheckpointError, DeitalkError
from deitalk.models.folder import (
    GRAPH,
    RIG_FILE,
    model_folder,
    read_about,
    weight_files,
    weights_hash,
)
from deitalk.models.onnx.causal_network import OnnxCausalNetwork
from deitalk.models.onnx.network import CAUSAL_SCHEMA, SCHEMA, OnnxFile, OnnxNetwork, read_graph
from rig.errors import quoted
from rig.files import cache_folder

KEPT_NETWORKS = 2
"""Networks that `load_onnx` keeps."""
WRITE = """
import sys
from pathlib import Path
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.engine_graph import write_graph
from rig.errors import UserError
folder, path = map(Path, sys.argv[1:])
try:
    write_graph(require_model(folder, DEITalk), folder, path)
except UserError as error:
    sys.exit(str(error))
"""
"""Program of the process that writes the graph of a model."""
TRACED = (
    "audio/log_mel.py", "emotions/*.py", "frontends/*.py", "models/causal_model.py",
    "models/curve_model.py", "models/positions.py", "models/intensity.py",
    "models/lip_readout.py", "models/rig_decoder.py", "models/temporal_conv.py",
    "models/tuned_parts.py", "models/onnx/*.py",
    "postprocess/*.py", "postprocess/*.csv", "postprocess/life/*.py", "../rig/emotions.py",
)  # fmt: skip
"""Files of the package that make a graph what it is."""


def load_onnx(
    model: str | Path, *, device: str = "cpu", threads: int = 1, once: bool = False
) -> OnnxNetwork | OnnxCausalNetwork:
    """Return a network of ONNX Runtime: for whole recordings, or a causal one for those too.

    The last `KEPT_NETWORKS` are kept and returned again, if no file of their folders has changed;
    threads may share them.

    Parameters
    ----------
    model : str or Path
        As for `deitalk.models.checkpoint.load_model`. Its graph is that of the folder, else it is
        written into the cache folder once, with torch.
    device : str
        ``cpu``.
    threads : int
        Processor threads.
    once : bool
        As for `deitalk.models.load.load_network`.

    Raises
    ------
    CheckpointError
        If there is no such model, or it has no graph.
    DeitalkError
        If the device is another, or a package is not installed.
    """
    if device != "cpu":
        raise DeitalkError(f"device {quoted(device)}: the backend onnx runs on cpu only")
    if str(model).endswith(".onnx"):
        raise CheckpointError(
            f"{quoted(str(model))} is for other programs; name the model or its folder"
        )
    folder = model_folder(model)
    files = sorted({*folder.iterdir(), *weight_files(folder)})
    stats = [(path.stat().st_mtime_ns, path.stat().st_size, path.stat().st_ino) for path in files]
    return _read(folder, str(model), threads, once, (os.getpid(), *files, *stats))


@lru_cache(maxsize=KEPT_NETWORKS)
def _read(
    folder: Path, name: str, threads: int, once: bool, version: tuple[Any, ...]
) -> OnnxNetwork | OnnxCausalNetwork:
    """`load_onnx` from a version of the folder's files, in this process: forks share no threads."""
    path = ready_graph(folder) or cached_graph(folder, name)
    file = OnnxFile(path, folder, threads, once=once)
    return OnnxCausalNetwork(file) if file.is_causal else OnnxNetwork(file)


def ready_graph(folder: Path) -> Path | None:
    """File with the graph of a model, if it was written and is not of other rules or settings."""
    beside = folder / GRAPH
    if beside.is_file() and read_graph(beside)[0].digest == graph_digest(folder):
        return beside
    path = cached_path(folder)
    return path if path.is_file() else None


def cached_graph(folder: Path, name: str = "") -> Path:
    """Graph of a model in the cache folder, written if it is not there; errors as `load_onnx`.

    It is written by a process of its own, so that torch is not imported here.
    """
    path = cached_path(folder)
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-P", "-c", WRITE, str(folder), str(path)]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = (done.stderr or "it was ended").strip().splitlines()
            raise CheckpointError(f"model {quoted(name or str(folder))} has no graph: {lines[-1]}")
    return path


def cached_path(folder: Path) -> Path:
    """Where `cached_graph` keeps the graph of a model folder; another for other weights."""
    digest = hashlib.sha256(f"{graph_digest(folder)} {weights_hash(folder)}".encode())
    return cache_folder() / f"graph-{digest.hexdigest()[:20]}.gz"


def graph_digest(folder: Path) -> str:
    """Digest of what the graph of a model folder depends on but its weights' values."""
    digest = hashlib.sha256(f"{SCHEMA} {CAUSAL_SCHEMA}".encode())
    about = read_about(folder)
    digest.update(json.dumps([about["control_set"], about["controls"]]).encode())
    for name in ("config.yaml", RIG_FILE):
        if (folder / name).is_file():
            digest.update((folder / name).read_bytes())
    package = Path(__file__).parents[2]
    for pattern in TRACED:  # a checkout whose rules change
        for path in sorted(package.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:20]
