"""Networks of ONNX Runtime by the names of models."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

from deitalk.errors import CheckpointError, DeitalkError
from deitalk.installed import __version__
from deitalk.models.folder import model_folder, weights_hash
from deitalk.models.onnx.network import OnnxCausalNetwork, OnnxFile, OnnxNetwork
from rig.errors import quoted
from rig.files import cache_folder

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
        command = [sys.executable, "-c", EXPORT, str(model_folder(model)), str(path), str(model)]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = (done.stderr or "it was ended").strip().splitlines()
            raise CheckpointError(f"model {quoted(str(model))} is not exported: {lines[-1]}")
    return path


def cached_path(model: str | Path) -> Path:
    """Where `cached_export` keeps the file of a model; another for other weights or settings."""
    folder = model_folder(model)
    settings = (folder / "config.yaml").read_bytes()
    key = hashlib.sha256(f"{__version__} {weights_hash(folder)}".encode() + settings).hexdigest()
    return cache_folder() / f"model-{key[:20]}.onnx"
