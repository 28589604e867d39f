"""USD: our head as UsdSkel blend shapes, and the raw curves as Audio2Face's exporters wrote them.

Needs the package usd-core. The animation prim carries ``custom:mh_curveNames`` and
``custom:mh_curveValues``, which Omniverse's connector reads into an AnimSequence; `read` takes the
curves from there. Unreal's own importer reads the blend shapes only. A head track turns the root
about the joint of skull and spine, and is kept as ``custom:deitalk_head``. Materials show the
vertex colours, in a package (``.usdz``) a picture, which more programs know.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rig.arrays import AnyFloat, Float32, Float64
from rig.controls import ControlSet
from rig.conversion.raw import RAW_ID, board_to_raw, raw_controls
from rig.curves import HEAD, RigCurves
from rig.errors import FormatError, quoted
from rig.face.head import Head
from rig.face.head_pose import matrices
from rig.face.identity import Identity
from rig.face.mesh import EYE, FINE, HAIR
from rig.files.reading import check_expansion, check_file
from rig.limits import CURVES_BYTES, FRAMES, SPARSE_BYTES
from rig.mesh.shapes import SparseShapes
from rig.retarget.morph_head import (
    EYE_ROUGHNESS,
    HAIR_ROUGHNESS,
    METRES_PER_CM,
    SKIN_ROUGHNESS,
    baked_picture,
    morph_head,
    painted_colours,
)

NAMES, VALUES = "custom:mh_curveNames", "custom:mh_curveValues"
HEAD_TRACK = "custom:deitalk_head"
STILL_CM = 1e-3
PICTURE = "head.png"
KINDS = {"hair": (HAIR, FINE), "eyes": (EYE,)}
ROUGHNESS = {"hair": HAIR_ROUGHNESS, "eyes": EYE_ROUGHNESS, "skin": SKIN_ROUGHNESS}
"""Roughness of the materials; what is of neither kind is skin."""


def write(path: Path, curves: RigCurves, identity: int | str | Identity = 0) -> None:
    """Write a SkelRoot with mesh, blend shapes and animation; cm, y up, a time code per frame.

    `identity` is a head as of `rig.face.build_head`.
    """
    from rig.face import build_head

    pxr = _pxr()
    rig, head = morph_head(identity), build_head(identity)
    stage = pxr.Usd.Stage.CreateInMemory()
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.y)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, METRES_PER_CM)
    stage.SetTimeCodesPerSecond(curves.fps)
    stage.SetFramesPerSecond(curves.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(curves) - 1)
    root = pxr.UsdSkel.Root.Define(stage, "/head")
    stage.SetDefaultPrim(root.GetPrim())
    # Define one static joint: UsdSkel binds an animation to a skeleton.
    skeleton = pxr.UsdSkel.Skeleton.Define(stage, "/head/skeleton")
    still = [pxr.Gf.Matrix4d(1)]
    skeleton.CreateJointsAttr(["head"])
    skeleton.CreateBindTransformsAttr(still)
    skeleton.CreateRestTransformsAttr(still)
    mesh, shapes = _mesh(pxr, stage, skeleton, rig.shapes, painted_colours(head))
    animation = pxr.UsdSkel.Animation.Define(stage, "/head/animation")
    animation.CreateBlendShapesAttr(shapes)
    pxr.UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(
        [animation.GetPath()]
    )
    pxr.UsdSkel.BindingAPI.Apply(mesh.GetPrim()).CreateBlendShapesAttr(shapes)
    weights = animation.CreateBlendShapeWeightsAttr()
    rows = rig.weights(curves)
    _samples(pxr, weights, rows)
    box = pxr.Vt.Vec3fArray.FromNumpy(_extent(rig.shapes, rows))
    mesh.CreateExtentAttr(box)
    root.CreateExtentAttr(box)
    raw = board_to_raw(curves)
    types = pxr.Sdf.ValueTypeNames
    animation.GetPrim().CreateAttribute(NAMES, types.TokenArray).Set(list(raw.names))
    _samples(pxr, animation.GetPrim().CreateAttribute(VALUES, types.FloatArray), raw.values)
    if curves.head is not None:
        kept = animation.GetPrim().CreateAttribute(HEAD_TRACK, types.FloatArray)
        _samples(pxr, kept, curves.head)
        operation = pxr.UsdGeom.Xformable(root).AddTransformOp()
        for i, (turn, shift) in enumerate(zip(*matrices(curves.head), strict=True)):
            placed = np.eye(4)  # USD multiplies rows by the matrix
            placed[:3, :3], placed[3, :3] = turn.T, shift
            operation.Set(pxr.Gf.Matrix4d(placed.tolist()), i)
    if path.suffix.lower() == ".usdz":
        uv, picture = baked_picture(head)
        _dress(pxr, stage, mesh, head, uv, is_packed=True)
        with TemporaryDirectory(prefix="deitalk-") as folder:
            layer = Path(folder) / "head.usdc"
            (Path(folder) / PICTURE).write_bytes(picture)
            stage.GetRootLayer().Export(str(layer))
            written = pxr.UsdUtils.CreateNewUsdzPackage(pxr.Sdf.AssetPath(str(layer)), str(path))
    else:
        _dress(pxr, stage, mesh, head, head.mesh.uv, is_packed=False)
        written = stage.GetRootLayer().Export(str(path))
    if not written:
        raise OSError(f"usd-core could not write {path.name}")


def _dress(pxr: Any, stage: Any, mesh: Any, head: Head, uv: Float64, *, is_packed: bool) -> None:
    """Define texture coordinates of vertices, or in a package of the faces' corners; materials."""
    tokens, types = pxr.UsdGeom.Tokens, pxr.Sdf.ValueTypeNames
    places = tokens.faceVarying if is_packed else tokens.vertex
    st = pxr.UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", types.TexCoord2fArray, places)
    upwards = (uv.reshape(-1, 2) * [1, -1] + [0, 1]).astype(np.float32)
    st.Set(pxr.Vt.Vec2fArray.FromNumpy(upwards))
    pxr.UsdGeom.Scope.Define(stage, "/head/materials")
    kind = head.mesh.kind[head.mesh.faces[:, 0]]
    for name, roughness in ROUGHNESS.items():
        chosen = np.isin(kind, KINDS.get(name, sum(KINDS.values(), ())), invert=name not in KINDS)
        faces = pxr.Vt.IntArray.FromNumpy(np.flatnonzero(chosen).astype(np.int32))
        part = pxr.UsdGeom.Subset.CreateGeomSubset(mesh, name, "face", faces, "materialBind")
        material = pxr.UsdShade.Material.Define(stage, f"/head/materials/{name}")
        surface = _shader(pxr, material, "UsdPreviewSurface")
        if is_packed:
            colour, alpha = _picture(pxr, material)
            if name == "hair":
                surface.CreateInput("opacity", types.Float).ConnectToSource(alpha)
                surface.CreateInput("opacityThreshold", types.Float).Set(0.5)
        else:
            colour = _reader(pxr, material, "displayColor", 3)
        surface.CreateInput("diffuseColor", types.Color3f).ConnectToSource(colour)
        surface.CreateInput("roughness", types.Float).Set(roughness)
        shown = surface.CreateOutput("surface", types.Token)
        material.CreateSurfaceOutput().ConnectToSource(shown)
        pxr.UsdShade.MaterialBindingAPI.Apply(part.GetPrim()).Bind(material)
    pxr.UsdGeom.Subset.SetFamilyType(mesh, "materialBind", tokens.partition)


