"""Stanford PLY, ASCII and binary, and folders of them as sequences (the VOCASET layout)."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from rig.errors import FormatError, TopologyError
from rig.files import atomic_write, output_folder
from rig.mesh.obj import check_size
from rig.mesh.trimesh import MAX_ELEMENTS, TriMesh

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip

_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    length_type: str | None = None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_ply(path: Path | str) -> TriMesh:
    """Read one PLY file; polygons become fans from their first corner.

    Raises
    ------
    FormatError
        If the header is wrong, the file is cut short, or it has no vertices or faces.
    """
    path = Path(path)
    check_size(path)
    vertices: NDArray[Any] | None = None
    polygons: list[NDArray[Any]] = []
    with path.open("rb") as file:
        try:
            order, elements = _header(file)
            for element in elements:
                rows = _read_element(file, element, order)
                if element.name == "vertex":
                    vertices = np.stack([rows[axis] for axis in "xyz"], axis=1)
                elif element.name == "face":
                    key = "vertex_indices" if "vertex_indices" in rows else "vertex_index"
                    polygons = rows[key]
        except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
            raise FormatError(f"{path.name} is not a readable PLY file: {error}") from None
    if vertices is None:
        raise FormatError(f"{path.name} has no 'vertex' element")
    return TriMesh(vertices, _triangulate(polygons))


def _header(file: IO[bytes]) -> tuple[str, list[_Element]]:
    lines: list[list[str]] = []
    for raw in islice(file, 1000):
        lines.append(raw.decode("ascii").split())
        if lines[-1] == ["end_header"]:
            break
    if not lines or lines[0] != ["ply"] or lines[-1] != ["end_header"]:
        raise ValueError("no 'ply' ... 'end_header'")
    order, elements = None, []
    for words in lines[1:-1]:
        match words:
            case ["format", name, _]:
                order = _ORDERS[name]
            case ["element", name, count]:
                elements.append(_Element(name, _bounded(int(count)), []))
            case ["property", "list", length, kind, name]:
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name]:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
    if order is None:
        raise ValueError("no 'format' line")
    return order, elements


def _bounded(count: int) -> int:
    if not 0 <= count <= MAX_ELEMENTS:
        raise ValueError(f"{count} elements; at most {MAX_ELEMENTS}")
    return count


def _read_element(file: IO[bytes], element: _Element, order: str) -> dict[str, Any]:
    if order == "":
        return _columns(element, _ascii_rows(file, element))
    if not any(p.length_type for p in element.properties):
        kind = np.dtype([(p.name, order + p.type) for p in element.properties])
        rows = np.frombuffer(_exactly(file, kind.itemsize * element.count), kind)
        return {p.name: rows[p.name] for p in element.properties}
    return _columns(element, _binary_rows(file, element, order))


def _exactly(file: IO[bytes], size: int) -> bytes:
    data = file.read(size)
    if len(data) != size:
        raise ValueError("the file is cut short")
    return data


def _columns(element: _Element, rows: Iterator[list[Any]]) -> dict[str, Any]:
    columns: dict[str, Any] = {p.name: [] for p in element.properties}
    for row in rows:
        for prop, value in zip(element.properties, row, strict=True):
            columns[prop.name].append(value)
    return columns


def _ascii_rows(file: IO[bytes], element: _Element) -> Iterator[list[Any]]:
    for _ in range(element.count):
        words = iter(file.readline().split())
        row: list[Any] = []
        try:
            for prop in element.properties:
                if prop.length_type is None:
                    row.append(float(next(words)))
                else:
                    row.append(np.array([int(next(words)) for _ in range(int(next(words)))]))
        except StopIteration:
            raise ValueError("the file is cut short") from None
        yield row


def _binary_rows(file: IO[bytes], element: _Element, order: str) -> Iterator[list[Any]]:
    for _ in range(element.count):
        row: list[Any] = []
        for prop in element.properties:
            count = 1
            if prop.length_type is not None:
                length = np.dtype(order + prop.length_type)
                count = int(np.frombuffer(_exactly(file, length.itemsize), length)[0])
            kind = np.dtype(order + prop.type)
            values = np.frombuffer(_exactly(file, kind.itemsize * count), kind)
            row.append(values if prop.length_type else values[0])
        yield row


def _triangulate(polygons: list[NDArray[Any]]) -> NDArray[np.int64]:
    triangles = [
        (int(p[0]), int(p[i]), int(p[i + 1])) for p in polygons for i in range(1, len(p) - 1)
    ]
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)


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


def read_ply_sequence(folder: Path | str) -> tuple[TriMesh, NDArray[np.float32]]:
    """Read a folder of PLY files as frames, in the order of their names.

    Returns
    -------
    first : TriMesh
        The first frame with its triangles.
    vertices : array [shape=(T, V, 3)]
        All frames.

    Raises
    ------
    FormatError
        If there is no PLY file.
    TopologyError
        If a frame's vertex count differs from the first one's.
    """
    files = sorted(Path(folder).glob("*.ply"))
    if not files:
        raise FormatError(f"{folder} holds no .ply files")
    first = read_ply(files[0])
    frames = np.empty((len(files), *first.vertices.shape), dtype=np.float32)
    for frame, file in zip(frames, files, strict=True):
        vertices = read_ply(file).vertices
        if vertices.shape != first.vertices.shape:
            raise TopologyError(
                f"{file.name} has {len(vertices)} vertices, {files[0].name} "
                f"{len(first.vertices)}; all frames of a sequence share one mesh"
            )
        frame[:] = vertices
    return first, frames


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
