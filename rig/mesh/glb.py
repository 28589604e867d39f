"""glTF 2.0 binary files (.glb): a mesh with sparse morph targets and their animation.

Section numbers are those of the Khronos glTF 2.0 specification.
"""

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Int64
from rig.errors import FormatError
from rig.files import atomic_write
from rig.files.reading import check_file, load_json, open_file
from rig.limits import MESH_BYTES
from rig.mesh.shapes import ShapeSet, SparseShapes
from rig.mesh.trimesh import MovedNormals

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942  # §4.4: "glTF", "JSON", "BIN"
_FLOAT, _UINT, _USHORT = 5126, 5125, 5123
_ARRAY_BUFFER, _INDEX_BUFFER = 34962, 34963

SKIN = (0.80, 0.62, 0.53)
"""Linear colour of a mesh without colours of its vertices."""
_STILL = 1e-5
"""A vertex is left out of a morph target if it moves less than this share of the mesh's size."""

_NORMAL_STILL = 3e-3
"""The same for normals: a sixth of a degree."""


Move = tuple[int, str, NDArray[Any]]
"""A node, what of it moves, and its values over time (T, columns)."""
_MOVED = {"weights": ("SCALAR", 1.0), "rotation": ("VEC4", 0.1), "translation": ("VEC3", 0.1)}
"""Type of what moves, and its tolerance in shares of that of weights."""


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """Turn and shift of a node over time.

    Parameters
    ----------
    rotation : array [shape=(T, 4)]
        Unit quaternions x, y, z, w.
    translation : array [shape=(T, 3)]
        In the file's unit.
    """

    rotation: NDArray[Any]
    translation: NDArray[Any]


@dataclass(frozen=True, eq=False)
class WeightAnimation:
    """Morph weights over time.

    Parameters
    ----------
    weights : array [shape=(T, K)]
        One column per shape.
    fps : float
        Frame i is at i / fps seconds.
    motion : RigidMotion, optional
        Of the node of the mesh, in as many frames.
    turns : mapping of int to array [shape=(T, 4)]
        Rotations of nodes, such as bones, as quaternions x, y, z, w.
    tolerance : float
        Above 0: few keys with cubic curves (CUBICSPLINE) that stay this near to all weights, and to
        a tenth of it to all quaternions. The shapes of a mesh share their keys.
    """

    weights: NDArray[Any]
    fps: float = 30.0
    motion: RigidMotion | None = None
    turns: Mapping[int, NDArray[Any]] = field(default_factory=dict)
    tolerance: float = 0.0

    def moves(self, weights: Mapping[int, NDArray[Any]]) -> list[Move]:
        """What moves, with morph weights (T, K) by node."""
        moved: list[Move] = [(node, "weights", rows) for node, rows in weights.items()]
        if self.motion is not None:
            moved.append((0, "rotation", self.motion.rotation))
            moved.append((0, "translation", self.motion.translation))
        return moved + [(node, "rotation", turn) for node, turn in self.turns.items()]


@dataclass(frozen=True, eq=False)
class Surface:
    """Pictures of a mesh's surface.

    Parameters
    ----------
    uv : array [shape=(V, 2), range 0 to 1]
        From the left and from the top of the pictures.
    base_color, roughness : bytes
        Files, PNG or JPEG; roughness is the green channel, base colour multiplies the vertices'.
    cutoff : float, optional
        Alpha of the base colour below which the surface is not there, both of its sides are drawn.
    """

    uv: NDArray[Any]
    base_color: bytes
    roughness: bytes
    cutoff: float | None = None


