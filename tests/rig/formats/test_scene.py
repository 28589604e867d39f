"""GLB and USD against independent readers: pygltflib, usd-core, Blender."""

import io
import json
import shutil
import struct
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig import RigCurves, default_controls, read_curves, rest_curves, write_curves
from rig.conversion.arkit import arkit_controls
from rig.errors import FormatError, RigError
from rig.face import build_head
from rig.face.head_pose import matrices
from rig.retarget.head_glb import arkit_pose
from rig.retarget.morph_head import srgb_to_linear, textured
from tests.errors import one_line
from tests.rig.formats.test_other_tools import NVIDIA

BOARD = default_controls()
APPLE = {name[0].lower() + name[1:] for name in NVIDIA}


def curves_of(**moves):
    """Three frames: rest, half way, full."""
    values = np.tile(BOARD.rest, (3, 1))
    for name, value in moves.items():
        column = BOARD.index(name.replace("__", "."))
        values[:, column] += np.array([0, 0.5, 1]) * (value - BOARD.rest[column])
    return RigCurves(values, BOARD.names, 25)


@pytest.fixture(scope="module")
def curves():
    return curves_of(CTRL_C_jaw__ty=0.8, CTRL_L_eye_blink__ty=1, CTRL_L_mouth_cornerPull__ty=0.7)


def posed(curves):
    """Vertices in cm of every frame, straight from the head."""
    from rig.face import build_head

    return build_head(0).pose(curves.values)


def accessor(glb, blob, index):
    """Read one accessor after the glTF specification (§3.6.2), dense or sparse."""
    a = glb.accessors[index]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[a.type]
    array = np.zeros((a.count, width), np.float32)

    def view(i, kind, count, columns):
        v = glb.bufferViews[i]
        return np.frombuffer(blob, kind, count * columns, v.byteOffset).reshape(count, columns)

    kinds = {5126: "<f4", 5125: "<u4", 5123: "<u2"}
    if a.bufferView is not None:
        array = view(a.bufferView, kinds[a.componentType], a.count, width).copy()
    if a.sparse is not None:
        indices = a.sparse.indices
        rows = view(indices.bufferView, kinds[indices.componentType], a.sparse.count, 1)[:, 0]
        array[rows] = view(a.sparse.values.bufferView, "<f4", a.sparse.count, width)
    return array


@pytest.fixture(scope="module")
def glb_path(tmp_path_factory, curves):
    path = tmp_path_factory.mktemp("glb") / "face.glb"
    write_curves(path, curves)
    return path


def test_glb_holds_the_posed_head_by_an_independent_reader(glb_path, curves):
    pygltflib = pytest.importorskip("pygltflib", reason="needs pygltflib")
    glb = pygltflib.GLTF2().load(str(glb_path))
    blob = glb.binary_blob()
    primitive = glb.meshes[0].primitives[0]
    base = accessor(glb, blob, primitive.attributes.POSITION)
    names = glb.meshes[0].extras["targetNames"]
    sampler = glb.animations[0].samplers[0]
    times = accessor(glb, blob, sampler.input)[:, 0]
    weights = accessor(glb, blob, sampler.output).reshape(len(times), len(names))
    assert times == pytest.approx([0, 0.04, 0.08])
    assert glb.animations[0].channels[0].target.path == "weights"
    shown = np.repeat(base[None], 3, axis=0).astype(np.float64)
    for k, target in enumerate(primitive.targets):
        if weights[:, k].any():
            delta = accessor(glb, blob, target["POSITION"])
            shown += weights[:, k, None, None] * delta
    expected = posed(curves) / 100
    error = np.linalg.norm(shown - expected, axis=-1)
    assert error[[0, 2]].max() < 2.1e-3  # metres; morph targets turn a jaw by straight lines
    assert np.linalg.norm(expected[2] - expected[0], axis=-1).max() > 0.02
    colours = accessor(glb, blob, primitive.attributes.COLOR_0)
    assert colours.min() >= 0 and colours.max() <= 1 and np.ptp(colours) > 0.3


