"""Our files and packets in readers of others, from the registries: slow tests.

Khronos' gltf-validator and three.js read GLB, PyLiveLinkFace reads packets. pygltflib, usd-core and
Blender are in test_scene.py, python-osc in tests/rig/livelink.
"""

import json
import shutil
import subprocess
import threading
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rig import RigCurves, default_controls, write_curves
from rig.conversion.arkit import ARKIT_ID, arkit_controls, udp_order
from rig.conversion.convert import convert
from rig.face.head_pose import quaternions
from rig.formats.vrma import APPLE, PRESETS
from rig.livelink import make_protocol
from rig.mesh.glb import write_container
from tests.browser import chromium

pytestmark = pytest.mark.slow
VRM = ("@pixiv/three-vrm@3.5.5", "@pixiv/three-vrm-animation@3.5.5")
PACKAGES = ("gltf-validator@2.0.0-dev.3.10", "three@0.180.0", *VRM)
VALIDATOR = """
const fs = require('fs'), validator = require('gltf-validator');
(async () => {
  for (const file of process.argv.slice(2)) {
    const { issues } = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
    console.log(JSON.stringify([issues.numErrors, issues.numWarnings, issues.messages]));
  }
})();
"""
PLAYER = """
import fs from 'fs';
import * as THREE from 'three';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
globalThis.self = globalThis;
const [file, ...times] = process.argv.slice(2);
const bytes = fs.readFileSync(file);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
new GLTFLoader().parse(buffer, '', gltf => {
  let face;
  gltf.scene.traverse(found => { if (found.isMesh) face = found; });
  const mixer = new THREE.AnimationMixer(gltf.scene);
  mixer.clipAction(gltf.animations[0]).play();
  console.log(JSON.stringify(times.map(time => {
    mixer.setTime(Number(time));
    const weights = Object.entries(face.morphTargetDictionary);
    return Object.fromEntries(weights.map(([n, i]) => [n, face.morphTargetInfluences[i]]));
  })));
}, error => { console.error(error); process.exit(1); });
"""


PAGE = """<!doctype html><script type="importmap">{"imports": {
  "three": "/node_modules/three/build/three.module.js",
  "three/addons/": "/node_modules/three/examples/jsm/",
  "three/examples/": "/node_modules/three/examples/",
  "@pixiv/three-vrm": "/node_modules/@pixiv/three-vrm/lib/three-vrm.module.js",
  "@pixiv/three-vrm-animation":
    "/node_modules/@pixiv/three-vrm-animation/lib/three-vrm-animation.module.js"}}</script>
<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { VRMLoaderPlugin } from '@pixiv/three-vrm';
import { VRMAnimationLoaderPlugin, VRMLookAtQuaternionProxy, createVRMAnimationClip }
  from '@pixiv/three-vrm-animation';
window.play = async times => {
  const loader = new GLTFLoader();
  loader.register(parser => new VRMLoaderPlugin(parser));
  loader.register(parser => new VRMAnimationLoaderPlugin(parser));
  const vrm = (await loader.loadAsync('/avatar.vrm')).userData.vrm;
  const animation = (await loader.loadAsync('/take.vrma')).userData.vrmAnimations[0];
  const proxy = new VRMLookAtQuaternionProxy(vrm.lookAt);
  proxy.name = 'proxy';
  vrm.scene.add(proxy);
  const mixer = new THREE.AnimationMixer(vrm.scene);
  mixer.clipAction(createVRMAnimationClip(animation, vrm)).play();
  return times.map(time => {
    mixer.setTime(time);
    vrm.update(0);
    const names = Object.keys(vrm.expressionManager.expressionMap);
    const head = vrm.humanoid.getRawBoneNode('head').getWorldQuaternion(new THREE.Quaternion());
    return { head: head.toArray(), gaze: [vrm.lookAt.yaw, vrm.lookAt.pitch],
      shapes: Object.fromEntries(names.map(n => [n, vrm.expressionManager.getValue(n)])) };
  });
};
window.ready = true;
</script>"""


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """Run a script of Node with the packages; returns its lines as JSON."""
    if shutil.which("npm") is None:
        pytest.skip("needs npm")
    folder = tmp_path_factory.mktemp("node")
    command = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(folder), *PACKAGES]
    if subprocess.run(command, capture_output=True, timeout=300, check=False).returncode:
        pytest.skip("needs the npm registry")

    def run(script, *arguments):
        if script is None:
            return folder
        is_module = script.startswith("\nimport")
        path = folder / f"script.{'mjs' if is_module else 'cjs'}"
        path.write_text(script)
        done = subprocess.run(
            ["node", str(path), *map(str, arguments)],
            capture_output=True, text=True, timeout=120, check=True, cwd=folder,
        )  # fmt: skip
        return [json.loads(line) for line in done.stdout.splitlines()]

    return run


@pytest.fixture(scope="module")
def shapes():
    """ARKit shapes of 21 frames at 25 fps; each rises to a value of its own."""
    controls = arkit_controls()
    values = np.outer(np.linspace(0, 1, 21), np.linspace(0.2, 0.9, 61)).astype(np.float32)
    return RigCurves(values, controls.names, 25, control_set=ARKIT_ID)


