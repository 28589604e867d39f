"""A table of what other programs read of our files, and how far it is off.

::

    BPY_PYTHONS=/a/bin/python python -m tests.readers [READER ...]   # absent readers are named

One take of 60 frames with a head track goes to every reader that is on this machine (npm's packages
are fetched); the errors are the largest distances from the take's own values.
"""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from rig import RigCurves, default_controls, read_curves, write_curves
from rig.conversion.arkit import ARKIT_ID, HEAD, HEAD_DEGREES, udp_order
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID
from rig.face.head_pose import quaternions
from rig.formats.blender import addon_text
from rig.formats.table import FORMATS
from rig.livelink import make_protocol
from rig.livelink.protocols import prepared
from rig.retarget.morph_head import morph_head
from rig.retarget.retarget_files import retarget_curves
from tests.rig.formats import test_independent_readers as js
from tests.rig.formats.test_scene import accessor
from tests.rig.retarget import test_bones as bones
from tests.splines import hermite

BOARD = default_controls()
FRAMES = (0, 17, 41)
IN_BLENDER = """
import importlib.util, json, os, sys
import bpy
addon_path, take, glb, usd, *frames = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
spec = importlib.util.spec_from_file_location("deitalk_blender", addon_path)
addon = importlib.util.module_from_spec(spec)
spec.loader.exec_module(addon)
addon.register()
scene = bpy.context.scene
scene.render.fps = 30
names = json.loads(open(take + "/names.json").read())
data = bpy.data.meshes.new("face")
data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
made = bpy.data.objects.new("face", data)
scene.collection.objects.link(made)
made.shape_key_add(name="Basis")
for name in names:
    made.shape_key_add(name=name).value = 0
made.select_set(True)
bpy.ops.import_anim.deitalk(filepath=take + "/a.unreal.json", start=0.0, with_sound=False)
bpy.ops.import_scene.gltf(filepath=glb)
face = next(o for o in bpy.data.objects if o.type == "MESH" and o is not made)
bpy.ops.wm.usd_import(filepath=usd)
head = next(o for o in bpy.data.objects if o.type == "MESH" and o not in (made, face))
shown = {"addon": made, "glb": face, "usd": head}
out = {"version": bpy.app.version_string, **{key: [] for key in shown}, "turn": [], "usd_turn": []}
out["pictures"] = [image.size[:] for image in bpy.data.images if image.name.startswith("head")]
for frame in map(int, frames):
    scene.frame_set(frame)
    for key, mesh in shown.items():
        out[key].append({b.name: b.value for b in mesh.data.shape_keys.key_blocks[1:]})
    for key, mesh in (("turn", face), ("usd_turn", head)):
        w, x, y, z = mesh.matrix_world.to_quaternion()
        out[key].append([x, y, z, w])
print("OUT " + json.dumps(out))
sys.stdout.flush()
os._exit(0)
"""


def take() -> RigCurves:
    """Sines of 60 frames at 30 fps, each of its own height and pace, and a turning head."""
    rng = np.random.default_rng(0)
    share = 0.5 - 0.5 * np.cos(np.outer(np.arange(60), rng.uniform(0.05, 0.3, 185)))
    values = BOARD.rest + share * (BOARD.maximum - BOARD.rest) * rng.uniform(0.3, 1, 185)
    head = np.zeros((60, 6), np.float32)
    head[:, :3] = 15 * np.sin(np.outer(np.arange(60), [0.05, 0.08, 0.03]))
    return RigCurves(values.astype(np.float32), BOARD.names, head=head)


def head_error(found: Any, curves: RigCurves, frames: Any) -> float:
    turn = Rotation.from_quat(quaternions(curves.head)[list(frames)])
    return float((Rotation.from_quat(found) * turn.inv()).magnitude().max())


def live_link(curves: RigCurves, folder: Path) -> list[Any]:
    from importlib.metadata import version

    from pylivelinkface import FaceBlendShape, PyLiveLinkFace

    protocol, worst = make_protocol("livelink", "a", ()), 0.0
    shapes = prepared(curves, protocol)
    for i, row in enumerate(shapes.values):
        _, face = PyLiveLinkFace.decode(protocol.datagrams(i, 0.0, 30, row)[0])
        found = [face.get_blendshape(shape) for shape in FaceBlendShape]
        worst = max(worst, float(np.abs(found - row[udp_order()]).max()))
    return [
        ["Live Link packets", f"PyLiveLinkFace {version('pylivelinkface')}", "61 values", worst]
    ]


