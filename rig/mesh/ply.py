"""Stanford PLY, ASCII and binary, and folders of them as sequences (the VOCASET layout).

Counts of the header are checked against the file's size. Letters: N rows of an element.
"""

from array import array
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Int64
from rig.errors import FormatError, MeshError, quoted
from rig.files import atomic_write, output_folder
from rig.files.reading import check_file, open_file
from rig.limits import HEADER_BYTES, MESH_BYTES, TRIANGLES, VERTICES
from rig.mesh.trimesh import TriMesh

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_LINES = 1000
CUT_SHORT = "the file is cut short"


@dataclass(frozen=True)
class Property:
    """One property of an element; `length_type` is given where it is a list."""

    name: str
    type: str
    length_type: str | None = None


@dataclass(frozen=True)
class Element:
    """Rows of equal properties."""

    name: str
    count: int
    properties: list[Property]


@dataclass(frozen=True)
class Lists:
    """Lists of a property.

    Parameters
    ----------
    lengths : array of int64 [shape=(N,)]
    values : array [shape=(sum of lengths,)]
        One list after the other.
    """

    lengths: Int64
    values: NDArray[np.generic]


Columns = dict[str, "NDArray[Any] | Lists"]


def read_header(file: BinaryIO) -> tuple[str, list[Element]]:
    """Return the byte order ("" is ASCII) and the elements; ValueError or KeyError if none."""
    order, elements = None, []
    for words in _header_lines(file):
        match words:
            case ["format", name, _]:
                order = _ORDERS[name]
            case ["element", name, count]:
                if not 0 <= int(count) <= VERTICES:
                    raise ValueError(f"{count} rows of an element; at most {VERTICES} are read")
                elements.append(Element(name, int(count), []))
            case ["property", "list", length, kind, name]:
                if _TYPES[length][0] == "f":
                    raise ValueError(f"list {quoted(name)} has a length that is no whole number")
                elements[-1].properties.append(Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name]:
                elements[-1].properties.append(Property(name, _TYPES[kind]))
    if order is None:
        raise ValueError("no 'format' line")
    named = {e.name: [p.name for p in e.properties] for e in elements}
    if wrong := [name for name, own in named.items() if not own or len(set(own)) < len(own)]:
        raise ValueError(f"element {quoted(wrong[0])} has no properties, or one name twice")
    return order, elements


def _header_lines(file: BinaryIO) -> list[list[str]]:
    """Words of the lines between 'ply' and 'end_header'."""
    lines: list[list[str]] = []
    while len(lines) < _MOST_LINES and (raw := file.readline(HEADER_BYTES)):
        lines.append(raw.decode("ascii").split())
        if lines[-1] == ["end_header"]:
            break
    if not lines or lines[0] != ["ply"] or lines[-1] != ["end_header"]:
        raise ValueError("no 'ply' ... 'end_header'")
    return lines[1:-1]


def read_element(file: BinaryIO, element: Element, order: str, left: int) -> Columns:
    """Read the rows of one element.

    Parameters
    ----------
    file : binary stream
        At the first row.
    element : Element
        Its name, count and properties.
    order : str
        "<", ">", or "" for ASCII.
    left : int
        Bytes between here and the file's end.

    Returns
    -------
    dict
        By property, an array [shape=(N,)] or `Lists`.

    Raises
    ------
    ValueError
        If the file is cut short or a row cannot be read.
    """
    least = 2 * len(element.properties)  # bytes of a row in ASCII: a digit and a space each
    if order:
        least = sum(np.dtype(p.length_type or p.type).itemsize for p in element.properties)
    if element.count * least > left + 1:  # the last line may have no end
        raise ValueError(CUT_SHORT)
    if order and element.count:
        columns = _equal_rows(file, element, order, left)
        return columns or _row_by_row(file, element, order, left)
    if element.count and not any(p.length_type for p in element.properties):
        places = range(len(element.properties))
        lines = islice(file, element.count)
        table = np.loadtxt(lines, usecols=places, comments=None, ndmin=2)
        if len(table) < element.count:
            raise ValueError(CUT_SHORT)
        return {p.name: table[:, i] for i, p in enumerate(element.properties)}
    return _row_by_row(file, element, order, left)


def _equal_rows(file: BinaryIO, element: Element, order: str, left: int) -> Columns | None:
    """Read all rows at once if every list has the length of the first row's; else None."""
    begin = file.tell()
    first = _row_by_row(file, replace(element, count=1), order, left)
    file.seek(begin)
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    for i, p in enumerate(element.properties):
        one = first[p.name]
        if isinstance(one, Lists):
            fields.append((f"length{i}", order + str(p.length_type), ()))
        fields.append(
            (f"value{i}", order + p.type, one.values.shape if isinstance(one, Lists) else ())
        )
    kind = np.dtype(fields)
    if kind.itemsize * element.count > left:
        return None
    rows = np.frombuffer(_exactly(file, kind.itemsize * element.count), kind)
    columns: Columns = {}
    for i, p in enumerate(element.properties):
        values = rows[f"value{i}"]
        if p.length_type is None:
            columns[p.name] = values
            continue
        lengths = rows[f"length{i}"].astype(np.int64)
        if (lengths != values.shape[1]).any():
            file.seek(begin)
            return None
        columns[p.name] = Lists(lengths, values.ravel())
    return columns


