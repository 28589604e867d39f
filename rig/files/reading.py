"""Safe reading of untrusted files: bytes, text, JSON and NPZ, each within its limits.

Every function refuses anything but a regular file before it opens it, so that a FIFO or a device
never blocks, and checks sizes before it allocates. Errors are one line; other packages pass their
own class of errors.
"""

import codecs
import csv
import json
import math
import os
import re
import stat
import sys
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from rig import limits
from rig.errors import FormatError, quoted, shorten

ErrorClass = Callable[[str], Exception]

_KINDS = (
    (stat.S_ISDIR, "is a folder"),
    (stat.S_ISFIFO, "is a named pipe"),
    (stat.S_ISSOCK, "is a socket"),
    (stat.S_ISCHR, "is a device"),
    (stat.S_ISBLK, "is a device"),
)
_ARRAY_KINDS = "biufU"


def rows_of(table: str | Path) -> list[dict[str, str]]:
    """Rows of a table of this package, such as ``conversion/raw.csv``, or of a path."""
    with (Path(__file__).parents[1] / table).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def check_file(
    path: Path, limit: int, *, error: ErrorClass = FormatError, may_be_empty: bool = False
) -> int:
    """Return the size of a regular file in bytes, without opening it.

    Parameters
    ----------
    path : Path
        The file; symbolic links are followed.
    limit : int
        Most bytes it may have.
    error : callable
        Makes the exception from its message.
    may_be_empty : bool
        Whether a file of no bytes is taken.

    Raises
    ------
    FormatError
        Or what `error` makes: if the file is absent, no regular file, empty or too large.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as problem:
        raise _unreadable(path, problem, error) from None
    if not stat.S_ISREG(status.st_mode):
        kind = next((word for test, word in _KINDS if test(status.st_mode)), "is something else")
        raise error(f"{path} {kind}, not a file")
    if status.st_size == 0 and not may_be_empty:
        raise error(f"{path} is empty")
    if status.st_size > limit:
        raise error(
            f"{path} has {_size(status.st_size)}; at most {_size(limit)} are read: cut it, or "
            "export less"
        )
    return status.st_size


def open_file(
    path: Path, limit: int, *, error: ErrorClass = FormatError, may_be_empty: bool = False
) -> BinaryIO:
    """Open a regular file for reading bytes; arguments and errors as `check_file`."""
    check_file(path, limit, error=error, may_be_empty=may_be_empty)
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        stream = os.fdopen(os.open(path, flags), "rb")
    except OSError as problem:
        raise _unreadable(path, problem, error) from None
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):  # exchanged since the check
        stream.close()
        raise error(f"{path} is no file any more")
    return stream


def read_bytes(
    path: Path, limit: int, *, error: ErrorClass = FormatError, may_be_empty: bool = False
) -> bytes:
    """Return the contents of a regular file; arguments and errors as `check_file`."""
    with open_file(path, limit, error=error, may_be_empty=may_be_empty) as stream:
        try:
            data = stream.read(limit + 1)
        except OSError as problem:
            raise _unreadable(path, problem, error) from None
    if len(data) > limit:
        raise error(f"{path} grew beyond {_size(limit)} while it was read")
    return data


def read_text(
    path: Path,
    limit: int,
    *,
    error: ErrorClass = FormatError,
    errors: str = "strict",
    may_be_empty: bool = False,
) -> str:
    """Return the text of a regular file: UTF-8 or UTF-16, with or without mark.

    Parameters
    ----------
    path, limit, error, may_be_empty
        As for `check_file`.
    errors : str
        "strict", or "replace" where names do not matter.

    Raises
    ------
    FormatError
        Or what `error` makes: as `check_file`, or if the bytes are no such text.
    """
    data = read_bytes(path, limit, error=error, may_be_empty=may_be_empty)
    return decode_text(data, path, error=error, errors=errors)


def decode_text(
    data: bytes,
    where: object,
    *,
    error: ErrorClass = FormatError,
    errors: str = "strict",
    is_whole: bool = True,
) -> str:
    """Return bytes as text, see `read_text`; `where` begins the message."""
    encoding = encoding_of(data)
    try:
        return codecs.getincrementaldecoder(encoding)(errors).decode(data, is_whole)
    except UnicodeDecodeError as problem:
        name = "UTF-8" if encoding == "utf-8-sig" else "UTF-16"
        if name == "UTF-8" and 0 in data:
            raise error(f"{where} is no text") from None
        raise error(
            f"{where} is no {name} text (byte {problem.start}: {problem.reason}); save it as UTF-8"
        ) from None


def encoding_of(data: bytes) -> str:
    """Encoding of a text by its mark, or by the zero bytes of UTF-16 without one."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    pairs = data[:200]
    if len(pairs) >= 4 and not data.startswith(b"\0\0"):
        if not any(pairs[1::2]) and all(pairs[::2]):
            return "utf-16-le"
        if not any(pairs[::2]) and all(pairs[1::2]):
            return "utf-16-be"
    return "utf-8-sig"


