"""Read a user's GLB: its meshes joined into one, with named morph targets; or add an animation.

`read_glb` reads geometry. `animate_glb` copies the user's file (materials, textures, skin,
compression) and only appends morph weights by name.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Float64, Int64
from rig.errors import FormatError, MeshError, quoted
from rig.limits import NODES, PRIMITIVES, SHAPES, TARGETS, TRIANGLES, VERTICES
from rig.mesh.glb import GlbBuilder, WeightAnimation, add_animation, read_container, write_container
from rig.mesh.shapes import ShapeSet, check_shape_count
from rig.mesh.trimesh import TriMesh

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_TRIANGLES = 4
_READABLE = {
    "KHR_mesh_quantization", "KHR_texture_transform", "KHR_lights_punctual", "EXT_texture_webp"
}  # fmt: skip
_COMPRESSED = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
    "KHR_texture_basisu": "KTX2 texture",
}


@dataclass(frozen=True, eq=False)
class Piece:
    """One primitive, already in scene space.

    Attributes
    ----------
    vertices : ndarray [shape=(V, 3)]
    faces : ndarray [shape=(N, 3)]
    names : list of str
        Of its morph targets.
    deltas : list of ndarray [shape=(V, 3)]
    node : int
        The node that shows it.
    primitive : dict
        As in the document.
    """

    vertices: Float64
    faces: Int64
    names: list[str]
    deltas: list[Float32]
    node: int
    primitive: dict[str, Any]


@dataclass(frozen=True, eq=False)
class GlbParts:
    """A file, and what each vertex of its joined mesh belongs to."""

    document: dict[str, Any]
    binary: bytes
    pieces: list[Piece]

    @cached_property
    def shapes(self) -> ShapeSet:
        """All pieces as one mesh, shapes of the same name as one."""
        starts = np.cumsum([0, *(len(p.vertices) for p in self.pieces)])
        names = list(dict.fromkeys(name for p in self.pieces for name in p.names))
        place = {name: k for k, name in enumerate(names)}
        deltas = np.zeros((len(names), int(starts[-1]), 3), dtype=np.float32)
        for start, piece in zip(starts, self.pieces, strict=False):
            for name, delta in zip(piece.names, piece.deltas, strict=True):
                deltas[place[name], start : start + len(delta)] += delta
        faces = np.concatenate([p.faces + s for s, p in zip(starts, self.pieces, strict=False)])
        vertices = np.concatenate([p.vertices for p in self.pieces])
        deltas.setflags(write=False)  # not copied again
        return ShapeSet(TriMesh(vertices, faces), tuple(names), deltas)

    def column(self, piece: Piece, name: str) -> Float64 | None:
        """An attribute of a piece's vertices (V, width), what is not finite 0; or none."""
        index = piece.primitive["attributes"].get(name)
        if index is None:
            return None
        values = read_accessor(self.document, self.binary, index)
        return np.nan_to_num(values.reshape(len(piece.vertices), -1), posinf=0, neginf=0)

    def each(self, values: Sequence[Any]) -> NDArray[Any]:
        """A value of each piece for each of its vertices."""
        return np.repeat(np.asarray(values), [len(p.vertices) for p in self.pieces], axis=0)

    def material(self, piece: Piece) -> dict[str, Any]:
        """The material of a piece; empty without one."""
        index = piece.primitive.get("material")
        found: dict[str, Any] = {} if index is None else self.document["materials"][index]
        return found

    def names(self, piece: Piece) -> list[str]:
        """Names of a piece: of its node, mesh and material."""
        node = self.document["nodes"][piece.node]
        parts = node, self.document["meshes"][node["mesh"]], self.material(piece)
        return [str(part.get("name", "")) for part in parts]

    def ancestors(self, piece: Piece) -> list[str]:
        """Names of the nodes that a piece hangs below."""
        nodes = self.document["nodes"]
        parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}
        found: list[int] = []
        node = parents.get(piece.node)
        while node is not None and node not in found:
            found.append(node)
            node = parents.get(node)
        return [str(nodes[k].get("name", "")) for k in found]