@dataclass
class GlbBuilder:
    """Builder of a GLB: its JSON and its binary chunk."""

    json: dict[str, Any] = field(default_factory=dict)
    binary: bytearray = field(default_factory=bytearray)

    def view(self, array: NDArray[Any], target: int | None = None) -> int:
        """Append the array's bytes, aligned to 4; return the index of its bufferView."""
        while len(self.binary) % 4:
            self.binary.append(0)
        view: dict[str, Any] = {
            "buffer": 0, "byteOffset": len(self.binary), "byteLength": array.nbytes
        }  # fmt: skip
        if target is not None:
            view["target"] = target
        self.binary += np.ascontiguousarray(array).data
        views = self.json.setdefault("bufferViews", [])
        views.append(view)
        return len(views) - 1

    def accessor(self, **fields: Any) -> int:
        """Append an accessor; return its index."""
        accessors = self.json.setdefault("accessors", [])
        accessors.append(fields)
        return len(accessors) - 1

    def dense(self, array: NDArray[Any], kind: str, target: int | None = None) -> int:
        """Accessor over all of `array`, as uint32 or float32."""
        array = np.ascontiguousarray(array, dtype="<u4" if array.dtype.kind in "iu" else "<f4")
        fields: dict[str, Any] = {
            "bufferView": self.view(array, target),
            "componentType": _UINT if array.dtype.kind == "u" else _FLOAT,
            "count": array.shape[0],
            "type": kind,
        }
        if target == _ARRAY_BUFFER or (kind == "SCALAR" and array.dtype.kind == "f"):
            fields |= _bounds(array)
        return self.accessor(**fields)

    def sparse(
        self, count: int, moving: Int64, delta: NDArray[Any], *, is_bounded: bool = True
    ) -> int:
        """Accessor of `count` displacements that stores those of `moving` vertices (§3.6.2.3).

        Least and greatest are stated of positions, which must have them (§3.7.2.2).
        """
        delta, is_long = np.asarray(delta, "<f4"), count > 2**16
        fields: dict[str, Any] = {"componentType": _FLOAT, "count": count, "type": "VEC3"}
        if len(moving):
            fields["sparse"] = {
                "count": len(moving),
                "indices": {
                    "bufferView": self.view(moving.astype("<u4" if is_long else "<u2")),
                    "componentType": _UINT if is_long else _USHORT,
                },
                "values": {"bufferView": self.view(delta)},
            }  # fmt: skip
        if is_bounded:
            still = np.zeros((int(len(moving) < count), 3), "<f4")
            fields |= _bounds(np.concatenate([delta, still]))
        return self.accessor(**fields)


def _bounds(array: NDArray[Any]) -> dict[str, list[float]]:
    columns = array.reshape(len(array), -1).T
    return {
        "min": [float(column.min()) for column in columns],
        "max": [float(column.max()) for column in columns],
    }


