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
import math
import re
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import lru_cache
from importlib import resources
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Literal

from deitalk.config.hub import fetch, is_hub_name, pinned
from deitalk.errors import CheckpointError, ConfigError, DeitalkError
from rig import limits
from rig.errors import quoted
from rig.files.reading import check_file, load_json, open_file, read_json

if TYPE_CHECKING:
    from torch import Tensor, nn

# Weight files: length of the header (8 bytes), then JSON of each tensor's type, shape and place.

Shapes = dict[str, tuple[int, ...]]

_RANDOM = ("normal_", "uniform_", "kaiming_normal_", "kaiming_uniform_")
"""Functions that fill a tensor with random numbers."""

_ITEM_BYTES = {
    "F64": 8, "F32": 4, "F16": 2, "BF16": 2, "I64": 8, "I32": 4, "I16": 2, "I8": 1, "U8": 1,
    "BOOL": 1,
}  # fmt: skip


def read_shapes(path: Path) -> Shapes:
    """Return the shapes of all tensors of a safetensors file, from its header alone.

    Raises
    ------
    CheckpointError
        If the file is absent or too large, or its header is damaged or does not fit its size.
    """
    size = check_file(path, limits.WEIGHTS_BYTES, error=CheckpointError)
    with open_file(path, limits.WEIGHTS_BYTES, error=CheckpointError) as stream:
        length = int.from_bytes(stream.read(8), "little")
        if size < 8 or not 2 <= length <= min(size - 8, limits.HEADER_BYTES):
            raise _damaged(path, f"a header of {length} bytes in a file of {size}")
        header = load_json(stream.read(length), f"{path}, its header,", error=CheckpointError)
    if not isinstance(header, dict) or len(header) > limits.TENSORS:
        raise _damaged(path, "its header lists no tensors, or too many")
    header.pop("__metadata__", None)
    try:
        return {name: _shape(entry, size - 8 - length) for name, entry in header.items()}
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise _damaged(path, f"its header does not fit its size: {quoted(error)}") from None


def _shape(entry: Any, n_bytes: int) -> tuple[int, ...]:
    """Shape of one tensor, if it fits its place in the file."""
    shape = tuple(entry["shape"])
    begin, end = entry["data_offsets"]
    if not all(type(n) is int and n >= 0 for n in (*shape, begin, end)):
        raise ValueError("sizes and offsets must be whole numbers")
    count = math.prod(shape)
    if count * _ITEM_BYTES[entry["dtype"]] != end - begin or not begin <= end <= n_bytes:
        raise ValueError("offsets and shape differ")
    return shape


def read_weights(path: Path) -> "dict[str, Tensor]":
    """Return every tensor of a safetensors file, all of them finite.

    Raises
    ------
    CheckpointError
        As `read_shapes`; or if a value is not finite.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    read_shapes(path)
    try:
        weights: dict[str, Tensor] = load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise _damaged(path, " ".join(str(error).split())) from None
    spoilt = [name for name, value in weights.items() if not _is_finite(value)]
    if spoilt:
        raise CheckpointError(
            f"{path}: {quoted(spoilt[0])} is not finite; train again or copy it again"
        )
    return weights


def _is_finite(value: "Tensor") -> bool:
    # `isfinite` of every number takes six times as long; the maximum is NaN if one is.
    return (
        not value.is_floating_point()
        or not len(value.ravel())
        or bool(value.abs().max().isfinite())
    )


def network_shapes(make: "Callable[[], nn.Module]") -> Shapes:
    """Return the shapes of a network's state without allocating it.

    Parameters
    ----------
    make : callable
        Builds the network; it is built on torch's "meta" device, which holds no numbers.

    Raises
    ------
    ConfigError
        If it has more than `limits.PARAMETERS` numbers, or cannot be built.
    """
    import torch

    try:
        with torch.device("meta"), without_random_numbers():
            state = make().state_dict()
    except (ValueError, TypeError, RuntimeError, AssertionError) as error:
        if isinstance(error, DeitalkError):
            raise
        raise ConfigError(
            f"configuration: no network can be built of it ({quoted(error, 120)})"
        ) from None
    shapes = {name: tuple(value.shape) for name, value in state.items()}
    total = sum(math.prod(shape) for shape in shapes.values())
    if total > limits.PARAMETERS:
        raise ConfigError(
            f"configuration: a network of {total / 1e6:,.0f} million numbers; at most "
            f"{limits.PARAMETERS / 1e6:,.0f} million are built: make layers narrower"
        )
    return shapes


def check_fit(path: Path, stored: Mapping[str, tuple[int, ...]], wanted: Shapes) -> None:
    """Refuse weights of another network than the configuration beside them describes.

    Raises
    ------
    CheckpointError
        Naming the first tensor that is missing, unknown or of another shape.
    """
    names = [*wanted, *(name for name in stored if name not in wanted)]
    for name in names:
        if stored.get(name) != wanted.get(name):
            raise CheckpointError(
                f"{path}: weights do not fit {path.parent / 'config.yaml'} "
                f"({quoted(name)} is {_text(stored.get(name))}, not {_text(wanted.get(name))}); "
                "both must be of one model"
            )


def _text(shape: tuple[int, ...] | None) -> str:
    return "absent" if shape is None else quoted(shape)


def _damaged(path: Path, reason: str) -> CheckpointError:
    return CheckpointError(f"{path}: no safetensors file ({reason}); copy it again")


def without_random_numbers() -> AbstractContextManager[Any]:
    """Leave initial values out of networks that are built within, because their weights follow.

    On the meta device they would import the compiler, which takes two seconds.
    """
    from torch.overrides import TorchFunctionMode

    class Without(TorchFunctionMode):
        def __torch_function__(
            self, func: Any, types: Any, args: Any = (), kwargs: Any = None
        ) -> Any:
            if getattr(func, "__name__", "") in _RANDOM:
                return args[0] if args else kwargs["tensor"]
            return func(*args, **(kwargs or {}))

    return Without()


_NAME = re.compile(r"cpu|cuda(:\d{1,3})?|mps")


def check_device(name: str) -> str:
    """Return a device's name if it is one; imports no torch.

    Parameters
    ----------
    name : str
        ``cpu``, ``cuda`` (the first GPU), ``cuda:N`` (GPU number N, from 0) or ``mps`` (Apple).

    Raises
    ------
    DeitalkError
        If it is another name.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise DeitalkError(f"device {name!r} is unknown; use cpu, cuda, cuda:N (a number) or mps")
    return name


def require_device(name: str) -> str:
    """Return a device's name if this machine has it.

    Raises
    ------
    DeitalkError
        If the name is unknown (see `check_device`) or there is no such device.
    """
    import torch

    kind, _, number = check_device(name).partition(":")
    if kind == "cuda" and not int(number or 0) < torch.cuda.device_count():
        count = torch.cuda.device_count()
        raise DeitalkError(
            f"device {name!r}: torch finds {count or 'no'} CUDA device{'s' * (count != 1)} here; "
            f"use cpu{f' or cuda:0 to cuda:{count - 1}' if count else ''}"
        )
    if kind == "mps" and not torch.backends.mps.is_available():
        raise DeitalkError(f"device {name!r}: this machine has no Metal device; use cpu")
    return name


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