def load_json(data: bytes | str, where: object, *, error: ErrorClass = FormatError) -> Any:
    """Parse JSON with bounded nesting; NaN and Infinity, which JSON does not have, are errors.

    Parameters
    ----------
    data : bytes or str
        Bytes are UTF-8, or UTF-16 with mark.
    where : object
        Begins the message: a path.
    error : callable
        Makes the exception from its message.

    Raises
    ------
    FormatError
        Or what `error` makes: if it is no JSON, or nested deeper than `limits.NESTING`.

    Notes
    -----
    Numbers too large for a float become infinite, as Python reads them: check what must be finite.
    """
    if isinstance(data, bytes) and data.startswith((b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf")):
        data = decode_text(data, where, error=error)
    raw = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    if 0 in raw:
        raise error(f"{where} is no JSON: it is no text")
    depth = json_depth(raw)
    if depth > limits.NESTING:
        raise error(f"{where} nests {depth} levels; at most {limits.NESTING} are read")
    try:
        return json.loads(raw, parse_constant=_no_constant)
    except (ValueError, RecursionError) as problem:
        raise error(f"{where} is no JSON: {_reason(problem)}") from None


def json_depth(data: bytes) -> int:
    """Return the deepest nesting of lists and objects in JSON text.

    Only brackets outside strings count. Text that is no JSON gives some number.
    """
    if b"\\" in data:
        data = data.replace(b"\\\\", b"").replace(b'\\"', b"")
    marks = data.translate(None, _NO_BRACKETS)
    brackets = re.sub(b'"[^"]*"?', b"", marks)
    codes = np.frombuffer(brackets, np.uint8)
    steps = np.where((codes == ord("[")) | (codes == ord("{")), 1, -1).astype(np.int32)
    return int(np.cumsum(steps).max(initial=0))


_NO_BRACKETS = bytes(set(range(256)) - set(b'[]{}"'))


def read_json(path: Path, limit: int, *, error: ErrorClass = FormatError) -> Any:
    """Return the content of a JSON file; see `check_file` and `load_json`."""
    return load_json(read_bytes(path, limit, error=error), path, error=error)


def read_npz(
    path: Path, *, limit: int = limits.UNPACKED_BYTES, error: ErrorClass = FormatError
) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ archive, read-only; nothing is unpickled.

    Shapes and types are read from the arrays' headers and checked against the archive before any
    array is allocated.

    Parameters
    ----------
    path : Path
        The archive.
    limit : int
        Most bytes of the file, and of all its arrays together.
    error : callable
        Makes the exception from its message.

    Raises
    ------
    FormatError
        Or what `error` makes: as `check_file`; or if it is no archive of plain arrays, holds one
        name twice, is damaged, or expands to too much.
    """
    size = check_file(path, limit, error=error)
    try:
        with open_file(path, limit, error=error) as stream, zipfile.ZipFile(stream) as archive:
            entries = archive.infolist()
            names = [entry.filename for entry in entries]
            if len(names) > limits.ARRAYS:
                raise error(f"{path} holds {len(names)} arrays; at most {limits.ARRAYS} are read")
            for name, count in Counter(names).items():
                if count > 1:
                    raise error(f"{path} holds {quoted(name)} twice; save it again")
            total = sum(entry.file_size for entry in entries)
            if total > limit:
                raise error(f"{path} unpacks to {_size(total)}; at most {_size(limit)} are read")
            check_expansion(total, size, path, error=error)
            return {e.filename.removesuffix(".npy"): _array(archive, e) for e in entries}
    except Exception as problem:  # of any kind: numpy and zipfile parse hostile headers
        if type(problem) is error:
            raise
        raise error(f"{path} is no archive of numpy arrays: {_reason(problem)}") from None


def check_expansion(
    n_bytes: int,
    file_bytes: int,
    where: object,
    *,
    error: ErrorClass,
    floor: int = limits.EXPANDED_BYTES,
) -> None:
    """Raise an error if a file expands to far more than its size.

    Parameters
    ----------
    n_bytes : int
        Bytes of numbers it would make.
    file_bytes : int
        Bytes of the file.
    where : object
        Begins the message: a path.
    error : callable
        Makes the exception from its message.
    floor : int
        Bytes that are made of any file, however small.
    """
    if n_bytes > max(floor, limits.EXPANSION * file_bytes):
        raise error(
            f"{where} of {_size(file_bytes)} expands to {_size(n_bytes)}; at most "
            f"{_size(floor)}, or {limits.EXPANSION} times the file, are made"
        )


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    """One array of an archive, its header checked before it is allocated."""
    with archive.open(entry) as file:
        stream: Any = file
        shape, is_fortran, dtype = _header(stream, entry.filename)
        count = math.prod(shape)
        if dtype.kind not in _ARRAY_KINDS or not dtype.itemsize:
            raise ValueError(f"array {quoted(entry.filename)} holds {dtype}, not numbers or text")
        n_bytes = count * dtype.itemsize
        if min(shape, default=0) < 0 or count > limits.UNPACKED_BYTES:
            raise ValueError(f"array {quoted(entry.filename)} has shape {shape}")
        if stream.tell() + n_bytes != entry.file_size:
            raise ValueError(
                f"array {quoted(entry.filename)} is cut short, or longer than its header"
            )
        data = stream.read(n_bytes + 1)
        if len(data) != n_bytes:
            raise EOFError("an array is cut short, or longer than its header")
    if dtype.kind == "U" and (np.frombuffer(data, f"{dtype.byteorder}u4") > sys.maxunicode).any():
        raise ValueError(f"array {quoted(entry.filename)} holds what is no text")
    array = np.frombuffer(data, dtype).reshape(shape, order="F" if is_fortran else "C")
    return array


def _header(stream: Any, name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type of an array; those that Python 2 wrote (``3L``) are read silently."""
    version = np.lib.format.read_magic(stream)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read is None:
        raise ValueError(f"array {quoted(name)} has version {version}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return read(stream)


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not allowed; every value must be a finite number")


def _reason(problem: BaseException) -> str:
    """A library's message as one short line."""
    text = " ".join(shorten(str(problem), 500).split()) or type(problem).__name__
    return shorten(text, 160)


def _unreadable(path: Path, problem: Exception, error: ErrorClass) -> Exception:
    if isinstance(problem, FileNotFoundError):
        return error(f"{path} does not exist")
    reason = getattr(problem, "strerror", None) or _reason(problem)
    return error(f"cannot read {path}: {reason}")


def _size(n_bytes: int) -> str:
    for unit, name in ((limits.GIB, "GiB"), (limits.MIB, "MiB"), (limits.KIB, "KiB")):
        if n_bytes >= unit:
            return f"{n_bytes / unit:.4g} {name}"
    return f"{n_bytes} bytes"