def test_glb_turns_its_node_with_the_head_track(tmp_path):
    from scipy.spatial.transform import Rotation

    pygltflib = pytest.importorskip("pygltflib", reason="needs pygltflib")
    track = np.array([[0, 0, 0, 0, 0, 0], [12, -8, 5, 0.5, -0.3, 1.0]], np.float32)
    write_curves(tmp_path / "a.glb", replace(rest_curves(2), head=track))
    glb = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    blob, animation = glb.binary_blob(), glb.animations[0]
    motion = {
        channel.target.path: accessor(glb, blob, animation.samplers[channel.sampler].output)
        for channel in animation.channels
    }
    point = np.array([0.03, -0.02, 0.09])
    shown = Rotation.from_quat(motion["rotation"]).apply(point) + motion["translation"]
    # yaw to the right about -y, pitch up about -x, roll to the right about z, after each other
    turn = Rotation.from_euler("YXZ", [-12, 8, 5], degrees=True)
    joint = np.array([0, -0.04, -0.015])
    expected = turn.apply(point - joint) + joint + [0.005, -0.003, 0.01]
    np.testing.assert_allclose(shown, [point, expected], atol=1e-6)


@pytest.fixture(scope="module")
def arkit_path(tmp_path_factory):
    """Three frames: rest, an open jaw with smiles, and JawOpen 1 with MouthClose 1."""
    controls = arkit_controls()
    values = np.zeros((3, 61), np.float32)
    values[1, controls.indices(["JawOpen", "MouthSmileLeft", "MouthSmileRight"])] = 0.5, 0.8, 0.4
    values[2, controls.indices(["JawOpen", "MouthClose"])] = 1
    path = tmp_path_factory.mktemp("arkit") / "face.glb"
    write_curves(path, RigCurves(values, controls.names, 25, control_set=controls.id))
    return path


def test_glb_of_arkit_curves_has_apples_names_and_their_weights(arkit_path):
    pygltflib = pytest.importorskip("pygltflib", reason="needs pygltflib")
    glb = pygltflib.GLTF2().load(str(arkit_path))
    blob = glb.binary_blob()
    names = glb.meshes[0].extras["targetNames"]
    assert set(names[:52]) == APPLE and len(set(names)) == len(names)
    sampler = glb.animations[0].samplers[0]
    assert accessor(glb, blob, sampler.input)[:, 0] == pytest.approx([0, 0.04, 0.08])
    weights = accessor(glb, blob, sampler.output).reshape(3, len(names))
    frames = [dict(zip(names, map(float, row), strict=True)) for row in weights]
    assert [{n: w for n, w in f.items() if w and n in APPLE} for f in frames] == [
        {},
        pytest.approx({"jawOpen": 0.5, "mouthSmileLeft": 0.8, "mouthSmileRight": 0.4}),
        {"jawOpen": 1, "mouthClose": 1},
    ]
    primitive = glb.meshes[0].primitives[0]
    base = accessor(glb, blob, primitive.attributes.POSITION).astype(np.float64)
    shown = base + sum(
        weights[2, k] * accessor(glb, blob, target["POSITION"])
        for k, target in enumerate(primitive.targets)
        if weights[2, k]
    )
    closed = arkit_pose(build_head(0), {"jawOpen": 1.0, "mouthClose": 1.0}) / 100
    assert np.linalg.norm(shown - closed, axis=1).max() < 2e-4


def test_glb_has_the_head_that_is_asked_for(tmp_path):
    pygltflib = pytest.importorskip("pygltflib", reason="needs pygltflib")
    curves = RigCurves(
        np.zeros((1, 61), np.float32), arkit_controls().names, control_set=arkit_controls().id
    )
    for identity in (0, "child"):
        write_curves(tmp_path / "a.glb", curves, identity=identity)
        glb = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
        place = glb.meshes[0].primitives[0].attributes.POSITION
        found = accessor(glb, glb.binary_blob(), place)
        assert np.abs(100 * found - build_head(identity).mesh.vertices).max() < 0.03
    with pytest.raises(RigError, match="nobody"):
        write_curves(tmp_path / "b.glb", curves, identity="nobody")
    with pytest.raises(FormatError, match="does not apply to csv; it does to glb, fbx, usd"):
        write_curves(tmp_path / "a.csv", rest_curves(2), identity="child")


def test_glb_obeys_the_container_rules(glb_path):
    data = glb_path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    document = json.loads(data[20 : 20 + size])
    assert kind == b"JSON" and size % 4 == 0
    counts = {a["count"] for a in document["accessors"] if a["type"] == "VEC3"}
    assert len(counts) == 1  # every morph target has as many rows as the mesh has vertices
    n_targets = len(document["meshes"][0]["primitives"][0]["targets"])
    assert n_targets == len(document["meshes"][0]["extras"]["targetNames"]) > 185
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= document["buffers"][0]["byteLength"]
    (primitive,) = document["meshes"][0]["primitives"]
    for part in (primitive["attributes"], *primitive["targets"]):
        a = document["accessors"][part["POSITION"]]
        assert len(a["min"]) == len(a["max"]) == 3