def read_glb(path: Path | str) -> ShapeSet:
    """Join all triangle meshes of the default scene into one mesh with its morph targets.

    Shapes of the same name on several meshes (face, teeth, lashes) become one. Node transforms
    are applied; skins are not (the bind pose is read).

    Raises
    ------
    FormatError
        If the file is compressed (Draco, meshopt, KTX2), needs an unknown extension, or is
        inconsistent.
    """
    return read_parts(path).shapes


def read_parts(path: Path | str) -> GlbParts:
    """Read the document, the binary chunk and all triangle meshes of the default scene.

    Raises
    ------
    FormatError
        As `read_glb`.
    """
    path = Path(path)
    document, binary = read_container(path)
    with consistent(path), np.errstate(all="ignore"):  # what is not finite is refused later
        required = document.get("extensionsRequired", [])
        for extension in required:
            if extension in _COMPRESSED:
                raise FormatError(
                    f"{path.name} uses {_COMPRESSED[extension]} compression ({extension}); "
                    "export it again without compression"
                )
            if extension not in _READABLE and not extension.startswith("KHR_materials_"):
                raise FormatError(
                    f"{path.name} needs the extension {extension}, which is not read here"
                )
        pieces = _pieces(document, binary)
        if not pieces:
            raise FormatError(f"{path.name} holds no triangle mesh")
        return GlbParts(document, binary, pieces)


@contextmanager
def consistent(path: Path) -> Iterator[None]:
    """Turn errors of an inconsistent document into a FormatError."""
    try:
        yield
    except (MeshError, FormatError):
        raise
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FormatError(f"{path.name} is inconsistent: {quoted(error)}") from None


def _pieces(document: dict[str, Any], binary: bytes) -> list[Piece]:
    """Collect the primitives of the scene until they are all there, or too many to be held."""
    pieces: list[Piece] = []
    names: set[str] = set()
    vertices = triangles = targets = 0
    meshes = [(n, world) for n, world in walk(document) if "mesh" in document["nodes"][n]]
    for node, world in meshes:
        for primitive in document["meshes"][document["nodes"][node]["mesh"]]["primitives"]:
            if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
                continue
            piece = _piece(document, binary, node, primitive, world)
            pieces.append(piece)
            names.update(piece.names)
            vertices += len(piece.vertices)
            triangles += len(piece.faces)
            targets += len(piece.names)
            if len(pieces) > PRIMITIVES or targets > TARGETS:
                raise FormatError(
                    f"more than {PRIMITIVES} primitives or {TARGETS} morph targets; join the meshes"
                )
            if vertices > VERTICES or triangles > TRIANGLES:
                raise MeshError(
                    f"more than {VERTICES} vertices or {TRIANGLES} triangles; decimate the mesh"
                )
            check_shape_count(len(names), vertices)
    return pieces


def walk(document: dict[str, Any]) -> Iterator[tuple[int, Float64]]:
    """Nodes of the default scene with their world transforms; a node is visited once."""
    nodes = _nodes(document)
    scenes = document.get("scenes") or [{"nodes": list(range(len(nodes)))}]
    roots = scenes[document.get("scene", 0)].get("nodes", [])
    waiting = deque((i, np.eye(4)) for i in roots)
    seen: set[int] = set()
    while waiting:
        index, parent = waiting.popleft()
        if index in seen:
            continue
        seen.add(index)
        world = parent @ _local_transform(nodes[index])
        yield index, world
        waiting.extend((child, world) for child in nodes[index].get("children", []))


def _nodes(document: dict[str, Any]) -> list[dict[str, Any]]:
    nodes: list[dict[str, Any]] = document.get("nodes", [])
    if len(nodes) > NODES:
        raise FormatError(f"the scene has {len(nodes)} nodes; at most {NODES} are read")
    return nodes