def write_glb(
    path: Path | str,
    shapes: ShapeSet | SparseShapes,
    *,
    animation: WeightAnimation | None = None,
    colours: NDArray[Any] | None = None,
    surface: Surface | None = None,
    metres: float = 1.0,
) -> None:
    """Write a neutral mesh, its shapes as sparse morph targets, and their animation.

    Target names go to `mesh.extras.targetNames`, where Blender, three.js and Unreal read
    them. Unused vertices are dropped, since some viewers do not support them.

    Parameters
    ----------
    path : Path or str
        The .glb file.
    shapes : ShapeSet or SparseShapes
        y up, facing +z.
    animation : WeightAnimation, optional
        Weights of the shapes, in their order.
    colours : array [shape=(V, 3), range 0 to 1], optional
        Linear colours of the vertices; by default all are of `SKIN`.
    surface : Surface, optional
        Textures, which multiply the colours.
    metres : float
        Length of the shapes' unit; glTF's is the metre.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    builder = GlbBuilder()
    builder.json["asset"] = {"version": "2.0", "generator": "deitalk"}
    used = _add_mesh(builder, shapes, colours, metres)
    if surface is not None:
        # Append texture coordinates and textures (§3.8) to the one mesh and material.
        uv = builder.dense(np.asarray(surface.uv, np.float64)[used], "VEC2", _ARRAY_BUFFER)
        builder.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = uv
        textures = {
            "baseColorTexture": surface.base_color,
            "metallicRoughnessTexture": surface.roughness,
        }
        material = builder.json["materials"][0]["pbrMetallicRoughness"]
        material["roughnessFactor"] = 1.0
        if surface.cutoff is not None:
            builder.json["materials"][0] |= {
                "alphaMode": "MASK", "alphaCutoff": surface.cutoff, "doubleSided": True,
            }  # fmt: skip
        builder.json["samplers"] = [{"magFilter": 9729, "minFilter": 9987}]  # linear, with mip maps
        for index, (name, data) in enumerate(textures.items()):
            kind = "image/png" if data.startswith(b"\x89PNG") else "image/jpeg"
            picture = {"bufferView": builder.view(np.frombuffer(data, np.uint8)), "mimeType": kind}
            builder.json.setdefault("images", []).append(picture)
            builder.json.setdefault("textures", []).append({"source": index, "sampler": 0})
            material[name] = {"index": index}
    builder.json["nodes"] = [{"mesh": 0, "name": "face"}]
    builder.json["scenes"] = [{"nodes": [0]}]
    builder.json["scene"] = 0
    if animation is not None:
        weights = np.asarray(animation.weights, dtype=np.float32)
        moves = animation.moves({0: weights})
        add_animation(builder, moves, animation.fps, animation.tolerance)
    write_container(path, builder.json, builder.binary)


def _add_mesh(
    builder: GlbBuilder,
    shapes: ShapeSet | SparseShapes,
    colours: NDArray[Any] | None,
    metres: float,
) -> Int64:
    """Append mesh and material; return the vertices that were kept."""
    mesh, used = shapes.neutral.compact()
    still, moved = (_STILL * mesh.size) ** 2, []
    place = np.full(len(shapes.neutral.vertices), -1)
    place[used] = np.arange(len(used))
    for vertices, shift in shapes.moved:
        at = place[vertices]
        moves = np.flatnonzero((np.einsum("vc,vc->v", shift, shift) > still) & (at >= 0))
        moved.append((np.take(at, moves), np.take(shift, moves, axis=0)))
    normals, targets = MovedNormals(mesh), []
    for moving, shift in moved:
        turned, turn = normals.turn(moving, shift)
        seen = np.flatnonzero(np.einsum("vc,vc->v", turn, turn) > _NORMAL_STILL**2)
        targets.append(
            {
                "POSITION": builder.sparse(len(used), moving, metres * shift),
                "NORMAL": builder.sparse(
                    len(used), turned[seen], np.take(turn, seen, axis=0), is_bounded=False
                ),
            }
        )
    primitive: dict[str, Any] = {
        "attributes": {
            "POSITION": builder.dense(metres * mesh.vertices, "VEC3", _ARRAY_BUFFER),
            "NORMAL": builder.dense(normals.rest, "VEC3", _ARRAY_BUFFER),
        },
        "indices": builder.dense(mesh.faces.ravel(), "SCALAR", _INDEX_BUFFER),
        "material": 0,
    }
    if colours is not None:
        painted = np.asarray(colours, dtype=np.float64)[used]
        primitive["attributes"]["COLOR_0"] = builder.dense(painted, "VEC3", _ARRAY_BUFFER)
    described: dict[str, Any] = {"name": "face", "primitives": [primitive]}
    if targets:
        primitive["targets"] = targets
        described["weights"] = [0.0] * len(targets)
        described["extras"] = {"targetNames": list(shapes.names)}
    builder.json["meshes"] = [described]
    base = SKIN if colours is None else (1.0, 1.0, 1.0)
    plain = {"baseColorFactor": [*base, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.7}
    builder.json["materials"] = [
        {"name": "skin", "pbrMetallicRoughness": plain, "doubleSided": True}
    ]
    return used


def add_animation(
    builder: GlbBuilder, moves: Iterable[Move], fps: float, tolerance: float = 0.0
) -> None:
    """Append one animation of nodes (§3.11); with a tolerance as of `WeightAnimation`."""
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    times = None
    for node, path, rows in moves:
        kind, share = _MOVED[path]
        if tolerance:
            keyed, splines = _few_keys(rows, share * tolerance)
            times = builder.dense(keyed / fps, "SCALAR")
            rows = splines * (np.array([fps, 1.0, fps])[:, None])
        elif times is None:
            times = builder.dense(np.arange(len(rows), dtype=np.float64) / fps, "SCALAR")
        flat = rows.reshape(-1) if kind == "SCALAR" else rows.reshape(-1, rows.shape[-1])
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        way = "CUBICSPLINE" if tolerance else "LINEAR"
        output = builder.dense(flat, kind)
        samplers.append({"input": times, "output": output, "interpolation": way})
    animation = {"name": "take", "samplers": samplers, "channels": channels}
    builder.json.setdefault("animations", []).append(animation)


def _few_keys(rows: NDArray[Any], tolerance: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return frames of keys (K,), and slope a frame, value, slope a frame (K, 3, columns)."""
    from rig.unreal.deitalk_clip import split_curve

    rows = np.asarray(rows, np.float64)

    def fit(first: int, last: int) -> tuple[float, NDArray[Any], NDArray[Any]]:
        n = last - first
        t = np.arange(1, n)[:, None] / n
        line = (rows[last] - rows[first]) / n
        off = rows[first + 1 : last] - rows[first] - line * np.arange(1, n)[:, None]
        basis = np.hstack([n * t * (1 - t) ** 2, -n * t * t * (1 - t)])
        slopes = np.linalg.solve(basis.T @ basis + 1e-6 * np.eye(2), basis.T @ off)
        error = np.abs(off - basis @ slopes).max(initial=0.0)
        return float(error), line + slopes[0], line + slopes[1]

    keys = split_curve([len(rows) - 1], tolerance, fit)
    frames = np.array([key[0] for key in keys])
    zeros = np.zeros(rows.shape[1])
    splines = [[zeros + key[1], rows[key[0]], zeros + key[2]] for key in keys]
    return frames, np.array(splines)


