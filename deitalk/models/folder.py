"""Model folders without their weights: where they are and what ``model.json`` holds; no torch.

::

    config.yaml          network and rules
    model.safetensors    weights, float16 in shipped models
    encoder.safetensors  those of a pretrained encoder that did not learn, where there is one
    effort.safetensors   readout of the voice's strength from its features, where there is one
    lips.safetensors     readout of the lips from its features, where there is one
    model.json           format version, control set or speakers, training summary; with
                         "encoder_of", the embedded model whose encoder.safetensors it uses
    graph.gz             graph for ONNX Runtime, where it was written: a line with a `GraphHeader`
                         of `deitalk.models.onnx.network` as JSON, then the ONNX file
    controls.yaml        the rig, where it is not the board: see `deitalk.config.rig_file`
    templates.npz        mesh models only: see `deitalk.models.mesh_model`
"""

import hashlib
from functools import lru_cache
from importlib import resources
from pathlib import Path, PurePath
from typing import Any, Literal

from deitalk.config.hub import fetch, is_hub_name, pinned
from deitalk.errors import CheckpointError
from rig import limits
from rig.errors import quoted
from rig.files.reading import check_file, open_file, read_json

FORMAT_VERSION = 1
GRAPH = "graph.gz"
RIG_FILE = "controls.yaml"
ENCODER = "encoder.safetensors"
EFFORT_WEIGHTS, LIP_WEIGHTS = "intensity.effort.", "lips."
READOUTS = {"effort.safetensors": EFFORT_WEIGHTS, "lips.safetensors": LIP_WEIGHTS}
"""Files of readouts of the features, and what the names of their weights begin with."""
WEIGHT_FILES = ("model.safetensors", ENCODER, *READOUTS)
EMBEDDED = ("default", "mel", "live", "small", "sdfa", "mesh_head")
"""Models that come with the package; `embedded_models` lists those that are there."""


def embedded_models() -> list[str]:
    """Names of the models inside the package."""
    folder = resources.files("deitalk.models").joinpath("weights")
    return [name for name in EMBEDDED if folder.joinpath(name, "model.safetensors").is_file()]


def model_folder(name_or_path: str | Path) -> Path:
    """Folder of an embedded model, of one on disk, else of one on the hub (`deitalk.config.load`).

    Raises
    ------
    CheckpointError
        If there is none; it lists the embedded ones.
    """
    if str(name_or_path) in EMBEDDED:
        folder = Path(str(resources.files("deitalk.models").joinpath("weights", str(name_or_path))))
    elif is_hub_name(name_or_path):
        return fetch(PurePath(name_or_path).as_posix())
    else:
        folder = Path(name_or_path)
    if not (folder / "model.safetensors").is_file() or not (folder / "config.yaml").is_file():
        if (folder / "best" / "model.safetensors").is_file():
            raise CheckpointError(f"{folder} is a run; its model is {folder / 'best'}")
        raise CheckpointError(
            f"{name_or_path}: no model there (config.yaml and model.safetensors); name a folder, "
            f"org/name on the hub, or one of {', '.join(embedded_models()) or 'no embedded models'}"
        )
    return folder


def is_causal(name_or_path: str | Path) -> bool:
    """Whether a model is for voices that have not ended (`deitalk.live`)."""
    from deitalk.config.load import load_model_config

    config = load_model_config(model_folder(name_or_path))
    return config.model.frontend.kind == "causal_whisper"


def read_about(folder: Path) -> dict[str, Any]:
    """Content of a folder's ``model.json``.

    Raises
    ------
    CheckpointError
        If it is missing, damaged or of another format version.
    """
    path = folder / "model.json"
    try:
        about = read_json(path, limits.MODEL_JSON_BYTES, error=CheckpointError)
        version, _, _ = about["format_version"], about["control_set"], about["controls"]
    except (CheckpointError, KeyError, TypeError):
        raise CheckpointError(f"{path}: missing or damaged; save the model again") from None
    if version != FORMAT_VERSION:
        raise CheckpointError(
            f"{path}: format version {quoted(version)}, this deitalk reads {FORMAT_VERSION}; "
            "use the deitalk that wrote it, or train again"
        )
    return dict(about)


def product_of(name_or_path: str | Path) -> Literal["curves", "mesh"]:
    """Whether a model's output is control curves or a moving mesh, from ``model.json``."""
    is_mesh = read_about(model_folder(name_or_path)).get("kind") == "sdfa"
    return "mesh" if is_mesh else "curves"


def describe_model(name_or_path: str | Path) -> dict[str, Any]:
    """Content of ``model.json`` but for the control names; rules, hash and size of the weights."""
    from deitalk.config.rules import read_rules

    folder = model_folder(name_or_path)
    about = read_about(folder)
    about.pop("controls", None)
    if (rules := read_rules(folder / "config.yaml")) is not None:
        about["rules"] = rules.model_dump(mode="json")
    return {"name": pinned(name_or_path), **about, **_weights(folder)}


def weight_files(folder: Path) -> list[Path]:
    """The files of a model's weights that are there; the last may be another model's encoder.

    Raises
    ------
    CheckpointError
        If ``model.json`` is damaged, or names an encoder of no embedded model.
    """
    found = [path for name in WEIGHT_FILES if (path := folder / name).is_file()]
    owner = read_about(folder).get("encoder_of")
    if owner is None:
        return found
    if owner not in EMBEDDED:
        raise CheckpointError(
            f"{folder / 'model.json'}: encoder_of {quoted(owner)} is no embedded model; use one of "
            f"{', '.join(EMBEDDED)}"
        )
    return [*found, model_folder(owner) / ENCODER]


def weights_hash(folder: Path) -> str:
    """SHA-256 of a folder's weights, in hexadecimal; of two files, of their hashes in turn.

    `READOUTS`, which the network and what decodes its features do not need, are left out.
    """
    return str(_weights(folder)["sha256"])


def _weights(folder: Path) -> dict[str, int | str]:
    """Size and hash of all weights of a folder."""
    parts = [_size_and_hash(path) for path in weight_files(folder) if path.name not in READOUTS]
    if len(parts) == 1:
        return parts[0]
    hashes = "".join(str(part["sha256"]) for part in parts)
    total = sum(int(part["bytes"]) for part in parts)
    return {"bytes": total, "sha256": hashlib.sha256(hashes.encode()).hexdigest()}


def _size_and_hash(path: Path) -> dict[str, int | str]:
    size = check_file(path, limits.WEIGHTS_BYTES, error=CheckpointError)
    found = path.stat()
    return {"bytes": size, "sha256": _hash(path, (found.st_ino, found.st_mtime_ns, size))}


@lru_cache(maxsize=64)
def _hash(path: Path, _state: tuple[int, ...]) -> str:
    """Hash of a file, once for each state of it."""
    digest = hashlib.sha256()
    with open_file(path, limits.WEIGHTS_BYTES, error=CheckpointError) as stream:
        while part := stream.read(limits.MIB):
            digest.update(part)
    return digest.hexdigest()