def vmc(curves: RigCurves, folder: Path) -> list[Any]:
    from importlib.metadata import version

    from pythonosc.osc_packet import OscPacket

    rows = []
    for control_set in (None, "vrm1"):
        protocol, worst = make_protocol("vmc", "", (), control_set), 0.0
        shapes, turns = prepared(curves, protocol), []
        for i, row in enumerate(shapes.values):
            packets = protocol.datagrams(i, 0.0, 30, row)
            sent = [m.message for data in packets for m in OscPacket(data).messages]
            found = {m.params[0]: m.params[1] for m in sent if m.address.endswith("Blend/Val")}
            worst = max(worst, max(abs(found[n] - v) for n, v in zip(shapes.names, row)))  # noqa: B905
            turns += [m.params[4:] for m in sent if m.address.endswith("Bone/Pos")]
        # Unity's axes: x to its right, left-handed
        ours = np.array(turns) * [1, -1, -1, 1] * [1, 1, 1, 1]
        degrees = np.array([shapes[n] for n in HEAD]).T * HEAD_DEGREES
        moving = [i for i in range(len(shapes)) if degrees[i].any()]
        turn = head_error(ours, curves, moving)
        what = f"{len(shapes.names)} values, head"
        rows.append(["VMC", f"python-osc {version('python-osc')}", what, max(worst, turn)])
    return rows


def glb(curves: RigCurves, folder: Path) -> list[Any]:
    import pygltflib

    shapes = convert(curves, ARKIT_ID)
    write_curves(folder / "arkit.glb", shapes)
    file = pygltflib.GLTF2().load(str(folder / "arkit.glb"))
    blob, animation = file.binary_blob(), file.animations[0]
    names = file.meshes[0].extras["targetNames"]
    found = {
        channel.target.path: accessor(file, blob, animation.samplers[channel.sampler].output)
        for channel in animation.channels
    }
    weights = found["weights"].reshape(60, -1)
    worst = max(
        float(np.abs(weights[:, names.index(n[0].lower() + n[1:])] - shapes[n]).max())
        for n in shapes.names[:52]
    )
    turn = head_error(found["rotation"], curves, range(60))
    return [["GLB", f"pygltflib {pygltflib.__version__}", "52 shapes, head", max(worst, turn)]]


def usd(curves: RigCurves, folder: Path) -> list[Any]:
    from pxr import Usd

    write_curves(folder / "a.usda", curves)
    stage = Usd.Stage.Open(str(folder / "a.usda"))
    prim = stage.GetPrimAtPath("/head/animation")
    names = list(prim.GetAttribute("custom:mh_curveNames").Get())
    values = prim.GetAttribute("custom:mh_curveValues")
    raw = convert(curves, RAW_ID)
    worst = max(float(np.abs(np.array(values.Get(i)) - raw.values[i][[
        raw.index(n) for n in names]]).max()) for i in range(60))  # fmt: skip
    version = ".".join(map(str, Usd.GetVersion()[1:]))
    return [["USD", f"usd-core {version}", "251 raw curves", worst]]


def unity(curves: RigCurves, folder: Path) -> list[Any]:
    shapes = convert(curves, "cc4")
    write_curves(folder / "a.anim", shapes)
    text = (folder / "a.anim").read_text().splitlines()
    clip = yaml.safe_load("\n".join(line for line in text if line[:1] not in "%-"))
    worst = 0.0
    for curve in clip["AnimationClip"]["m_FloatCurves"]:
        keys = curve["curve"]["m_Curve"]
        rows = [[key[part] for key in keys] for part in ("time", "value", "inSlope", "outSlope")]
        found = hermite(*rows, shapes.times) / 100
        name = curve["attribute"].removeprefix("blendShape.")
        worst = max(worst, float(np.abs(found - shapes[name]).max()))
    return [["Unity clip", "its Hermite curves, by scipy", "140 shapes of cc4", worst]]


