"""Conversion of a take's curves and a mesh file to an animated file (`deitalk retarget`)."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from rig.conversion.avatars import ShapeFit, bare_names
from rig.conversion.convert import known_controls
from rig.curves import RigCurves
from rig.errors import FormatError, RigError, listed
from rig.files import atomic_write
from rig.mesh.fbx import blender, glb_to_fbx
from rig.mesh.glb import WeightAnimation, write_glb
from rig.mesh.glb_reader import animate_glb, morph_names, read_glb
from rig.mesh.obj import read_obj, read_obj_folder
from rig.mesh.ply import read_ply
from rig.mesh.sequence import check_out, principal_shapes, write_sequence
from rig.mesh.shapes import ShapeSet, read_shapes_npz
from rig.mesh.trimesh import TriMesh, check_length
from rig.retarget.blendshapes import FacePoses, match_shapes
from rig.retarget.bones import turns_of
from rig.retarget.found_landmarks import guess_landmarks
from rig.retarget.head_source import source_head
from rig.retarget.landmarks import read_landmarks
from rig.retarget.mapping_files import read_mapping
from rig.retarget.methods import Method, carry_shapes, shapes_for

LEAST_LOST = 1e-3
"""Share of the movement below which nothing is said."""
CUBIC = "the keys are cubic: Blender ignores their slopes and needs all keys"
Way = Literal["blendshapes", "neutral", "sequence"]


@dataclass(frozen=True)
class RetargetReport:
    """Result of a retargeting.

    Parameters
    ----------
    path : Path
        The file or folder written.
    way : str
        "blendshapes": the mesh's own shapes were driven; "neutral": shapes were made for it;
        "sequence": a vertex sequence was carried to it.
    shapes : int
        Shapes that are driven.
    frames : int
    lost : float or None [range 0 to 1]
        Share of the movement that the mesh's own shapes lack.
    notes : tuple of str
        Warnings, one line each.
    mapping : mapping
        Raw curves that each shape of the mesh was taken for; none for an unknown name.
    bones : int
        Bones that follow the head and the gaze.
    """

    path: Path
    way: Way
    shapes: int
    frames: int
    lost: float | None
    notes: tuple[str, ...]
    mapping: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    bones: int = 0


def retarget_curves(
    curves: RigCurves,
    mesh: Path | str,
    out: Path | str,
    *,
    landmarks: Path | str | None = None,
    mapping: Path | str | None = None,
    method: Method = "displacements",
    as_neutral: bool = False,
    keys: float = 0.0,
) -> RetargetReport:
    """Put a take on a user's face and write it.

    Parameters
    ----------
    curves : RigCurves
        Board, raw or ARKit curves, or those of a user's own rig, which drive the shapes of their
        names.
    mesh : Path or str
        A blendshape set (GLB with morph targets, folder of OBJ, NPZ) or one neutral mesh (OBJ, PLY,
        GLB, NPZ without shapes).
    out : Path or str
        ``.glb`` (morph targets and animation), ``.fbx`` (the same by Blender), ``.npz``
        (`vertices` (T, V, 3) and `triangles`), or a folder of PLY files: text that ends with a
        slash, or see `rig.files.is_folder_name`.
    landmarks : Path or str, optional
        Where the landmarks of a neutral mesh are; guessed if not given.
    mapping : Path or str, optional
        Meaning of shapes with unknown names.
    method : str
        Method of making shapes for a neutral mesh: "displacements" or "gradients".
    as_neutral : bool
        Ignore the mesh's own shapes.
    keys : float
        Tolerance of few keys in a GLB, see `WeightAnimation`, or an FBX, see
        `rig.mesh.fbx.glb_to_fbx`.

    Raises
    ------
    FormatError, MeshError, TopologyError, ControlError
        With one line on what to correct.
    """
    mesh = Path(mesh)
    if str(out).lower().endswith(".fbx"):
        blender()
        with TemporaryDirectory(prefix="deitalk-") as folder, atomic_write(out) as beside:
            between = Path(folder) / "take.glb"
            report = retarget_curves(
                curves, mesh, between, landmarks=landmarks, mapping=mapping, method=method,
                as_neutral=as_neutral,
            )  # fmt: skip
            glb_to_fbx(between, beside, curves.fps, keys)
        return replace(report, path=Path(out))
    if keys and check_out(out) != "glb":
        raise FormatError(f"keys={keys:g} does not apply to {out}; it does to .glb and .fbx")
    report = _retarget(curves, mesh, out, landmarks, mapping, method, as_neutral, keys)
    notes = (*curves.notes, *report.notes, *[CUBIC][: bool(keys)])
    drives, is_own = report.way == "blendshapes", known_controls(curves.control_set) is None
    given = {
        "landmarks": drives and landmarks is not None,
        "method": drives and method != "displacements",
        "mapping": (is_own or not drives) and mapping is not None,
        "as_neutral": is_own and as_neutral,
    }
    if unused := [name for name, value in given.items() if value]:
        way = "the shapes of the mesh are driven" if drives else "shapes are made for the mesh"
        notes = (*notes, f"{', '.join(unused)} not used: {way}")
    return replace(report, notes=notes)


def _retarget(
    curves: RigCurves,
    mesh: Path,
    out: Path | str,
    landmarks: Path | str | None,
    mapping: Path | str | None,
    method: Method,
    as_neutral: bool,
    keys: float,
) -> RetargetReport:
    check_out(out)
    if known_controls(curves.control_set) is None:
        return _drive_by_name(curves, mesh, out, keys)
    is_kept = mesh.suffix.lower() == ".glb" and check_out(out) == "glb"
    if is_kept and not as_neutral and (names := morph_names(mesh)):
        # Drive a GLB's own shapes, head, neck and eyes; the GLB that is written keeps the rest.
        shapes = None
        with suppress(FormatError):  # compressed geometry cannot be measured, its names be driven
            shapes = read_glb(mesh)
        fit, poses = _fit(curves, shapes.names if shapes else names, shapes, mapping)
        gaze = [i for i, name in enumerate(bare_names()) if name.startswith("eyeLook")]
        turns = turns_of(mesh, curves, has_gaze=bool(poses.poses[:, gaze].any()))
        animation = WeightAnimation(fit.weights, curves.fps, turns=turns, tolerance=keys)
        animate_glb(mesh, Path(out), fit.names, animation)
        report = _driven(out, fit, poses, len(curves))
        return replace(report, bones=len(turns), notes=(*report.notes, *_unturned(curves, turns)))
    shapes = read_shapes(mesh)
    if shapes.names and not as_neutral:
        fit, poses = _fit(curves, shapes.names, shapes, mapping)
        _write(out, shapes, fit.weights, curves.fps, keys)
        return _driven(out, fit, poses, len(curves))
    found, notes = _landmarks(shapes, landmarks)
    rig, carried = shapes_for(shapes.neutral, found, method=method)
    _write(out, rig.shapes, rig.weights(curves), curves.fps, keys)
    notes += carried.warnings
    return RetargetReport(Path(out), "neutral", len(rig.shapes.names), len(curves), None, notes)


def retarget_sequence(
    template: TriMesh,
    vertices: Any,
    mesh: Path | str,
    out: Path | str,
    *,
    fps: float,
    tolerance: float,
    source_landmarks: Mapping[str, int] | None = None,
    landmarks: Path | str | None = None,
) -> RetargetReport:
    """Put a vertex sequence of one head on a user's neutral mesh of any topology and write it.

    Parameters
    ----------
    template : TriMesh
        The head the sequence is of, at rest, mouth closed.
    vertices : array [shape=(T, V, 3)]
        Frame i is at i / fps seconds.
    mesh : Path or str
        As for `retarget_curves`; shapes it has are left alone.
    out : Path or str
        As for `retarget_curves`.
    fps : float
        Any rate above 0.
    tolerance : float
        Largest error of a vertex of the template, in its unit.
    source_landmarks : mapping of str to int, optional
        Of the template; guessed if not given.
    landmarks : Path or str, optional
        Where the landmarks of the mesh are; guessed if not given.

    Raises
    ------
    FormatError, MeshError, TopologyError
        With one line on what to correct.

    Notes
    -----
    The sequence is first approximated by principal shapes, which are carried as any shape is:
    the gaps between the lips are linear in them.
    """
    mesh = Path(mesh)
    check_out(out)
    target = read_shapes(mesh)
    found, notes = _landmarks(target, landmarks)
    known = source_landmarks or _guessed(template)
    shapes, weights = principal_shapes(template, vertices, tolerance)
    carried = carry_shapes(replace(shapes, landmarks=known), target.neutral, found)
    _write(out, carried.shapes, weights, fps)
    notes += carried.warnings
    return RetargetReport(Path(out), "sequence", len(shapes.names), len(weights), None, notes)


def _guessed(mesh: TriMesh) -> Mapping[str, int]:
    source = source_head()
    return guess_landmarks(mesh, source.mesh, source.landmarks)


def _landmarks(
    shapes: ShapeSet, path: Path | str | None
) -> tuple[Mapping[str, int], tuple[str, ...]]:
    """Landmarks from a file, from the shape set, or guessed; and warnings about them."""
    if path is not None:
        return read_landmarks(path, shapes.neutral), ()
    if shapes.landmarks:
        return shapes.landmarks, ()
    guessed = _guessed(shapes.neutral)
    return guessed, (
        f"{len(guessed)} landmarks were guessed; look at the mouth and the eyes, and give "
        "their places (landmarks) if they are off",
    )


def read_shapes(path: Path | str) -> ShapeSet:
    """Read a mesh or shape set: a folder of OBJ, or .obj, .ply, .glb or .npz.

    A file of one mesh is a set without shapes.

    Raises
    ------
    RigError
        If the suffix is none of these, or the file holds no mesh; it names the file.
    """
    path = Path(path)
    if path.is_dir():
        return read_obj_folder(path)
    readers: dict[str, Any] = {
        ".obj": read_obj, ".ply": read_ply, ".glb": read_glb, ".npz": read_shapes_npz
    }  # fmt: skip
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise FormatError(
            f"{path.name}: meshes come as .obj, .ply, .glb, .npz or a folder of .obj files; "
            "convert it (Blender reads FBX and USD and exports .glb)"
        )
    try:
        read: ShapeSet | TriMesh = reader(path)
    except RigError as error:
        if path.name in str(error):
            raise
        raise type(error)(f"{path.name}: {error}") from None
    if isinstance(read, TriMesh):
        return ShapeSet(read, (), np.zeros((0, *read.vertices.shape), dtype=np.float32))
    return read


def _unturned(curves: RigCurves, turns: Mapping[int, Any]) -> tuple[str, ...]:
    """Note on the part of the head track that the file does not show."""
    if curves.head is None:
        return ()
    notes = []
    if not turns and np.any(curves.head[:, :3]):
        notes.append("the file has no bone of a head: its turn is not shown")
    if np.any(curves.head[:, 3:]):
        notes.append("the shift of the head is not shown")
    return tuple(notes)


def _drive_by_name(curves: RigCurves, mesh: Path, out: Path | str, keys: float) -> RetargetReport:
    """Drive the shapes that have the names of a user's own controls, in any case of letters."""
    is_kept = mesh.suffix.lower() == ".glb" and check_out(out) == "glb"
    shapes = None if is_kept else read_shapes(mesh)
    names = morph_names(mesh) if shapes is None else shapes.names
    columns = {name.lower(): i for i, name in enumerate(curves.names)}
    driven = {name: columns[name.lower()] for name in names if name.lower() in columns}
    if not driven:
        raise FormatError(
            f"{mesh.name}: none of its {len(names)} shapes has the name of a control of "
            f"{curves.control_set}, such as {curves.names[0]}; name the shapes as the controls"
        )
    if shapes is None:
        weights = curves.values[:, list(driven.values())]
        animation = WeightAnimation(weights, curves.fps, tolerance=keys)
        animate_glb(mesh, Path(out), tuple(driven), animation)
    else:
        weights = np.zeros((len(curves), len(names)), np.float32)
        for place, name in enumerate(names):
            if name in driven:
                weights[:, place] = curves.values[:, driven[name]]
        _write(out, shapes, weights, curves.fps, keys)
    used = set(driven.values())
    idle = [
        name for i, name in enumerate(curves.names) if i not in used and np.ptp(curves.values[:, i])
    ]
    notes = (f"no shape for {len(idle)} controls that move ({listed(idle, 4)})",) if idle else ()
    return RetargetReport(Path(out), "blendshapes", len(driven), len(curves), None, notes)


