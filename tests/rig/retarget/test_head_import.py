"""A head of the user's from a GLB: its motion, names, eyes, jaw, colours, and what is refused.

The files are made of the cage of the embedded head with the shapes of ARKit, and eyes that are
meshes of their own; each test changes what it is about.
"""

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rig import RigCurves, default_controls
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import convert
from rig.errors import FormatError, MeshError, RigError
from rig.face import build_head
from rig.face.head_file import FIELDS, read_head
from rig.face.identity import identity_of, resolve_identity
from rig.face.mesh import EYE, HAIR, SKIN
from rig.mesh.glb import GlbBuilder, write_container
from rig.retarget.head_glb import SHAPES, arkit_pose
from rig.retarget.head_import import STILL_CM, import_head
from tests.command import ran, refused
from tests.errors import one_line

SOME = (
    "eyeBlinkLeft", "eyeBlinkRight", "eyeSquintLeft", "eyeSquintRight", "browInnerUp",
    "browOuterUpLeft", "browOuterUpRight", "browDownLeft", "jawOpen", "jawLeft", "mouthClose",
    "mouthFunnel", "mouthPucker", "mouthLeft", "mouthSmileLeft", "mouthSmileRight", "cheekPuff",
    "noseSneerLeft", "noseSneerRight", "tongueOut",
)  # fmt: skip
BOARD = default_controls()


class Face:
    """Meshes of a small head, in cm, as a test changes them before they are written."""

    def __init__(self) -> None:
        head, deltas = build_head(0), all_deltas()
        cage = head.slices["cage"]
        self.parts: list[dict[str, Any]] = [{
            "node": {"name": "Face"}, "points": head.neutral[cage], "faces": head.cage.faces,
            "deltas": {name: deltas[name][cage] for name in SOME},
            "material": {"name": "Skin", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1]}},
        }]  # fmt: skip
        for k, side in enumerate(("Left", "Right")):
            own = head.slices[f"eye_{'LR'[k]}"]
            faces = head.mesh.faces[(head.mesh.faces >= own.start).all(1)]
            faces = faces[(faces < own.stop).all(1)] - own.start
            self.parts.append({
                "node": {"name": f"eye{side}"}, "points": head.neutral[own], "faces": faces,
                "deltas": {}, "material": {"name": "Eye"},
            })  # fmt: skip
        self.pictures: list[bytes] = []
        self.more: dict[str, Any] = {}
        self.quantised = False

    @property
    def skin(self) -> dict[str, Any]:
        return self.parts[0]

    def rename(self, change: Callable[[str], str]) -> None:
        for part in self.parts:
            part["deltas"] = {change(name): delta for name, delta in part["deltas"].items()}

    def write(self, path: Any) -> Any:
        builder = GlbBuilder({"asset": {"version": "2.0"}, "nodes": [], "meshes": []})
        document = builder.json
        document["materials"] = [part["material"] for part in self.parts]
        for k, part in enumerate(self.parts):
            deltas, count = part["deltas"], len(part["points"])
            primitive: dict[str, Any] = {
                "attributes": {"POSITION": self._points(builder, part["points"])},
                "indices": builder.dense(np.asarray(part["faces"], np.uint32).ravel(), "SCALAR"),
                "material": k,
            }
            for name, (values, kind) in part.get("attributes", {}).items():
                index = builder.dense(values, kind)
                if name == "JOINTS_0":  # bytes
                    view = builder.view(np.asarray(values, np.uint8))
                    index = builder.accessor(
                        bufferView=view, componentType=5121, count=count, type=kind
                    )
                primitive["attributes"][name] = index
            if deltas:
                moving = [np.flatnonzero(np.abs(d).max(1)) for d in deltas.values()]
                primitive["targets"] = [
                    {"POSITION": builder.sparse(count, m, d[m])}
                    for m, d in zip(moving, deltas.values(), strict=True)
                ]
            mesh = {"primitives": [primitive], "extras": {"targetNames": list(deltas)}}
            document["meshes"].append({"name": part.get("mesh", ""), **mesh})
            document["nodes"].append({"mesh": k, **part["node"]})
        for k, data in enumerate(self.pictures):
            view = builder.view(np.frombuffer(data, np.uint8))
            document.setdefault("images", []).append({"bufferView": view, "mimeType": "image/png"})
            document.setdefault("textures", []).append({"source": k})
        for name, value in self.more.items():
            document[name] = [*document.get(name, []), *value]
        document["scenes"] = [{"nodes": list(range(len(document["nodes"])))}]
        write_container(path, document, bytes(builder.binary))
        return path

    def _points(self, builder: GlbBuilder, points: Any) -> int:
        if not self.quantised:
            return builder.dense(points, "VEC3")
        steps = np.round(np.c_[points * 500, np.zeros(len(points))]).astype("<i2")  # 8 bytes each
        index = builder.accessor(
            bufferView=builder.view(steps), componentType=5122, count=len(points), type="VEC3"
        )
        builder.json["bufferViews"][-1]["byteStride"] = 8
        return index