def blender(curves: RigCurves, folder: Path) -> list[Any]:
    write_curves(folder / "a.unreal.json", curves)
    raw, shapes = convert(curves, RAW_ID), convert(curves, ARKIT_ID)
    (folder / "names.json").write_text(json.dumps(list(raw.names)))
    write_curves(folder / "arkit.glb", shapes)
    write_curves(folder / "head.usdz", curves)
    rig = morph_head()
    weights = rig.weights(curves)
    (folder / "addon.py").write_text(addon_text())
    (folder / "inside.py").write_text(IN_BLENDER)
    rows = []
    # y up in the file is z up in Blender: a quarter turn about x
    upright = Rotation.from_euler("x", 90, degrees=True)
    for program in filter(None, os.environ.get("BPY_PYTHONS", "").split(os.pathsep)):
        files = ("addon.py", ".", "arkit.glb", "head.usdz")
        command = [program, "inside.py", *files, *map(str, FRAMES)]
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        done = subprocess.run(
            command, capture_output=True, text=True, cwd=folder, timeout=300, env=environment
        )
        line = [line for line in done.stdout.splitlines() if line.startswith("OUT ")]
        assert line, done.stderr[-2000:]
        out = json.loads(line[0][4:])
        keyed = max(abs(f[n] - raw[n][i]) for f, i in zip(out["addon"], FRAMES) for n in raw.names)  # noqa: B905
        apple = {n[0].lower() + n[1:]: n for n in shapes.names[:52]}
        played = max(
            abs(f[a] - shapes[n][i])
            for f, i in zip(out["glb"], FRAMES)  # noqa: B905
            for a, n in apple.items()
        )
        name = f"Blender {out['version']}"
        turns = []
        for key, where in (("turn", upright), ("usd_turn", Rotation.identity())):
            found = where.inv() * Rotation.from_quat(out[key])
            # the turn in the file's axes: by frame 0, at which the head is at rest
            own = found * found[0].inv() if key == "turn" else upright.inv() * found
            turns.append(head_error(own.as_quat(), curves, FRAMES))
        held = max(
            abs(f[re.sub(r"\W", "_", n)] - weights[i, k])
            for f, i in zip(out["usd"], FRAMES)  # noqa: B905
            for k, n in enumerate(rig.shapes.names)
        )
        assert out["pictures"] == [[2048, 1024]]
        rows.append(["Unreal JSON, add-on", name, "251 shape keys", keyed])
        rows.append(["GLB", name, "52 shapes, head", max(played, turns[0])])
        what = f"{len(rig.shapes.names)} shapes, head, texture"
        rows.append(["USDZ", name, what, max(held, turns[1])])
    return rows


BY_UFBX = """
import json, sys
import ufbx
file, name, frame = sys.argv[1:]
scene = ufbx.load_file(file)
shown = ufbx.evaluate_scene(scene, scene.anim, int(frame) / 30)
weights = {channel.name: channel.weight for channel in shown.blend_channels}
for node in shown.nodes:
    if node.name == name:
        m = node.node_to_world
        turn = [[getattr(column, axis) for column in (m.c0, m.c1, m.c2)] for axis in "xyz"]
print("OUT " + json.dumps([weights, turn]))
sys.stdout.flush()
"""
"""A process a frame: version 0.0.5 of the binding crashes when it evaluates twice."""


def by_ufbx(folder: Path, *wanted: str) -> Any:
    done = subprocess.run(
        [sys.executable, "by_ufbx.py", *wanted], capture_output=True, text=True, cwd=folder
    )
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("OUT ")]
    return json.loads(line[4:])


def fbx(curves: RigCurves, folder: Path) -> list[Any]:
    """FBX written by each Blender, read by ufbx and by that Blender."""
    from importlib.metadata import version

    shapes, rows = convert(curves, ARKIT_ID), []
    (folder / "by_ufbx.py").write_text(BY_UFBX)
    bones.avatar(folder / "avatar.glb", bones.NAMES["cc"])
    for program in filter(None, os.environ.get("BPY_PYTHONS", "").split(os.pathsep)):
        os.environ["BPY_PYTHON"] = program
        asked = "import bpy; print(bpy.app.version_string)"
        name = subprocess.run([program, "-c", asked], capture_output=True, text=True, check=True)
        writer = f"FBX of Blender {name.stdout.split()[0]}"
        write_curves(folder / "a.fbx", shapes)
        retarget_curves(curves, folder / "avatar.glb", folder / "b.fbx")
        turns = {}
        for file, node in (("a.fbx", "face"), ("b.fbx", "CC_Base_Head")):
            found = [by_ufbx(folder, file, node, str(frame)) for frame in FRAMES]
            # at frame 0 the head is at rest; axes may have a length
            world = Rotation.from_matrix([turn / np.linalg.norm(turn, axis=0) for _, turn in found])
            turns[node] = head_error((world * world[0].inv()).as_quat(), curves, FRAMES)
            if node == "face":
                worst = max(
                    abs(weights[n[0].lower() + n[1:]] - shapes[n][i])
                    for (weights, _), i in zip(found, FRAMES)  # noqa: B905
                    for n in shapes.names[:52]
                )
        reader = f"ufbx {version('ufbx')}"
        rows.append([writer, reader, "52 shapes, head", max(worst, turns["face"])])
        rows.append([writer, reader, "bones of neck and head", turns["CC_Base_Head"]])
        back = read_curves(folder / "a.fbx", control_set=None)
        names = shapes.names[:52]
        worst = float(np.abs(back.select(names).values - shapes.select(names).values).max())
        turn = head_error(quaternions(back.head), curves, range(60))
        rows.append([writer, "that Blender, convert", "52 shapes, head", max(worst, turn)])
    return rows