def _local_transform(node: dict[str, Any]) -> Float64:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(node.get("rotation", (0.0, 0.0, 0.0, 1.0))).as_matrix()
    local = np.eye(4)
    local[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    local[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return local


def _piece(
    document: dict[str, Any], binary: bytes, node: int, primitive: dict[str, Any], world: Float64
) -> Piece:
    vertices = _stored(document, binary, primitive["attributes"]["POSITION"], "VEC3")
    if "indices" in primitive:
        corners = _stored(document, binary, primitive["indices"], "SCALAR").astype(np.int64)
    else:
        corners = np.arange(len(vertices))
    targets = primitive.get("targets", [])
    if len(targets) > SHAPES:
        raise FormatError(f"{len(targets)} morph targets; at most {SHAPES} are read")
    check_shape_count(len(targets), len(vertices))
    names = target_names(document["meshes"][document["nodes"][node]["mesh"]], len(targets))
    turned = []
    for target in targets:
        delta = np.zeros_like(vertices)
        if "POSITION" in target:
            delta = _stored(document, binary, target["POSITION"], "VEC3", len(vertices))
        turned.append(np.asarray(delta @ world[:3, :3].T, np.float32))
    placed = vertices @ world[:3, :3].T + world[:3, 3]
    return Piece(placed, corners.reshape(-1, 3), names, turned, node, primitive)


def _stored(
    document: dict[str, Any], binary: bytes, index: int, kind: str, moved: int | None = None
) -> Float64:
    """Positions or indices, whose numbers are all in the file; or how so many vertices move."""
    accessor = document["accessors"][index]
    if moved is not None and (accessor["type"] != kind or accessor["count"] != moved):
        raise FormatError(f"a morph target does not move the {moved} vertices of its mesh")
    if accessor["type"] != kind or (moved is None and "bufferView" not in accessor):
        raise FormatError(f"accessor {quoted(index)} is no {kind} with data; export it again")
    return read_accessor(document, binary, index)


def target_names(mesh: dict[str, Any], count: int) -> list[str]:
    """Names of a mesh's morph targets; `target_0` ... where the file gives none."""
    names = mesh.get("extras", {}).get("targetNames", [])
    if len(names) != count:
        return [f"target_{i}" for i in range(count)]
    return [str(name) for name in names]


def read_accessor(document: dict[str, Any], binary: bytes, index: int) -> Float64:
    """One accessor as float64 [shape=(count,) or (count, width)], sparse parts put in."""
    accessor = document["accessors"][index]
    kind = np.dtype(_COMPONENTS[accessor["componentType"]])
    width, count = _WIDTHS[accessor["type"]], int(accessor["count"])
    if not 0 <= count * width <= 3 * max(VERTICES, TRIANGLES):
        raise FormatError(
            f"an accessor counts {quoted(count)} elements of {width} numbers; at most "
            f"{3 * max(VERTICES, TRIANGLES)} numbers are read"
        )
    values = np.zeros((count, width))
    if "bufferView" in accessor:
        values[:] = _view(document, binary, accessor, kind, count, width)
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        where = _COMPONENTS[sparse["indices"]["componentType"]]
        amount = int(sparse["count"])
        rows = _view(document, binary, sparse["indices"], np.dtype(where), amount, 1)[:, 0]
        values[rows] = _view(document, binary, sparse["values"], kind, amount, width)
    if accessor.get("normalized") and kind.kind in "iu":
        values = np.maximum(values / np.iinfo(kind).max, -1.0)
    return values[:, 0] if width == 1 else values


def _view(
    document: dict[str, Any],
    binary: bytes,
    source: dict[str, Any],
    kind: np.dtype[Any],
    count: int,
    width: int,
) -> NDArray[Any]:
    view = document["bufferViews"][source["bufferView"]]
    start = view.get("byteOffset", 0) + source.get("byteOffset", 0)
    row = kind.itemsize * width
    stride = view.get("byteStride", row)
    end = start + (count - 1) * stride + row if count else start
    if start < 0 or stride < row or end > len(binary):
        raise FormatError(f"bufferView {source['bufferView']} reaches past the file's data")
    return np.ndarray((count, width), kind, binary, start, (stride, kind.itemsize))


def _separate(node: dict[str, Any]) -> None:
    """Give a node three parts for its matrix, as animated nodes need (§3.11)."""
    if "matrix" in node:
        local = _local_transform(node)
        scale = np.linalg.norm(local[:3, :3], axis=0)
        turn = _rotation(local).as_quat()
        parts = {"translation": local[:3, 3], "rotation": turn, "scale": scale}
        del node["matrix"]
        node |= {name: part.tolist() for name, part in parts.items()}


def world_rotations(document: dict[str, Any]) -> dict[int, "tuple[Rotation, Rotation]"]:
    """Return, by node of the scene, the rotations of its parent in the scene and of itself."""
    found: dict[int, tuple[Rotation, Rotation]] = {}
    for index, world in walk(document):
        local = _local_transform(document["nodes"][index])
        turns = [_rotation(matrix) for matrix in (world, local)]
        found[index] = turns[0] * turns[1].inv(), turns[1]
    return found


def _rotation(matrix: Float64) -> "Rotation":
    from scipy.spatial.transform import Rotation

    turned = matrix[:3, :3]
    return Rotation.from_matrix(turned / np.linalg.norm(turned, axis=0))


def morph_names(path: Path | str) -> tuple[str, ...]:
    """Names of all morph targets in a GLB file, compressed or not, in file order."""
    path = Path(path)
    document, _ = read_container(path)
    with consistent(path):
        names = [n for _, columns in morphing_nodes(document) for n in columns]
        return tuple(dict.fromkeys(names))


def morphing_nodes(document: dict[str, Any]) -> list[tuple[int, list[str]]]:
    """Return the nodes of meshes with morph targets, and the names of these."""
    found = []
    for index, node in enumerate(_nodes(document)):
        if "mesh" in node:
            mesh = document["meshes"][node["mesh"]]
            count = len(mesh["primitives"][0].get("targets", []))
            if count > SHAPES:
                raise FormatError(f"{count} morph targets; at most {SHAPES} are read")
            if count:
                found.append((index, target_names(mesh, count)))
    return found


def animate_glb(
    source: Path | str, path: Path | str, names: tuple[str, ...], animation: WeightAnimation
) -> None:
    """Copy a GLB and append an animation of its morph targets.

    Parameters
    ----------
    source : Path or str
        The user's file; geometry, textures and compression stay as they are.
    path : Path or str
        The new file.
    names : tuple of str
        Morph target of each column of `animation.weights`; targets not named stay at 0.
    animation : WeightAnimation
        Weights [shape=(T, K)].

    Raises
    ------
    MeshError
        If none of the names is a morph target of the file.
    """
    document, binary = read_container(source)
    with consistent(Path(source)):
        nodes = morphing_nodes(document)
    weights = np.asarray(animation.weights, dtype=np.float32)
    column = {name: i for i, name in enumerate(names)}
    driven: dict[int, Float32] = {}
    for node, targets in nodes:
        picked = np.zeros((len(weights), len(targets)), dtype=np.float32)
        known = [(k, column[t]) for k, t in enumerate(targets) if t in column]
        for k, i in known:
            picked[:, k] = weights[:, i]
        if known:
            driven[node] = picked
    for node in animation.turns:
        _separate(document["nodes"][node])
    if not driven:
        raise MeshError(f"{Path(source).name} has none of the morph targets {', '.join(names[:6])}")
    builder = GlbBuilder(document, bytearray(binary))
    add_animation(builder, animation.moves(driven), animation.fps, animation.tolerance)
    write_container(path, document, bytes(builder.binary))
