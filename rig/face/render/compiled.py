"""Machine code of ``kernels.bc``, the loops of `rig.face.render.kernels`, by LLVM."""

from ctypes import CFUNCTYPE, c_int, c_int64, c_void_p, create_string_buffer
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

FILE = Path(__file__).with_name("kernels.bc")
TILE = 8
"""Side of a tile, samples."""
THRESHOLDS = (40, 168, 216, 96)
"""Least alpha of the four samples of a pixel, of 255."""
EMPTY = 0x7F800000FFFFFFFF
"""Sample that shows no face, at depth infinity."""
PLACES, ROWS = 512, 32
"""Most places whose light is worked out together, a power of two, and numbers of each."""
KERNELS = {
    "normals": "f42 u42 u41 f42",
    "nearest": "f42 u42 u42 i81 i81 u41 f42 i82",
    "draw": "f42 f42 f41 f42 f41 f42 u42 u42 i81 i81 u41 f42 i82 u11 i41 f43 u13 u13 u13 f41 f42 f41 "
    "u41 u41 u13",
}
"""Type and dimensions of the arrays that each takes, n of a number."""
MOST_ALPHA = max(THRESHOLDS)
DIGEST = 32
"""Bytes of the hash of the source, with which the file begins."""
_ROOM = create_string_buffer(64)
"""For what numba's functions return."""


@lru_cache(maxsize=1)
def _engine() -> tuple[Any, dict[str, Any]]:
    """The machine code, which must be kept, and each kernel as a function of C."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), jit=True
    )
    module = llvm.parse_bitcode(FILE.read_bytes()[DIGEST:])
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    functions = {}
    for name, kinds in KERNELS.items():
        # Numba's convention: room for result and error, then of each array its owner and parent,
        # counts of items and of bytes of each, place, lengths and strides.
        words: list[Any] = [c_void_p, c_void_p]
        for kind in kinds.split():
            sizes = [c_int64] * int(kind[2:] or 0)
            words += [c_void_p] * 2 + [c_int64] * 2 + [c_void_p] + 2 * sizes if sizes else [c_int64]
        functions[name] = CFUNCTYPE(c_int, *words)(engine.get_function_address(name))
    return engine, functions


def run(name: str, *arguments: Any) -> None:
    """Run a kernel of `KERNELS` on arrays, which are contiguous, and numbers."""
    words: list[Any] = [_ROOM, _ROOM]
    for kind, value in zip(KERNELS[name].split(), arguments, strict=True):
        if isinstance(value, np.ndarray):
            is_fit = value.dtype == kind[:2] and value.ndim == int(kind[2])
            assert is_fit and value.flags.c_contiguous, (name, kind, value.dtype, value.shape)
            words += [None, None, value.size, value.itemsize, value.ctypes.data]
            words += [*value.shape, *value.strides]
        else:
            words.append(value)
    _engine()[1][name](*words)