def ours(curves: RigCurves, folder: Path) -> list[Any]:
    """Every format that is read back here, in its own controls; what it lacks is counted."""
    rows = []
    for known in FORMATS:
        if known.name == "fbx" or known.name.startswith(("visemes", "rhubarb")):
            continue
        path = folder / f"own{known.suffixes[0]}"
        report = write_curves(path, curves)
        back = read_curves(path, control_set=None, fps=30)
        expected = convert(curves, back.control_set)
        told = re.search(r"does not show (\d+) moving", report.note)
        off = [float(np.abs(back[n] - expected[n]).max()) for n in back.names]
        if back.control_set == ARKIT_ID:
            off = off[:52]  # its turns of eyes and head are the shapes' and the track's
        if known.name == "glb":  # lips together: the least of two rows
            off = [e for e, n in zip(off, back.names) if "lipsTogether" not in n]  # noqa: B905
        shown = [error for error in off if error <= 1e-3]
        assert len(off) - len(shown) == int(told[1] if told else 0), (known.name, report.note)
        what = f"{len(shown)} values of {back.control_set}"
        if "head" in known.tracks:
            head = convert(back, RAW_ID).head  # ARKit has it as columns
            shown.append(head_error(quaternions(head), curves, range(60)))
            what += ", head"
        rows.append([known.name, "`read_curves`", what, max(shown)])
    return rows


def compliance(curves: RigCurves, folder: Path) -> list[Any]:
    """All validators of the library that usdchecker runs."""
    from pxr import Usd, UsdValidation

    checks = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for name in ("a.usda", "a.usdz"):
        write_curves(folder / name, curves)
        stage = Usd.Stage.Open(str(folder / name))
        issues = UsdValidation.ValidationContext(checks).Validate(stage)
        assert not issues, [issue.GetMessage() for issue in issues]
    version = ".".join(map(str, Usd.GetVersion()[1:]))
    found = f"{len(checks)} validators, 0 issues"
    return [["USD, USDZ", f"UsdValidation {version}", found, 0.0]]


def javascript(curves: RigCurves, folder: Path) -> list[Any]:
    packages = folder / "node"
    packages.mkdir()
    command = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(packages)]
    subprocess.run([*command, *js.PACKAGES], check=True, capture_output=True, timeout=300)

    def node(script: str, *arguments: Any) -> Any:
        path = packages / f"script.{'mjs' if script.startswith(chr(10) + 'import') else 'cjs'}"
        path.write_text(script)
        done = subprocess.run(
            ["node", str(path), *map(str, arguments)],
            capture_output=True, text=True, cwd=packages, check=True, timeout=600,
        )  # fmt: skip
        return [json.loads(line) for line in done.stdout.splitlines()]

    shapes = convert(curves, ARKIT_ID)
    write_curves(folder / "arkit.glb", shapes)
    write_curves(folder / "board.glb", curves)
    found = node(js.VALIDATOR, folder / "arkit.glb", folder / "board.glb")
    issues = sum(errors + warnings for errors, warnings, _ in found)
    (frames,) = node(js.PLAYER, folder / "arkit.glb", *(i / 30 for i in FRAMES))
    worst = max(
        abs(frame[n[0].lower() + n[1:]] - shapes[n][i])
        for frame, i in zip(frames, FRAMES)  # noqa: B905
        for n in shapes.names[:52]
    )
    names = [package.rpartition("@") for package in js.PACKAGES]
    return [
        ["GLB, two", f"{names[0][0]} {names[0][2]}", f"{issues} issues", 0.0],
        ["GLB", f"three.js {names[1][2]}", "52 shapes", worst],
        ["VRMA", f"three-vrm {names[2][2]}, Chromium", *js.in_chromium(packages, curves, FRAMES)],
    ]


READERS: dict[Callable[[RigCurves, Path], list[Any]], str] = {
    live_link: "pylivelinkface",
    vmc: "pythonosc",
    glb: "pygltflib",
    usd: "pxr",
    compliance: "pxr",
    unity: "yaml",
    ours: "",
    blender: "",
    fbx: "ufbx",
    javascript: "playwright",
}


def main(*wanted: str) -> None:
    sys.stdout.write("| file | reader | read back | largest error |\n|---|---|---|---|\n")
    for read, package in READERS.items():
        if wanted and read.__name__ not in wanted:
            continue
        absent = package and importlib.util.find_spec(package) is None
        if read is javascript and not (shutil.which("npm") and shutil.which("chromium")):
            absent = "npm or chromium"
        if absent:
            sys.stdout.write(f"absent: {read.__name__}\n")
            continue
        with tempfile.TemporaryDirectory() as folder:
            for file, reader, what, error in read(take(), Path(folder)):
                assert error <= 1e-3, (file, reader, what, error)
                sys.stdout.write(f"| {file} | {reader} | {what} | {error:.0e} |\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