@pytest.fixture(scope="module")
def files(tmp_path_factory, shapes):
    folder = tmp_path_factory.mktemp("glb")
    board = default_controls()
    values = np.random.default_rng(0).uniform(board.minimum, board.maximum, (5, 185))
    write_curves(folder / "board.glb", RigCurves(values.astype(np.float32), board.names, 30))
    write_curves(folder / "arkit.glb", shapes)
    write_curves(folder / "board.vrma", RigCurves(values.astype(np.float32), board.names, 30))
    return [folder / "board.glb", folder / "arkit.glb"]


def test_khronos_validator_finds_nothing(node, files):
    assert node(VALIDATOR, *files) == [[0, 0, []]] * 2
    ((errors, warnings, _),) = node(VALIDATOR, files[0].with_suffix(".vrma"))
    assert (errors, warnings) == (0, 0)


def test_three_js_plays_the_weights_between_frames(node, files, shapes):
    (frames,) = node(PLAYER, files[1], 0, 0.42, 0.78)
    for time, weights in zip((0, 0.42, 0.78), frames, strict=True):
        for name in shapes.names[:52]:
            expected = np.interp(time, shapes.times, shapes[name])
            assert weights[name[0].lower() + name[1:]] == pytest.approx(expected, abs=1e-5)


def avatar(path):
    """A VRM 1 without a mesh: the bones it must have, at rest, vowels, blinks and Apple's shapes."""
    limbs = [f"{side}{bone}" for side in ("left", "right") for bone in
             ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")]  # fmt: skip
    bones = ["hips", "spine", "head", *limbs]
    nodes = [{"name": bone, "translation": [0, 0.3, 0], "children": []} for bone in bones]
    nodes[0]["children"] = [1, *range(3, len(bones))]
    nodes[1]["children"] = [2]
    shapes = {name: {} for name in APPLE}
    meta = {"name": "a", "authors": ["a"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    look_at = {"type": "bone", "offsetFromHeadBone": [0, 0.06, 0]}
    for way in ("HorizontalInner", "HorizontalOuter", "VerticalDown", "VerticalUp"):
        look_at[f"rangeMap{way}"] = {"inputMaxValue": 90, "outputScale": 10}
    vrm = {
        "specVersion": "1.0", "meta": meta, "lookAt": look_at,
        "humanoid": {"humanBones": {bone: {"node": i} for i, bone in enumerate(bones)}},
        "expressions": {"preset": {name: {} for name in PRESETS}, "custom": shapes},
    }  # fmt: skip
    document = {
        "asset": {"version": "2.0"}, "nodes": nodes, "scenes": [{"nodes": [0]}], "scene": 0,
        "extensionsUsed": ["VRMC_vrm"], "extensions": {"VRMC_vrm": vrm},
    }  # fmt: skip
    write_container(path, document, b"\0\0\0\0")


def in_chromium(folder, take, frames):
    """What three-vrm shows of a take, and how far it is off: expressions and the turn of the head."""
    write_curves(folder / "take.vrma", take)
    avatar(folder / "avatar.vrm")
    (folder / "index.html").write_text(PAGE)
    with served(folder) as address, chromium(player=False) as browser:
        tab = browser.new_page()
        complaints = []
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.goto(address)
        tab.wait_for_function("window.ready", timeout=60_000)
        shown = tab.evaluate("times => window.play(times)", [i / take.fps for i in frames])
    assert not complaints
    apple, vowels, off = convert(take, ARKIT_ID), convert(take, "vrm1"), []
    for i, frame in zip(frames, shown, strict=True):
        expected = {name: apple[name[0].upper() + name[1:]][i] for name in APPLE}
        expected |= {name: vowels[name][i] for name in PRESETS}
        off += [abs(frame["shapes"][name] - value) for name, value in expected.items()]
        turn = Rotation.from_quat(quaternions(take.head[i : i + 1])[0])
        off.append((Rotation.from_quat(frame["head"]) * turn.inv()).magnitude())
    return f"{len(expected)} expressions, head", float(max(off))


def test_three_vrm_plays_a_take_in_chromium(node):
    board = default_controls()
    values = np.random.default_rng(3).uniform(board.rest, board.maximum, (9, 185))
    head = np.zeros((9, 6), np.float32)
    head[:, :3] = np.linspace(0, 1, 9)[:, None] * [20, -10, 8]
    take = RigCurves(values.astype(np.float32), board.names, 30, head=head)
    assert in_chromium(node(None), take, range(8))[1] < 1e-3


@contextmanager
def served(folder):
    """A folder over HTTP on this machine."""
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/index.html"
        server.shutdown()


def test_py_live_link_face_reads_our_packets(shapes):
    library = pytest.importorskip("pylivelinkface", reason="needs pylivelinkface")
    protocol = make_protocol("livelink", "anna", shapes.names)
    (data,) = protocol.datagrams(900, 0.0, 60, shapes.values[10])
    is_face, face = library.PyLiveLinkFace.decode(data)
    assert is_face and face.name == "anna" and face._frames == 900 and face.fps == 60
    expected = shapes.values[10][udp_order()]
    found = [face.get_blendshape(shape) for shape in library.FaceBlendShape]
    np.testing.assert_allclose(found, expected, atol=1e-7)
    names = [shape.name for shape in library.FaceBlendShape]
    assert names[:52] == [shapes.names[i] for i in udp_order()][:52]