def write_container(path: Path | str, document: dict[str, Any], binary: bytes | bytearray) -> None:
    """Write the two chunks of a GLB file (§4.4)."""
    padding = b"\0" * (-len(binary) % 4)
    size = len(binary) + len(padding)
    document["buffers"] = [{"byteLength": size}]
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + size
    with atomic_write(path) as beside, open(beside, "wb") as file:
        file.write(struct.pack("<III", _MAGIC, 2, total))
        file.write(struct.pack("<II", len(text), _JSON) + text)
        file.write(struct.pack("<II", size, _BIN))
        file.write(binary)
        file.write(padding)


def read_container(path: Path | str) -> tuple[dict[str, Any], bytes]:
    """Read the JSON and the binary chunk of a GLB file.

    Raises
    ------
    FormatError
        If it is no GLB version 2, is cut short, or keeps its data in other files.
    """
    path = Path(path)
    size = check_file(path, MESH_BYTES)
    chunks: dict[int, bytes] = {}
    with open_file(path, MESH_BYTES) as stream:
        if size < 20 or struct.unpack("<II", stream.read(8)) != (_MAGIC, 2):
            raise FormatError(f"{path.name} is not a binary glTF 2.0 file; export it as .glb")
        stream.seek(12)
        while len(header := stream.read(8)) == 8:
            length, kind = struct.unpack("<II", header)
            if stream.tell() + length > size:
                raise FormatError(f"{path.name} is cut short")
            if kind in (_JSON, _BIN) and kind not in chunks:
                chunks[kind] = stream.read(length)
            else:
                stream.seek(length, 1)
    document = load_json(chunks.get(_JSON, b""), f"{path.name}, its JSON chunk,")
    if not isinstance(document, dict):
        raise FormatError(f"{path.name} has no readable JSON chunk")
    buffers = document.get("buffers", [])
    if not isinstance(buffers, list) or any(not isinstance(b, dict) for b in buffers):
        raise FormatError(f"{path.name} is inconsistent: 'buffers' must be a list of objects")
    if any("uri" in buffer for buffer in buffers):
        raise FormatError(f"{path.name} keeps its data in other files; export one .glb")
    return document, chunks.get(_BIN, b"")
