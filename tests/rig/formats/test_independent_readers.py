"""Our files and packets in readers of others, from the registries: slow tests.

Khronos' gltf-validator and three.js read GLB, PyLiveLinkFace reads packets. pygltflib, usd-core and
Blender are in test_scene.py, python-osc in tests/rig/livelink.
"""

import json
import shutil
import subprocess

import numpy as np
import pytest

from rig import RigCurves, default_controls, write_curves
from rig.conversion.arkit import ARKIT_ID, arkit_controls, udp_order
from rig.livelink import make_protocol

pytestmark = pytest.mark.slow
PACKAGES = ("gltf-validator@2.0.0-dev.3.10", "three@0.187.0")
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
    return [folder / "board.glb", folder / "arkit.glb"]


def test_khronos_validator_finds_nothing(node, files):
    assert node(VALIDATOR, *files) == [[0, 0, []]] * 2


def test_three_js_plays_the_weights_between_frames(node, files, shapes):
    (frames,) = node(PLAYER, files[1], 0, 0.42, 0.78)
    for time, weights in zip((0, 0.42, 0.78), frames, strict=True):
        for name in shapes.names[:52]:
            expected = np.interp(time, shapes.times, shapes[name])
            assert weights[name[0].lower() + name[1:]] == pytest.approx(expected, abs=1e-5)


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