@pytest.fixture(scope="module")
def usd_path(tmp_path_factory, curves):
    pytest.importorskip("pxr", reason="needs usd-core")
    path = tmp_path_factory.mktemp("usd") / "face.usda"
    write_curves(path, curves)
    return path


@pytest.fixture(scope="module")
def package(tmp_path_factory, curves):
    pytest.importorskip("pxr", reason="needs usd-core")
    path = tmp_path_factory.mktemp("usdz") / "face.usdz"
    write_curves(path, curves)
    return path


def test_usd_holds_the_posed_head_by_usd_core(usd_path, curves):
    from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.Open(str(usd_path))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and stage.GetTimeCodesPerSecond() == 25
    assert UsdGeom.GetStageMetersPerUnit(stage) == pytest.approx(0.01)
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    assert cache.Populate(root, Usd.PrimDefaultPredicate)
    mesh = stage.GetPrimAtPath("/head/face")
    skinning = cache.GetSkinningQuery(mesh)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    animation = cache.GetSkelQuery(binding.GetSkeleton()).GetAnimQuery()
    weights = Vt.FloatArray(animation.ComputeBlendShapeWeights(2))
    mapped = skinning.GetBlendShapeMapper().Remap(weights)
    query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(mesh))
    sub_weights, shape_indices, sub_indices = query.ComputeSubShapeWeights(mapped)
    points = Vt.Vec3fArray(UsdGeom.Mesh(mesh).GetPointsAttr().Get())
    query.ComputeDeformedPoints(
        sub_weights, shape_indices, sub_indices,
        query.ComputeBlendShapePointIndices(), query.ComputeSubShapePointOffsets(), points,
    )  # fmt: skip
    assert Gf
    error = np.linalg.norm(np.asarray(points) - posed(curves)[2], axis=-1)
    assert error.max() < 0.21  # cm


@pytest.mark.parametrize(
    "composed",
    [
        'def "a" (references = @{}@</head>) {{}}',
        'def "a" (payload = @{}@</head>) {{}}',
        '(subLayers = [@{}@])',
        'def "a" (clips = {{dictionary default = {{asset[] assetPaths = [@{}@]}}}}) {{}}',
        'def "a" (variantSets = "v") {{\nvariantSet "v" = {{\n"x" {{\n'
        'def "b" (references = @{}@</head>) {{\n}}\n}}\n}}\n}}',
    ],
)  # fmt: skip
def test_usd_that_has_other_files_opened_is_refused(usd_path, tmp_path, composed):
    """They may lie anywhere on the machine of a service."""
    text = composed.format(usd_path)
    path = tmp_path / "a.usda"
    path.write_text("#usda 1.0\n" + (text if text.startswith("(") else f"()\n{text}") + "\n")
    with one_line(FormatError, match="is composed of other files .*; flatten it to one"):
        read_curves(path, control_set=None)


def test_usd_has_the_head_that_is_asked_for(tmp_path):
    pytest.importorskip("pxr", reason="needs usd-core")
    from pxr import Usd, UsdGeom, UsdShade

    path = tmp_path / "child.usda"
    write_curves(path, rest_curves(1), identity="child")
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/head/face"))
    child = build_head("child").mesh.vertices
    assert np.abs(np.array(mesh.GetPointsAttr().Get()) - child).max() < 1e-3
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    uv = build_head("child").mesh.uv * [1, -1] + [0, 1]  # from the bottom of a picture
    assert st.GetInterpolation() == "vertex" and np.abs(np.array(st.Get()) - uv).max() < 1e-6
    skin, _ = UsdShade.MaterialBindingAPI(
        stage.GetPrimAtPath("/head/face/skin")
    ).ComputeBoundMaterial()
    surface, _, _ = skin.ComputeSurfaceSource()
    (colour,) = surface.GetInput("diffuseColor").GetConnectedSources()[0]
    assert UsdShade.Shader(colour.source).GetInput("varname").Get() == "displayColor"
    low, high = np.array(mesh.GetExtentAttr().Get())
    assert np.abs(low - child.min(axis=0)).max() < 0.1 > np.abs(high - child.max(axis=0)).max()