def _shader(pxr: Any, material: Any, kind: str) -> Any:
    shader = pxr.UsdShade.Shader.Define(
        material.GetPrim().GetStage(), f"{material.GetPath()}/{kind}"
    )
    shader.CreateIdAttr(kind)
    return shader


def _reader(pxr: Any, material: Any, name: str, width: int) -> Any:
    """Output of a node that reads a primvar of so many floats."""
    types = pxr.Sdf.ValueTypeNames
    reader = _shader(pxr, material, f"UsdPrimvarReader_float{width}")
    reader.CreateInput("varname", types.String).Set(name)
    return reader.CreateOutput("result", types.Float2 if width == 2 else types.Float3)


def _picture(pxr: Any, material: Any) -> tuple[Any, Any]:
    """Outputs of a node that shows the picture: colour and alpha."""
    types, texture = pxr.Sdf.ValueTypeNames, _shader(pxr, material, "UsdUVTexture")
    texture.CreateInput("file", types.Asset).Set(pxr.Sdf.AssetPath(f"./{PICTURE}"))
    texture.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
    for wrap in ("wrapS", "wrapT"):
        texture.CreateInput(wrap, types.Token).Set("clamp")
    texture.CreateInput("st", types.Float2).ConnectToSource(_reader(pxr, material, "st", 2))
    return texture.CreateOutput("rgb", types.Float3), texture.CreateOutput("a", types.Float)


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read the raw curves of the first prim that has them.

    Raises
    ------
    FormatError
        If the file is no USD, is composed of others, or no prim carries the two attributes.
    """
    check_file(path, CURVES_BYTES)
    pxr = _pxr()
    try:
        layer = pxr.Sdf.Layer.OpenAsAnonymous(str(path))
        if layer is None:
            raise FormatError(f"{path} is no USD file: it is damaged")
        _check_alone(path, layer)
        stage = pxr.Usd.Stage.Open(layer)
        for prim in stage.Traverse():
            if prim.GetAttribute(NAMES) and prim.GetAttribute(VALUES):
                return _curves(path, stage, prim, fps)
    except (pxr.Tf.ErrorException, TypeError, UnicodeError) as error:
        raise FormatError(f"{path} is no USD file: {_reason(error)}") from None
    raise FormatError(f"{path} has no prim with {NAMES} and {VALUES}")


def _check_alone(path: Path, layer: Any) -> None:
    """Refuse a file that has USD open others, which may lie anywhere on this machine."""
    others = [*layer.GetCompositionAssetDependencies(), *layer.GetExternalAssetDependencies()]

    def note_clips(place: Any) -> None:
        spec = layer.GetPrimAtPath(place) if place.IsPrimPath() else None
        if spec is not None and spec.HasInfo("clips"):
            others.append(place)

    layer.Traverse("/", note_clips)
    if others:
        what = quoted(str(others[0]))
        raise FormatError(f"{path} is composed of other files ({what}); flatten it to one")


def _reason(error: Exception) -> str:
    """Return the last line of an error, which may quote bytes that are no text."""
    try:
        return str(error).strip().splitlines()[-1].strip()
    except (UnicodeError, IndexError):
        return "it is damaged"


def _curves(path: Path, stage: Any, prim: Any, fps: float | None) -> RigCurves:
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    rate = stage.GetTimeCodesPerSecond()
    n_frames = int(end - start) + 1 if np.isfinite(end - start) else 0
    if not 0 < n_frames <= FRAMES:
        raise FormatError(f"{path} runs from time code {start:g} to {end:g}; that is no clip")
    size = check_file(path, CURVES_BYTES)
    check_expansion(
        4 * n_frames * len(raw_controls()), size, path, error=FormatError, floor=SPARSE_BYTES
    )
    given = prim.GetAttribute(NAMES).Get() or ()
    found = raw_controls().resolve([str(name) for name in given])

    def rows(name: str, width: int) -> Float32:
        attribute = prim.GetAttribute(name)
        read = [np.asarray(attribute.Get(start + i) or (), np.float32) for i in range(n_frames)]
        if any(row.shape != (width,) for row in read):
            raise FormatError(f"{path}: {name} has not {width} values in every frame")
        return np.stack(read)

    values = rows(VALUES, len(found))
    head = rows(HEAD_TRACK, len(HEAD)) if prim.GetAttribute(HEAD_TRACK) else None
    curves = RigCurves(values, found, fps or rate, control_set=RAW_ID, head=head)
    return curves.reorder(raw_controls())


def _mesh(
    pxr: Any, stage: Any, skeleton: Any, head: SparseShapes, colours: Float64
) -> tuple[Any, list[str]]:
    """Define the mesh with a blend shape prim per morph target; return it and their names."""
    neutral = head.neutral
    mesh = pxr.UsdGeom.Mesh.Define(stage, "/head/face")
    vectors, integers = pxr.Vt.Vec3fArray.FromNumpy, pxr.Vt.IntArray.FromNumpy
    mesh.CreatePointsAttr(vectors(neutral.vertices.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(integers(np.full(len(neutral.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(integers(neutral.faces.astype(np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    display = mesh.CreateDisplayColorPrimvar(pxr.UsdGeom.Tokens.vertex)
    display.Set(vectors(colours.astype(np.float32)))
    binding = pxr.UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    joints = np.zeros(len(neutral.vertices), np.int32)
    binding.CreateJointIndicesPrimvar(False, 1).Set(integers(joints))
    ones = pxr.Vt.FloatArray.FromNumpy(np.ones(len(joints), np.float32))
    binding.CreateJointWeightsPrimvar(False, 1).Set(ones)
    shapes, targets = [], []
    for name, (vertices, delta) in zip(head.names, head.moved, strict=True):
        token = pxr.Tf.MakeValidIdentifier(name)
        shape = pxr.UsdSkel.BlendShape.Define(stage, f"/head/face/{token}")
        moves = np.linalg.norm(delta, axis=1) > STILL_CM
        shape.CreateOffsetsAttr(vectors(delta[moves]))
        shape.CreatePointIndicesAttr(integers(vertices[moves].astype(np.int32)))
        shapes.append(token)
        targets.append(shape.GetPath())
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)
    return mesh, shapes


def _extent(head: SparseShapes, weights: AnyFloat) -> Float32:
    """Return a box around the head in all frames [shape=(2, 3)], cm.

    Each vertex moves at most by the sum of its shapes at their greatest weights of the clip.
    """
    low = head.neutral.vertices.astype(np.float64)
    high = low.copy()
    for weight, (vertices, delta) in zip(weights.max(axis=0), head.moved, strict=True):
        if weight > 0:
            low[vertices] += weight * np.minimum(delta, 0)
            high[vertices] += weight * np.maximum(delta, 0)
    return np.stack([low.min(axis=0), high.max(axis=0)]).astype(np.float32)


def _samples(pxr: Any, attribute: Any, rows: np.ndarray[Any, Any]) -> None:
    for i, row in enumerate(np.ascontiguousarray(rows, np.float32)):
        attribute.Set(pxr.Vt.FloatArray.FromNumpy(row), i)


def _pxr() -> Any:
    try:
        import pxr  # type: ignore[import-untyped]
        from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils, Vt
    except ImportError as error:
        raise FormatError("USD needs the package usd-core: pip install 'deitalk[usd]'") from error
    assert all((Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils, Vt))
    return pxr