def _exactly(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) != size:
        raise ValueError(CUT_SHORT)
    return data


def _row_by_row(file: BinaryIO, element: Element, order: str, left: int) -> Columns:
    """Read rows one by one: words of a line each, or bytes."""
    words: list[bytes] = []

    def take(kind: str, count: int) -> Any:
        dtype = np.dtype(order + kind)
        if count < 0:
            raise ValueError(f"a list of {count} values")
        if order == "":
            taken = words[:count]
            del words[:count]
            values: Any = [float(word) if kind[0] == "f" else int(word) for word in taken]
        elif dtype.itemsize * count > left:  # before so much memory is taken
            raise ValueError(CUT_SHORT)
        else:
            values = np.frombuffer(_exactly(file, dtype.itemsize * count), dtype)
        if len(values) < count:
            raise ValueError(CUT_SHORT)
        return values

    numbers = {p.name: array("d" if p.type[0] == "f" else "q") for p in element.properties}
    lengths = {p.name: array("q") for p in element.properties if p.length_type}
    for _ in range(element.count):
        words[:] = [] if order else file.readline().split()
        for p in element.properties:
            count = 1
            if p.length_type:
                count = int(take(p.length_type, 1)[0])
                lengths[p.name].append(count)
            numbers[p.name].extend(take(p.type, count))
    columns: Columns = {name: np.array(values) for name, values in numbers.items()}
    return columns | {
        name: Lists(np.array(own), np.array(numbers[name])) for name, own in lengths.items()
    }


def read_ply(path: Path | str) -> TriMesh:
    """Read one PLY file; polygons become fans from their first corner.

    Raises
    ------
    FormatError
        If the header is wrong, the file is cut short, or it has no vertices or faces.
    """
    path = Path(path)
    size = check_file(path, MESH_BYTES)
    vertices: NDArray[Any] | None = None
    polygons: NDArray[Any] | Lists = Lists(np.zeros(0, np.int64), np.zeros(0, np.int64))
    with open_file(path, MESH_BYTES) as file:
        try:
            order, elements = read_header(file)
            for element in elements:
                columns = read_element(file, element, order, size - file.tell())
                if element.name == "vertex":
                    points = [columns[axis] for axis in "xyz"]
                    if any(isinstance(column, Lists) for column in points):
                        raise ValueError("x, y and z must be numbers, not lists")
                    vertices = np.stack(points, axis=1)  # type: ignore[arg-type]
                elif element.name == "face":
                    key = "vertex_indices" if "vertex_indices" in columns else "vertex_index"
                    polygons = columns[key]
        except (LookupError, ValueError, TypeError, OverflowError) as error:
            raise FormatError(f"{path.name} is not a readable PLY file: {error}") from None
    if vertices is None:
        raise FormatError(f"{path.name} has no 'vertex' element")
    if not isinstance(polygons, Lists) or polygons.values.dtype.kind not in "iu":
        raise FormatError(f"{path.name}: corners of faces must be lists of whole numbers")
    # Triangles [shape=(N, 3)] of polygons: fans from their first corners.
    counts = np.maximum(polygons.lengths - 2, 0)
    if counts.sum() > TRIANGLES:
        raise MeshError(f"{counts.sum()} triangles; at most {TRIANGLES} are read: decimate it")
    starts = np.cumsum(polygons.lengths) - polygons.lengths
    first = np.repeat(starts, counts)
    within = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    places = np.stack([first, first + within + 1, first + within + 2], axis=1)
    triangles: Int64 = polygons.values.astype(np.int64)[places]
    return TriMesh(vertices, triangles)


def write_ply(path: Path | str, mesh: TriMesh, *, ascii: bool = False) -> None:
    """Write one PLY file: float64 positions, int32 triangles, little-endian unless `ascii`."""
    header = (
        f"ply\nformat {'ascii' if ascii else 'binary_little_endian'} 1.0\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode("ascii")
    if ascii:
        lines = [f"{x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
        lines += [f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()]
        body = ("\n".join(lines) + "\n").encode("ascii")
    else:
        rows = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        rows["count"], rows["corners"] = 3, mesh.faces
        body = mesh.vertices.astype("<f8").tobytes() + rows.tobytes()
    with atomic_write(path) as beside:
        beside.write_bytes(header + body)


def write_ply_sequence(folder: Path | str, mesh: TriMesh, vertices: Any) -> None:
    """Write frames [shape=(T, V, 3)] as `frame.00000.ply` ... into a folder.

    Raises
    ------
    TargetError
        If the folder holds anything but frames that were written so before.
    """
    with output_folder(folder, kind="frames", force=True) as beside:
        for i, frame in enumerate(np.asarray(vertices)):
            write_ply(beside / f"frame.{i:05d}.ply", mesh.with_vertices(frame))