def test_usd_turns_its_root_with_the_head_track_and_reads_it_back(tmp_path):
    pytest.importorskip("pxr", reason="needs usd-core")
    from pxr import Gf, Usd, UsdGeom

    track = np.array([[0, 0, 0, 0, 0, 0], [12, -8, 5, 0.5, -0.3, 1.0]], np.float32)
    path = tmp_path / "head.usda"
    write_curves(path, replace(rest_curves(2), head=track))
    np.testing.assert_allclose(read_curves(path).head, track, atol=1e-6)
    stage = Usd.Stage.Open(str(path))
    matrix = UsdGeom.Xformable(stage.GetPrimAtPath("/head")).ComputeLocalToWorldTransform(1)
    rotation, translation = matrices(track)
    expected = rotation[1] @ [3, -2, 9] + translation[1]
    np.testing.assert_allclose(matrix.Transform(Gf.Vec3d(3, -2, 9)), expected, atol=1e-6)


def test_usd_extents_hold_every_point_of_every_frame_by_usd_core(usd_path, curves):
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(usd_path))
    mesh, root = (stage.GetPrimAtPath(p) for p in ("/head/face", "/head"))
    assert root.IsA(UsdSkel.Root)
    box = np.array(UsdGeom.Mesh(mesh).GetExtentAttr().Get())
    assert np.array(UsdGeom.Boundable(root).GetExtentAttr().Get()) == pytest.approx(box)
    points = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get())
    weights = UsdSkel.Animation(stage.GetPrimAtPath("/head/animation")).GetBlendShapeWeightsAttr()
    targets = UsdSkel.BindingAPI(mesh).GetBlendShapeTargetsRel().GetTargets()
    shapes = [UsdSkel.BlendShape(stage.GetPrimAtPath(target)) for target in targets]
    for frame in range(len(curves)):
        posed = points.copy()
        for weight, shape in zip(weights.Get(frame), shapes, strict=True):
            if weight:
                indices = np.array(shape.GetPointIndicesAttr().Get())
                posed[indices] += weight * np.array(shape.GetOffsetsAttr().Get())
        assert (posed >= box[0] - 1e-3).all() and (posed <= box[1] + 1e-3).all()
    assert (box[1] - box[0] < 1.5 * np.ptp(points, axis=0)).all()


def test_usd_carries_the_raw_curves_and_reads_back(usd_path, curves):
    from pxr import Usd

    stage = Usd.Stage.Open(str(usd_path))
    prim = stage.GetPrimAtPath("/head/animation")
    names = list(prim.GetAttribute("custom:mh_curveNames").Get())
    values = prim.GetAttribute("custom:mh_curveValues")
    assert len(names) == 251 and values.GetNumTimeSamples() == 3
    assert values.Get(2)[names.index("CTRL_expressions_jawOpen")] == pytest.approx(0.8)
    back = read_curves(usd_path)
    assert back.fps == 25 and back.values == pytest.approx(curves.values, abs=1e-5)


@pytest.mark.parametrize("name", ["usd_path", "package"])
def test_usd_passes_the_validators_of_usd_core(request, name):
    from pxr import Usd

    try:
        from pxr import UsdValidation
    except ImportError:
        pytest.skip("this usd-core has no UsdValidation")
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 5
    stage = Usd.Stage.Open(str(request.getfixturevalue(name)))
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetErrorAsString() for error in errors] == []