_DELTAS: dict[str, Any] = {}


def all_deltas() -> dict[str, Any]:
    """Displacements of the embedded head by shape, those on an open jaw as the export has them."""
    if not _DELTAS:
        head = build_head(0)
        for name in SOME:
            base = {"jawOpen": 1.0} if name in ("mouthClose", "tongueOut") else {}
            moved = arkit_pose(head, {**base, name: 1.0})
            _DELTAS[name] = (moved - (arkit_pose(head, base) if base else head.neutral)).astype(
                "f4"
            )
    return _DELTAS


@pytest.fixture
def face() -> Face:
    return Face()


@pytest.fixture(autouse=True)
def light(request, monkeypatch):
    """No baked light and a small atlas, for time, but where a test asks for them."""
    if "baked" not in request.fixturenames:
        without_light(monkeypatch)


def without_light(patch):
    from rig.retarget import head_light, head_surface

    patch.setattr(head_surface, "SIDE", 512)  # a small atlas
    patch.setattr(head_surface, "FIRST", 384)
    patch.setattr(head_light, "occlusion", lambda points, faces, opaque: np.ones((len(points), 2)))


@pytest.fixture
def baked() -> None:
    """Ask for baked light."""


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> tuple[Any, Any]:
    """Head and report of a face that no test changed."""
    with pytest.MonkeyPatch.context() as patch:
        without_light(patch)
        return imported(Face(), tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def sound_head(plain) -> dict[str, Any]:
    """Arrays of the file of an imported head."""
    with np.load(plain[1].path) as stored:
        return dict(stored)


def imported(face: Face, folder: Any) -> tuple[Any, Any]:
    """Head and report of a face."""
    report = import_head(face.write(folder / "mine.glb"), folder / "mine.npz")
    return build_head(identity_of(str(folder / "mine.npz"))), report


def posed(head: Any, weights: dict[str, float]) -> Any:
    """Pose of weights of ARKit's shapes, as a capture has them."""
    controls = arkit_controls()
    values = controls.rest.copy()
    for name, weight in weights.items():
        values[controls.index(name)] = weight
    curves = RigCurves(values[None], controls.names, control_set=ARKIT_ID)
    return head.pose(convert(curves, BOARD.id).select(BOARD.names).values[0])


def moving(face: Face) -> Any:
    """Vertices of the skin that some shape moves, in their order: the others come last."""
    return np.abs(np.stack(list(face.skin["deltas"].values()))).max((0, 2)) > STILL_CM


@pytest.mark.parametrize("name", [name for name in SOME if name not in ("mouthClose", "tongueOut")])
def test_a_captured_shape_is_the_users_shape(plain, face, name):
    head, _ = plain
    moved = (posed(head, {name: 1.0}) - head.neutral)[head.slices["skin"]]
    expected = face.skin["deltas"][name][moving(face)]
    assert np.abs(moved - expected).max() < 0.035  # cm, of a head that is fitted to another


def test_shapes_add_up_and_lips_close_over_an_open_jaw(plain, face):
    head, _ = plain
    deltas, skin = {n: d[moving(face)] for n, d in face.skin["deltas"].items()}, head.slices["skin"]
    weights = {"mouthSmileLeft": 0.7, "eyeBlinkRight": 0.5, "jawLeft": 0.3, "browInnerUp": 0.8}
    moved = (posed(head, weights) - head.neutral)[skin]
    assert np.abs(moved - sum(w * deltas[n] for n, w in weights.items())).max() < 0.02
    shut = (posed(head, {"jawOpen": 0.8, "mouthClose": 0.8}) - head.neutral)[skin]
    shut -= 0.8 * (deltas["jawOpen"] + deltas["mouthClose"])
    assert np.abs(shut).max() < 0.03  # as above


def test_other_spellings_are_the_same_head(plain, face, tmp_path):
    def change(name):
        sided = name.replace("Left", "_L").replace("Right", "_R") if name[:3] != "jaw" else name
        return f"Head|Mesh.{sided.upper()}"

    face.rename(change)
    import_head(face.write(tmp_path / "b.glb"), tmp_path / "b.npz")
    first, second = (read_head(path) for path in (plain[1].path, tmp_path / "b.npz"))
    for name in FIELDS:
        assert np.array_equal(first[name], second[name]), name


@pytest.mark.parametrize(("scale", "degrees"), [(0.01, 180), (10, -30)])
def test_unit_place_and_facing_do_not_count(plain, face, tmp_path, scale, degrees):
    first, _ = plain
    angle = np.radians(degrees)
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    for part in face.parts:
        part["points"] = scale * part["points"] @ turn.T + np.array([3.0, 170, -8]) * scale
        part["deltas"] = {n: scale * d @ turn.T for n, d in part["deltas"].items()}
    second, _ = imported(face, tmp_path)
    assert np.abs(first.neutral - second.neutral).max() < 0.01
    jaw = {"jawOpen": 1.0}
    assert np.abs(posed(first, jaw) - posed(second, jaw)).max() < 0.02


def test_head_of_the_embedded_head_lies_on_it(plain, face):
    head, report = plain
    assert np.abs(head.neutral[head.slices["skin"]] - face.skin["points"][moving(face)]).max() < 0.3
    assert not any("unlike" in note for note in report.notes)


def test_meshes_are_joined(plain, face, tmp_path):
    whole, _ = plain
    skin, low = face.skin, face.skin["points"][:, 1] < -4
    is_low = low[skin["faces"]].all(1)
    cut = {"node": {"name": "Jaw"}, "material": skin["material"]}
    face.parts.append({**skin, **cut, "faces": skin["faces"][is_low]})
    face.parts[0] = {**skin, "faces": skin["faces"][~is_low]}
    head, _ = imported(face, tmp_path)
    jaw = {"jawOpen": 1.0}
    for pose in ({}, jaw):
        ours, theirs = (
            np.unique(np.round(posed(h, pose)[h.slices["skin"]] / 0.02), axis=0)
            for h in (whole, head)
        )
        assert abs(len(ours) - len(theirs)) < 0.1 * len(ours)
    assert len(np.unique(head.mesh.weld)) < len(head.mesh.weld)  # the cut is no edge


def test_quantised_files_are_read(plain, face, tmp_path):
    first, _ = plain
    face.quantised = True
    face.more["extensionsRequired"] = ["KHR_mesh_quantization"]
    for part in face.parts:
        part["node"]["scale"] = [0.002] * 3
        part["deltas"] = {name: 500 * delta for name, delta in part["deltas"].items()}
    second, _ = imported(face, tmp_path)
    assert np.abs(first.neutral - second.neutral).max() < 0.01


def test_eyes_of_their_own_meshes_turn(plain):
    head, report = plain
    values = BOARD.rest.copy()
    values[BOARD.index("CTRL_C_eye.tx")] = 0.5
    values[BOARD.index("CTRL_C_eye_parallelLook.ty")] = 1
    pose = head.pose(values)
    ours = build_head(0)
    for k, side in enumerate("LR"):
        part = head.slices[f"eye_{side}"]
        assert np.abs(head.eyes[k, :3] - ours.eyes[k, :3]).max() < 0.3
        before, after = (p[part] - head.eyes[k, :3] for p in (head.neutral, pose))
        cosine = (before * after).sum(1) / np.linalg.norm(before, axis=1) ** 2
        assert np.degrees(np.arccos(cosine.min())) == pytest.approx(20, abs=0.5)
    assert not any("gaze" in note for note in report.notes)


@pytest.mark.parametrize("way", ["shapes", "joints", "one mesh", "none"])
def test_gaze_by_shapes_bones_or_not_at_all(face, tmp_path, way):
    left, right = face.parts[1:]
    if way == "shapes":
        for part in (left, right):
            for look in ("eyeLookInLeft", "eyeLookInRight", "eyeLookOutLeft", "eyeLookOutRight"):
                part["deltas"][look] = np.full((len(part["points"]), 3), 0.2, np.float32)
    elif way == "joints":
        for k, part in enumerate((left, right)):
            part["node"] = {"name": "Body", "skin": 0}
            joints = np.zeros((len(part["points"]), 4))
            joints[:, 0] = k
            share = np.eye(4)[np.zeros(len(joints), int)]
            part["attributes"] = {"JOINTS_0": (joints, "VEC4"), "WEIGHTS_0": (share, "VEC4")}
        face.more = {"skins": [{"joints": [3, 4]}],
                     "nodes": [{"name": "LeftEye"}, {"name": "CC_Base_R_Eye"}]}  # fmt: skip
    elif way == "one mesh":
        count = len(left["points"])
        left["points"] = np.concatenate([left["points"], right["points"]])
        left["faces"] = np.concatenate([left["faces"], right["faces"] + count])
        left["node"] = {"name": "Wolf3D_Eyes"}
        del face.parts[2]
    else:
        for part in (left, right):
            part |= {"node": {"name": "Round thing"}, "material": {}}
    head, report = imported(face, tmp_path)
    sizes = [head.slices[f"eye_{s}"].stop - head.slices[f"eye_{s}"].start for s in "LR"]
    assert (min(sizes) > 0) == (way in ("joints", "one mesh"))
    assert any("the gaze is not shown" in note for note in report.notes) == (way == "none")


def test_a_bone_opens_the_jaw_where_no_shape_does(face, tmp_path):
    skin = face.skin
    for name in ("jawOpen", "mouthClose", "tongueOut"):
        del skin["deltas"][name]
    is_jaw = skin["points"][:, 1] < -7
    joints = np.zeros((len(is_jaw), 4))
    weights = np.zeros((len(is_jaw), 4))
    weights[:, 0] = is_jaw
    skin["attributes"] = {"JOINTS_0": (joints, "VEC4"), "WEIGHTS_0": (weights, "VEC4")}
    skin["node"]["skin"] = 0
    face.more = {"skins": [{"joints": [3]}],
                 "nodes": [{"name": "JawRoot", "translation": [0, -3, 0]}]}  # fmt: skip
    head, report = imported(face, tmp_path)
    assert any("bone opens the jaw" in note for note in report.notes)
    moved = (posed(head, {"jawOpen": 1.0}) - head.neutral)[head.slices["skin"]]
    is_jaw = is_jaw[moving(face) | is_jaw]
    assert moved[is_jaw, 1].min() < -1.5 and np.abs(moved[~is_jaw]).max() < 0.05


def picture(*colours: tuple[int, ...]) -> bytes:
    """A PNG of vertical stripes."""
    rows = np.array([colours], np.uint8).repeat(16, 1).repeat(32, 0)
    stream = io.BytesIO()
    Image.fromarray(rows).save(stream, "PNG")
    return stream.getvalue()


def seen(head: Any, part: slice) -> Any:
    """Mean sRGB colour of a part's vertices under their texture."""
    mesh, side = head.mesh, len(head.mesh.maps.atlas)
    u, v = np.clip(mesh.uv[part] * side, 0, side - 1).astype(int).T
    return (mesh.maps.atlas[v, u, :3] * mesh.colors[part]).mean(0)


@pytest.mark.parametrize("change", [None, {"offset": [7.5, 3]}])
def test_textures_and_factors_are_the_colours(face, tmp_path, change):
    count = len(face.skin["points"])
    face.pictures = [picture((250, 0, 0), (0, 250, 0)), picture((0, 0, 250))]
    texture: dict[str, Any] = {"index": 0}
    if change:
        texture["extensions"] = {"KHR_texture_transform": change}
    face.skin["material"]["pbrMetallicRoughness"] = {"baseColorTexture": texture}
    face.skin["attributes"] = {"TEXCOORD_0": (np.full((count, 2), 0.25), "VEC2")}
    eyes = {"TEXCOORD_0": (np.full((len(face.parts[1]["points"]), 2), 0.5), "VEC2")}
    for part in face.parts[1:]:
        base = {"baseColorTexture": {"index": 1}, "baseColorFactor": [1, 1, 0.25, 1]}
        part["material"]["pbrMetallicRoughness"] = base
        part["attributes"] = eyes
    head, report = imported(face, tmp_path)
    expected = (0, 250, 0) if change else (250, 0, 0)
    assert np.abs(seen(head, head.slices["skin"]) - expected).max() < 12
    assert seen(head, head.slices["eye_L"])[2] == pytest.approx(250 * 0.537, abs=12)  # sRGB of .25
    assert not any("colour" in note or "texture" in note for note in report.notes)
    kinds = head.mesh.kind
    assert (kinds[head.slices["skin"]] == SKIN).all() and (kinds[head.slices["eye_R"]] == EYE).all()


@pytest.mark.parametrize(("change", "note"), [
    ({"uri": "skin.png"}, "in another file"),
    ({"broken": True}, "cannot be read"),
    ({"plain": True}, "a tone of skin is guessed"),
    ({"tiles": True}, "repeats too often"),
])  # fmt: skip
def test_what_of_the_colours_is_lost_is_said(face, tmp_path, change, note):
    count = len(face.skin["points"])
    face.pictures = [picture((250, 0, 0))]
    face.skin["material"]["pbrMetallicRoughness"] = {"baseColorTexture": {"index": 0}}
    uv = np.random.default_rng(0).random((count, 2)) * (100 if "tiles" in change else 1)
    face.skin["attributes"] = {"TEXCOORD_0": (uv, "VEC2")}
    if "broken" in change:
        face.pictures = [b"\x89PNG no picture"]
    if "plain" in change:
        del face.skin["material"]["pbrMetallicRoughness"]
    if "uri" in change:
        face.skin["material"]["pbrMetallicRoughness"]["baseColorTexture"]["index"] = 1
        face.more = {"images": [change], "textures": [{"source": 1}]}
    _, report = imported(face, tmp_path)
    assert any(note in each for each in report.notes), report.notes


def test_pieces_with_holes_are_hair_and_whole_ones_of_the_same_material_are_not(face, tmp_path):
    face.pictures = [picture((90, 60, 40, 255), (90, 60, 40, 0))]
    material = {"name": "all", "alphaMode": "MASK",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}  # fmt: skip
    left, right = face.parts[1:]
    for part, place in ((face.skin, 0.25), (left, 0.75), (right, 0.25)):
        part |= {"material": material, "node": {"name": "thing"}}
        part["attributes"] = {"TEXCOORD_0": (np.full((len(part["points"]), 2), place), "VEC2")}
    head, _ = imported(face, tmp_path)
    kinds = head.mesh.kind
    assert (kinds[head.slices["skin"]] == SKIN).all()
    assert (kinds == HAIR).sum() == len(left["points"])


def test_names_that_are_missing_or_unknown_are_listed(face, tmp_path):
    face.skin["deltas"]["wiggle"] = face.skin["deltas"]["jawOpen"]
    _, report = imported(face, tmp_path)
    assert f"{52 - len(SOME)} of ARKit's 52 shapes are missing" in report.notes[0]
    assert "wiggle" in report.notes[1] and set(SOME) <= set(SHAPES)


def test_a_body_is_cut_off_and_named(face, tmp_path):
    feet = np.array([[0, -150, 0], [5, -150, 0], [0, -150, 5.0]])
    face.parts.append({"node": {"name": "Feet"}, "points": feet, "faces": [[0, 1, 2]],
                       "deltas": {}, "material": {}})  # fmt: skip
    head, report = imported(face, tmp_path)
    assert any("more than 40 cm" in note for note in report.notes)
    assert head.neutral[:, 1].min() > -41


def without_names(face: Face) -> None:
    face.rename(lambda name: f"key {sorted(SOME).index(name)}")


def few_places(face: Face) -> None:
    deltas = face.skin["deltas"]
    face.skin["deltas"] = {name: deltas[name] for name in ("jawOpen", "mouthPucker", "mouthFunnel")}


def many_vertices(face: Face) -> None:
    skin, count = face.skin, len(face.skin["points"])
    skin["points"] = np.tile(skin["points"], (15, 1))
    skin["faces"] = np.concatenate([skin["faces"] + k * count for k in range(15)])
    skin["deltas"] = {name: np.tile(delta, (15, 1)) for name, delta in skin["deltas"].items()}


def compressed(extension: str) -> Callable[[Face], None]:
    def change(face: Face) -> None:
        face.more["extensionsRequired"] = [extension]

    return change


@pytest.mark.parametrize(("change", "words"), [
    (without_names, "has a known name"),
    (few_places, "cannot be laid over a face"),
    (many_vertices, "decimate it"),
    (compressed("KHR_draco_mesh_compression"), "export it again without compression"),
    (compressed("EXT_meshopt_compression"), "export it again without compression"),
])  # fmt: skip
def test_heads_that_cannot_be_used_are_refused_in_one_line(face, tmp_path, change, words):
    change(face)
    with one_line((FormatError, MeshError), match=words):
        imported(face, tmp_path)
    assert not (tmp_path / "mine.npz").exists()


@pytest.mark.parametrize(("name", "value"), [
    ("points", None),
    ("points", np.zeros((3, 3), np.int16)),
    ("faces", np.full((4, 3), 65535, np.uint16)),
    ("weld", "past"),
    ("columns", "past"),
    ("count", "less"),
    ("stops", np.array([5, 4, 4, 4, 9])),
    ("eyes", np.full((2, 4), np.nan, np.float32)),
    ("step", np.float32(np.nan)),
    ("kind", "past"),
    ("atlas", np.zeros(9, np.uint8)),
])  # fmt: skip
def test_damaged_head_files_are_refused_in_one_line(sound_head, tmp_path, name, value):
    arrays = dict(sound_head)
    if value is None:
        del arrays[name]
    elif isinstance(value, str):
        arrays[name] = (
            arrays[name] - 1
            if value == "less"
            else np.full_like(arrays[name], 60000 % 256 if name == "kind" else 60000)
        )
    else:
        arrays[name] = value
    np.savez(tmp_path / "bad.npz", **arrays)
    with one_line(RigError, "picture 'atlas'" if name == "atlas" else "bad.npz"):
        build_head(identity_of(str(tmp_path / "bad.npz"))).mesh  # noqa: B018


def test_services_read_no_path(face, tmp_path):
    imported(face, tmp_path)
    with one_line(RigError, match="is unknown"):
        resolve_identity(str(tmp_path / "mine.npz"))


def test_a_new_file_of_the_same_name_is_read(face, tmp_path):
    first, _ = imported(face, tmp_path)
    del face.parts[2]
    second, _ = imported(face, tmp_path)
    assert len(second.neutral) < len(first.neutral)


def test_commands_show_the_head(face, tmp_path, baked):
    """Baked light reaches the skin, and less of it the back of the mouth; exports hold the head."""
    from rig.mesh.glb_reader import read_glb

    path = face.write(tmp_path / "mine.glb")
    ran("face", "import", path)
    assert "exists" in refused("face", "import", path)
    head = build_head(identity_of(str(tmp_path / "mine.npz")))
    light = head.mesh.light[head.slices["skin"], 0]
    assert light.max() > 0.6 and light.min() < 0.4
    ran("face", "export", "--identity", tmp_path / "mine.npz", "-o", tmp_path / "out.glb")
    again = read_glb(tmp_path / "out.glb")
    assert "exists" in refused("face", "export", "-o", tmp_path / "out.glb")
    assert "h.fbx" in refused("face", "export", "-o", tmp_path / "h.fbx")
    assert np.abs(again.neutral.vertices * 100 - head.neutral).max() < 0.01
    curves = RigCurves(np.tile(BOARD.rest, (3, 1)), BOARD.names)
    from rig import write_curves

    write_curves(tmp_path / "c.csv", curves)
    ran("convert", tmp_path / "c.csv", tmp_path / "take.glb", "--identity", tmp_path / "mine.npz")
    assert len(read_glb(tmp_path / "take.glb").neutral.vertices) == len(head.neutral)
    assert "does not exist" in refused(
        "face", "export", "--identity", "no.npz", "-o", tmp_path / "x.glb"
    )