def _fit(
    curves: RigCurves,
    names: tuple[str, ...],
    shapes: ShapeSet | None,
    mapping: Path | str | None,
) -> tuple[ShapeFit, FacePoses]:
    own = None if mapping is None else read_mapping(mapping)
    poses = match_shapes(names, mapping=own, shapes=shapes)
    return poses.weights(curves), poses


def _driven(out: Path | str, fit: ShapeFit, poses: FacePoses, frames: int) -> RetargetReport:
    notes = []
    unknown = [name for name in poses.names if name not in poses.understood]
    if unknown:
        notes.append(
            f"{len(unknown)} shapes of unknown name stay at 0 ({listed(unknown, 4)}); a mapping "
            "file can name them"
        )
    if fit.lost > LEAST_LOST or fit.unsaid or fit.replaced:
        notes.append(str(fit))
    count, mapping = len(poses.understood), poses.mapping()
    return RetargetReport(Path(out), "blendshapes", count, frames, fit.lost, tuple(notes), mapping)


def _write(out: Path | str, shapes: ShapeSet, weights: Any, fps: float, keys: float = 0.0) -> None:
    if check_out(out) == "glb":
        write_glb(Path(out), shapes, animation=WeightAnimation(weights, fps, tolerance=keys))
        return
    check_length(len(weights), len(shapes.neutral.vertices))
    vertices = shapes.evaluate(weights).astype(np.float32)
    write_sequence(out, shapes.neutral, vertices, fps=fps)