def test_usdz_has_the_colours_of_the_glb_on_every_face(package, rng):
    """At a random place of each face: vertex colour times atlas, as glTF multiplies them."""
    from PIL import Image
    from pxr import Usd, UsdGeom, UsdShade
    from scipy.ndimage import map_coordinates

    stage = Usd.Stage.Open(str(package))
    mesh = stage.GetPrimAtPath("/head/face")
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert st.GetInterpolation() == "faceVarying"
    corners = np.array(st.ComputeFlattened()).reshape(-1, 3, 2)
    covered = []
    for subset in UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets():
        material, _ = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()
        surface, _, _ = material.ComputeSurfaceSource()
        (colour,) = surface.GetInput("diffuseColor").GetConnectedSources()[0]
        texture = UsdShade.Shader(colour.source)
        assert texture.GetInput("sourceColorSpace").Get() == "sRGB"
        covered += list(subset.GetIndicesAttr().Get())
    assert sorted(covered) == list(range(len(corners)))
    with zipfile.ZipFile(package) as parts:
        (name,) = (name for name in parts.namelist() if name.endswith(".png"))
        picture = np.asarray(Image.open(io.BytesIO(parts.read(name))), np.float64) / 255

    def sampled(image, uv):
        places = [uv[:, 1] * image.shape[0] - 0.5, uv[:, 0] * image.shape[1] - 0.5]
        return np.stack([map_coordinates(image[..., k], places, order=1) for k in range(3)], -1)

    head = build_head(0)
    share = rng.dirichlet([1, 1, 1], len(corners))
    colours, place, found = (
        np.einsum("nk,nkc->nc", share, values)
        for values in (
            textured(head)[0][head.mesh.faces],
            head.mesh.uv[head.mesh.faces],
            corners,
        )
    )
    atlas = srgb_to_linear(head.mesh.maps.atlas[..., :3] / 255)
    expected = colours * sampled(atlas, place)
    shown = srgb_to_linear(sampled(picture, found * [1, -1] + [0, 1]))
    off = np.abs(shown - expected).max(axis=1)
    cards = head.slices["hair"]  # share places in the picture: all get the shade of one
    first = head.mesh.faces[:, 0]
    off = off[(first < cards.start) | (first >= cards.stop)]
    assert off.mean() < 0.02 and np.quantile(off, 0.95) < 0.06


def test_usdz_is_read_back(package, curves):
    back = read_curves(package)
    assert back.fps == 25 and back.values == pytest.approx(curves.values, abs=1e-5)


def test_absent_usd_core_names_the_install_line(tmp_path, monkeypatch, curves):
    import sys

    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(FormatError, match=r"pip install 'deitalk\[usd\]'"):
        write_curves(tmp_path / "a.usda", curves)


BLENDER = """
import bpy, numpy, sys
numpy.bool = bool  # the importer of Blender 3.4 needs it, numpy dropped it
source, out = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=source)
face = next(o for o in bpy.data.objects if o.type == "MESH")
keys = face.data.shape_keys
print("SHAPES", len(keys.key_blocks) - 1)
print("ACTION", sorted({c.data_path.split('"')[1] for c in keys.animation_data.action.fcurves})[:3] if keys.animation_data.action else None)
scene = bpy.context.scene
scene.render.fps = 25
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
camera.location, camera.rotation_euler = (0.12, -0.75, 0.0), (1.5708, 0, 0.16)
zs = [(face.matrix_world @ v.co) for v in face.data.vertices]
camera.location.z = sum(v.z for v in zs) / len(zs)
light = bpy.data.objects.new("light", bpy.data.lights.new("light", "SUN"))
light.data.energy, light.rotation_euler = 3, (0.9, 0.2, 0.4)
scene.collection.objects.link(light)
scene.camera = camera
scene.world = bpy.data.worlds.new("w")
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.device = 16, "CPU"
scene.cycles.use_denoising = False
scene.render.resolution_x = scene.render.resolution_y = 256
for frame in (0, 2):
    scene.frame_set(frame)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh = face.evaluated_get(depsgraph).to_mesh()
    height = [v.co.z for v in mesh.vertices]
    print("EXTENT", frame, min(height), max(height))
    scene.render.filepath = f"{out}/{frame}.png"
    bpy.ops.render.render(write_still=True)
"""


@pytest.mark.slow
def test_blender_imports_and_renders_the_animation(glb_path, tmp_path):
    if shutil.which("blender") is None:
        pytest.skip("needs blender")
    script = tmp_path / "look.py"
    script.write_text(BLENDER)
    command = ["blender", "--background", "--factory-startup", "--python-exit-code", "3"]
    done = subprocess.run(
        [*command, "--python", str(script), "--", str(glb_path), str(tmp_path)],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    lines = dict(line.split(" ", 1) for line in done.stdout.splitlines() if line[:6] == "SHAPES")
    assert int(lines["SHAPES"]) > 185
    pictures = [read_png(tmp_path / f"{frame}.png") for frame in (0, 2)]
    assert pictures[0].std() > 10  # not empty
    assert np.abs(pictures[1] - pictures[0]).mean() > 0.5  # and it moves


def read_png(path: Path) -> np.ndarray:
    import matplotlib.image as image

    return 255 * image.imread(path)[..., :3].astype(float)
