"""Machine code of ``*.bc``, the loops of `tools.kernels`, by LLVM."""

from ctypes import CFUNCTYPE, c_int, c_int64, c_void_p, create_string_buffer
from functools import lru_cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

TILE = 8
"""Side of a tile, samples."""
THRESHOLDS = (40, 168, 216, 96)
"""Least alpha of the four samples of a pixel, of 255."""
EMPTY = 0x7F800000FFFFFFFF
"""Sample that shows no face, at depth infinity."""
PLACES, ROWS = 512, 33
"""Most places whose light is worked out together, a power of two, and numbers of each."""
KERNELS = {
    "normals": "f42 u42 u41 f42",
    "nearest": "f42 u42 u42 i81 i81 u41 f42 i82",
    "draw": "f42 f42 f41 f42 f41 f42 u42 u42 i81 i81 u41 f42 i82 u11 i41 f42 u42 u42 u42 f41 f43 "
    "f41 u41 u41 u13",
}
"""Type and dimensions of the arrays that each takes."""
MOST_ALPHA = max(THRESHOLDS)
DIGEST = 32
"""Bytes of the hash of the source, with which each file begins."""
_ROOM = create_string_buffer(64)
"""For what numba's functions return."""


def file_of(name: str) -> Path:
    """File of a kernel's bitcode, after the hash of its source."""
    return Path(__file__).with_name(f"{name}.bc")


@lru_cache
def _function(name: str, level: int) -> tuple[Any, Any]:
    """A kernel as a function of C, and its machine code, which must be kept.

    LLVM's level 0 takes a fifth of the time of level 2, and its code 1.4 times as long.
    """
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(),
        opt=level, jit=True,
    )  # fmt: skip
    module = llvm.parse_bitcode(file_of(name).read_bytes()[DIGEST:])
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    # Numba's convention: room for result and error, then of each array its owner and parent,
    # counts of items and of bytes of each, place, lengths and strides.
    words: list[Any] = [c_void_p, c_void_p]
    for kind in KERNELS[name].split():
        words += [c_void_p] * 2 + [c_int64] * 2 + [c_void_p] + [c_int64] * (2 * int(kind[2]))
    return CFUNCTYPE(c_int, *words)(engine.get_function_address(name)), engine


def run(name: str, *arguments: NDArray[Any], often: bool = False) -> None:
    """Run a kernel of `KERNELS` on its arrays, which are contiguous; `often`: by faster code."""
    words: list[Any] = [_ROOM, _ROOM]
    for kind, value in zip(KERNELS[name].split(), arguments, strict=True):
        is_fit = value.dtype == kind[:2] and value.ndim == int(kind[2])
        assert is_fit and value.flags.c_contiguous, (name, kind, value.dtype, value.shape)
        words += [None, None, value.size, value.itemsize, value.ctypes.data]
        words += [*value.shape, *value.strides]
    _function(name, 2 if often else 0)[0](*words)
