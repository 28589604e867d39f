"""Weight files in safetensors, checked before they are read, and the shapes a network needs.

A file is the length of its header (8 bytes), then JSON of each tensor's type, shape and place.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deitalk.errors import CheckpointError, ConfigError, DeitalkError
from rig import limits
from rig.errors import quoted
from rig.files.reading import check_file, load_json, open_file

if TYPE_CHECKING:
    from torch import Tensor, nn

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
