"""Networks in ONNX Runtime: equal to torch at every length, and read without torch."""

import base64
import gzip
import json
import re
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.metadata import packages_distributions
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from deitalk import animate
from deitalk.config.curves import Config, ModelConfig
from deitalk.config.frontends import MelConfig
from deitalk.emotions import EMOTIONS
from deitalk.errors import CheckpointError, DeitalkError
from deitalk.live.animator import LiveAnimator
from deitalk.models.causal_model import TorchNetwork
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import GRAPH, model_folder
from deitalk.models.load import chosen_backend, load_network
from deitalk.models.onnx import OnnxNetwork, load_onnx
from deitalk.models.onnx import network as network_module
from deitalk.models.onnx.graphs import graph_digest
from deitalk.models.onnx.network import read_graph, stored_weights
from deitalk.models.onnx.rules import LIVE, WHOLE
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.research.evaluation.clip_scores import live_frames
from rig import default_controls, read_curves
from tests.deitalk.models.test_curve_model import MEL, SMALL
from tests.deitalk.postprocess.test_curve_pass import inputs, passed

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from deitalk.models.onnx.engine_graph import write_graph  # noqa: E402
from deitalk.models.onnx.tracing import OPSET  # noqa: E402

TOLERANCE = 1e-4
"""Of a control's range."""
CONTROL_FLOW = {"If", "Loop", "Scan", "DFT", "STFT", "ScatterElements", "ScatterND"}


WHISPER = {
    "kind": "whisper", "checkpoint": None, "n_mels": 16, "width": 32, "heads": 4,
    "intermediate": 48, "layers": (1, 2),
}  # fmt: skip
CAUSAL = {
    "kind": "causal_whisper", "checkpoint": None, "n_mels": 16, "width": 32, "heads": 4,
    "intermediate": 48, "layers": (1, 2),
}  # fmt: skip
SHORT = {"ahead": 1, "lead": 1, "rules_ahead": 0}


def of_frontend(frontend, **settings):
    """A network of another frontend, with random curves."""
    torch.manual_seed(7)
    chosen = SMALL | {"frontend": frontend, "saliency_frames": 31} | settings
    config = Config.model_validate({"model": chosen})
    network = DEITalk(config.model, rules=config.rules).eval()
    with torch.no_grad():
        network.decoder.output.weight.normal_(std=0.2)
        network.decoder.style.weight.normal_()
        for weight in network.lips.parameters() if network.lips else ():
            weight.normal_(std=0.05)
    return network


def in_folder(network, folder):
    """A model folder with its graph; the network as it is stored there, and that of its graph."""
    settings = Config(model=network.config, rules=network.rules)
    save_model(folder, network, settings, {})
    stored = require_model(folder, DEITalk)
    write_graph(stored, folder, folder / GRAPH)
    return stored, load_onnx(folder)


def graph_of(folder):
    """The ONNX file of a folder's graph."""
    return onnx.load_from_string(read_graph(folder / GRAPH)[1])


def used_operators(folder):
    return {node.op_type for node in graph_of(folder).graph.node}


TUNED = {
    "decoder_direct": True,
    "actor_layers": True,
    "kept_controls": ("CTRL_C_jaw.ty",),
    "captured_emotions": ("neutral", "happy"),
}
"""Parts of a fine-tuned network."""


def with_random_parts(network):
    """Numbers for the parts that a tuning adds; half the controls are taught in happy."""
    decoder, taught = network.decoder, torch.ones(5, len(network.controls))
    taught[2, ::2] = 0
    with torch.no_grad():
        decoder.kept.output.weight.normal_(std=0.2)
        decoder.kept.style.weight.normal_()
        decoder.actor_layers.weight.normal_(std=0.05)
        decoder.change.carry.copy_(torch.eye(len(network.controls)))
        decoder.change.teach(taught)
    return network


SHORTER = pytest.param("short look-ahead", marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=["plain", "tuned", SHORTER])
def causal_pair(request, tmp_path_factory):
    parts = TUNED if request.param == "tuned" else {"effort": True, "lips": True}
    frontend = CAUSAL | SHORT if request.param == "short look-ahead" else CAUSAL
    network = of_frontend(frontend, positions=False, actors=("ann", "bob"), **parts)
    network = with_random_parts(network) if parts is TUNED else network
    return in_folder(network, tmp_path_factory.mktemp("causal") / "model")


@pytest.fixture(scope="module")
def causal(causal_pair):
    return causal_pair[0]


@pytest.fixture(scope="module")
def exported_causal(causal_pair):
    return causal_pair[1]


def weights(n_frames, **amounts):
    rows = np.zeros((n_frames, len(EMOTIONS)), np.float32)
    for name, amount in amounts.items():
        rows[:, EMOTIONS.index(name)] = amount
    return rows


def assert_equal(found, expected, controls=None):
    span = (controls or default_controls()).maximum - (controls or default_controls()).minimum
    for ours, theirs in ((found.neutral, expected.neutral), (found.emotional, expected.emotional)):
        assert ours.shape == theirs.shape
        assert np.abs((ours - theirs) / span).max() <= TOLERANCE
    for ours, theirs in zip(found.tracks, expected.tracks, strict=True):
        assert (ours is None) == (theirs is None)
        if ours is not None:
            np.testing.assert_allclose(ours, theirs, atol=TOLERANCE)


@pytest.fixture(scope="module")
def whisper_pair(tmp_path_factory):
    network = of_frontend(WHISPER, actors=("ann", "bob"), effort=True, lips=True)
    with torch.no_grad():  # layers and positions that matter
        for weight in network.frontend.encoder.parameters():
            weight.normal_(std=0.2)
        network.decoder.actors.weight.normal_()
    network.frontend.measure([speechlike(4.0)])
    return in_folder(network, tmp_path_factory.mktemp("whisper") / "model")


@pytest.fixture(scope="module")
def whisper(whisper_pair):
    return whisper_pair[0]


@pytest.fixture(scope="module")
def exported_whisper(whisper_pair):
    return whisper_pair[1]


@pytest.mark.parametrize("n_frames", [1, 31, 299, 300, 301, 571])
def test_whisper_equals_torch_at_any_length(whisper, exported_whisper, n_frames):
    """One piece, two and three; the last one is short, or begins a frame before the end."""
    sound = speechlike(n_frames / 30)[: n_frames * 1600 // 3]
    rows = weights(n_frames, happy=0.6, sad=0.4)
    found = exported_whisper.read(sound, rows, "bob", gain=0.5)
    assert_equal(found, whisper.read(sound, rows, "bob", gain=0.5))
    assert not used_operators(exported_whisper.path.parent) & CONTROL_FLOW


def test_whisper_of_a_recording_in_parts_equals_torch(whisper, exported_whisper, monkeypatch):
    """Parts of 540 frames; the loudest sound, from which the floor follows, is in the first."""
    sound, rows = speechlike(64.0), weights(1920, angry=1)
    sound[16_000:] *= 1e-4
    assert exported_whisper._part % 270 == 0 == exported_whisper._before % 270
    whole = exported_whisper.read(sound, rows)
    shares = []
    monkeypatch.setattr(exported_whisper, "_part", 540)
    parts = exported_whisper.read(sound, rows, progress=shares.append)
    assert shares == [540 / 1920, 1080 / 1920, 1620 / 1920, 1]
    expected = whisper.read(sound, rows)
    assert_equal(whole, expected)
    assert_equal(parts, expected)
    monkeypatch.setattr(network_module, "loudest", lambda *sound: -10.0)
    alone = exported_whisper.read(sound, rows)
    assert np.abs(alone.emotional - expected.emotional).max() > 0.01, "the floor matters"


def test_causal_model_of_a_whole_recording_equals_torch(causal, exported_causal):
    for n_frames in (1, 40):
        sound = speechlike(n_frames / 30)[: n_frames * 1600 // 3]
        rows = weights(n_frames, happy=0.6, sad=0.4)
        for actor in ("ann", "bob"):
            found = exported_causal.read(sound, rows, actor, gain=0.5)
            assert_equal(found, causal.read(sound, rows, actor, gain=0.5))
    assert not used_operators(exported_causal.path.parent) & CONTROL_FLOW


def test_live_frames_of_streams_are_those_of_torch(causal, exported_causal):
    sounds = [speechlike(1.5), 0.3 * speechlike(1.2)]
    expected = [
        live_frames(sound, causal, emotion="angry", seed=k) for k, sound in enumerate(sounds)
    ]
    animator = LiveAnimator(exported_causal, streams=2, emotion="angry")
    parts = [animator.feed([sound[:7000] for sound in sounds])]
    parts += [animator.feed([sound[7000:] for sound in sounds]), animator.finish()]
    span = causal.controls.maximum - causal.controls.minimum
    for k in range(2):
        found = np.concatenate([part[k] for part in parts])
        assert found.shape == expected[k].shape
        assert (np.abs(found - expected[k]) / span).max() <= TOLERANCE


@pytest.mark.parametrize("pieces", [(1,) * 12, (60, 48, 22), (9, 120, 3)])
def test_any_number_of_frames_per_call_gives_those_of_torch(causal, exported_causal, pieces, rng):
    """Frames of three of five streams, and the state of all after them."""
    grid, batch, total = exported_causal.grid, 3, sum(pieces)
    windows = rng.normal(0, 0.05, (batch, total * grid.spectra, grid.length)).astype(np.float32)
    styles = rng.uniform(0, 0.5, (batch, total, len(EMOTIONS) + 2)).astype(np.float32)
    torch_network = TorchNetwork(causal)
    last, state = (network.first_state(5) for network in (torch_network, exported_causal))
    streams, parts, begin = [4, 0, 1], [], 0
    expected = torch_network.advance(windows, styles, last, streams)
    for count in pieces:
        sound = windows[:, begin * grid.spectra : (begin + count) * grid.spectra]
        given = sound, styles[:, begin : begin + count]
        parts.append(exported_causal.advance(*given, state, streams))
        begin += count
    for found, whole in zip(zip(*parts, strict=True), expected, strict=True):
        np.testing.assert_allclose(np.concatenate(found, axis=1), whole, atol=TOLERANCE)
    for found, whole in zip(state, last, strict=True):
        finite = np.maximum(whole.numpy(), np.finfo(np.float32).min)
        np.testing.assert_allclose(found, finite, atol=TOLERANCE)


@pytest.mark.parametrize("live", [False, True])
def test_rules_in_the_file_equal_torch_for_other_streams_and_frames(causal, exported_causal, live):
    ours, theirs = (network.curve_pass(live=live) for network in (exported_causal, causal))
    assert (ours.behind, ours.ahead) == (theirs.behind, theirs.ahead)
    for batch in (1, 5):
        given = inputs(batch, 30, seed=batch)
        for found, expected in zip(
            passed(ours, given, [1, 4, 25]), passed(theirs, given, [30]), strict=True
        ):
            np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("entry", [WHOLE, LIVE])
def test_rules_in_the_file_have_standard_operators(exported_causal, entry):
    content = base64.b64decode(json.loads(exported_causal.metadata[entry])["graph"])
    graph = onnx.load_from_string(content)
    onnx.checker.check_model(graph)
    assert not {node.op_type for node in graph.graph.node} & CONTROL_FLOW
    assert [entry.version for entry in graph.opset_import if not entry.domain] == [OPSET]


def test_models_for_whole_clips_are_refused_live(exported_whisper):
    with pytest.raises(CheckpointError, match="needs the whole clip; use the model live"):
        LiveAnimator(str(exported_whisper.path.parent), backend="onnx")


@pytest.fixture
def plain_folder(tiny, tmp_path, monkeypatch):
    """A model folder without a graph, and an empty cache."""
    monkeypatch.setenv("DEITALK_CACHE", str(tmp_path / "cache"))
    ignored = shutil.ignore_patterns(GRAPH)
    return Path(shutil.copytree(tiny, tmp_path / "plain", ignore=ignored))


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A model folder with its graph."""
    folder = tmp_path_factory.mktemp("models") / "tiny"
    in_folder(of_frontend(WHISPER), folder)
    return folder


def test_a_folder_without_a_graph_gets_one_in_the_cache(plain_folder, tmp_path):
    sound = speechlike(2.0)
    assert chosen_backend(plain_folder) == "torch"
    made = [
        animate(sound, "happy", sample_rate=16_000, model=plain_folder, backend=backend)
        for backend in ("torch", "onnx")
    ]
    controls = default_controls()
    span = controls.maximum - controls.minimum
    assert (np.abs(made[0].curves.values - made[1].curves.values) / span).max() <= TOLERANCE
    (kept,) = (tmp_path / "cache").glob("graph-*.gz")
    written = kept.stat().st_mtime_ns
    assert isinstance(load_network(plain_folder, backend="onnx"), OnnxNetwork)
    assert kept.stat().st_mtime_ns == written, "written once"
    assert chosen_backend(plain_folder) == "onnx"


def test_a_graph_of_other_settings_is_not_used(tiny, tmp_path):
    folder = Path(shutil.copytree(tiny, tmp_path / "tiny"))
    assert chosen_backend(folder) == "onnx"
    assert chosen_backend(folder, device="cuda") == "torch"
    assert chosen_backend(require_model(folder, DEITalk)) == "torch"
    config = folder / "config.yaml"
    config.write_text(config.read_text().replace("peak: 0.25", "peak: 0.3"))
    assert chosen_backend(folder) == "torch"


def test_a_network_is_kept_until_its_folder_changes(tiny, tmp_path):
    sound, rows = speechlike(1.0), weights(30, happy=1.0)
    folder = Path(shutil.copytree(tiny, tmp_path / "tiny"))
    network, kept = require_model(folder, DEITalk), load_onnx(folder)
    before = kept.read(sound, rows).emotional
    assert load_onnx(folder) is kept and kept.curve_pass() is kept.curve_pass()
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: load_onnx(folder).read(sound, rows), range(8)):
            np.testing.assert_array_equal(found.emotional, before)
    with torch.no_grad():
        network.decoder.output.bias += 0.25
    save_model(folder, network, Config(model=network.config, rules=network.rules), {})
    after = load_onnx(folder).read(sound, rows).emotional
    np.testing.assert_allclose(after, before + 0.25, atol=1e-3)  # weights have 16 bits


HEADER = '{"digest": "", "weights": [], "is_causal": false}'


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no gzip", "damaged"),
        (gzip.compress(b"no header"), "damaged"),
        (gzip.compress(f"{HEADER}\nno graph".encode()), "cannot be read as ONNX"),
        (gzip.compress(HEADER.replace("[]", '["jaw"]').encode()), "no weight 'jaw'"),
        (gzip.compress(bytes(network_module.limits.GRAPH_BYTES + 1)), "unpacks to more than"),
    ],
    ids=["gzip", "header", "graph", "weights", "bomb"],
)
def test_a_damaged_graph_is_one_line(content, message, plain_folder, tmp_path):
    (tmp_path / "x.gz").write_bytes(content)
    with pytest.raises(CheckpointError, match=message):
        network_module.OnnxFile(tmp_path / "x.gz", plain_folder)


def _of_a_stranger(kind):
    """A graph that a model of the hub might come with."""
    helper, floats = onnx.helper, onnx.TensorProto.FLOAT
    value = partial(helper.make_tensor_value_info, elem_type=floats, shape=[1])
    nodes, kept = [helper.make_node("Identity", ["x"], ["y"])], []
    if kind == "file":
        kept = [onnx.TensorProto(name="w", dims=[1], data_type=floats, data_location=1)]
        kept[0].external_data.add(key="location", value="/etc/hostname")
        nodes = [helper.make_node("Add", ["x", "w"], ["y"])]
    if kind == "library":
        nodes = [helper.make_node("Run", ["x"], ["y"], domain="stranger")]
    if kind == "loop":
        one = [helper.make_node("Identity", ["c"], ["d"])]
        flag = [helper.make_tensor_value_info(n, onnx.TensorProto.BOOL, []) for n in "cd"]
        count = helper.make_tensor_value_info("i", onnx.TensorProto.INT64, [])
        body = helper.make_graph(one, "body", [count, flag[0]], [flag[1]])
        nodes += [helper.make_node("Loop", ["", ""], [], body=body)]
    graph = helper.make_graph(nodes, "g", [value("x")], [value("y")], kept)
    return helper.make_model(graph).SerializeToString()


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("file", "reads other files than the weights"),
        ("library", "cannot be read as ONNX"),
        ("loop", "has loops"),
        ("other", "damaged metadata"),
    ],
)
def test_a_stranger_s_graph_runs_nothing_and_reads_nothing_else(
    kind, message, plain_folder, tmp_path
):
    content = f"{HEADER}\n".encode() + _of_a_stranger(kind)
    (tmp_path / "x.gz").write_bytes(gzip.compress(content))
    with pytest.raises(CheckpointError, match=message):
        network_module.OnnxFile(tmp_path / "x.gz", plain_folder)


@pytest.mark.parametrize(
    "settings", [{"intensity": False}, {"frontend": MEL}], ids=["intensity", "mel"]
)
def test_models_with_other_parts_have_no_graph(settings, tmp_path):
    if "frontend" in settings:
        settings = {"frontend": MelConfig(**settings["frontend"])}
    chosen = {"frontend": MelConfig(**MEL), "motion_channels": (8,), "decoder_channels": 8}
    network = DEITalk(ModelConfig(**(chosen | settings)))
    save_model(tmp_path / "mel", network, Config(model=network.config), {})
    assert chosen_backend(tmp_path / "mel") == "torch"
    with pytest.raises(CheckpointError, match="only models with a Whisper frontend"):
        write_graph(network, tmp_path / "mel", tmp_path / "x.gz")
    assert not (tmp_path / "x.gz").exists()


def test_a_file_for_other_programs_is_no_model(tmp_path):
    with pytest.raises(CheckpointError, match="is for other programs; name the model"):
        load_onnx(tmp_path / "default.onnx")


@pytest.mark.parametrize("name", ["default", "live", "small"])
def test_graphs_of_the_package_are_of_its_rules(name):
    """Else torch is imported instead of them: run ``python docs/make_graphs.py``."""
    folder = model_folder(name)
    assert read_graph(folder / GRAPH)[0].digest == graph_digest(folder)
    assert chosen_backend(name) == "onnx"
    assert (folder / GRAPH).stat().st_size < 200_000


@pytest.mark.parametrize(
    ("name", "emotion"), [("default", "angry"), ("live", "happy"), ("small", "sad")]
)
def test_embedded_models_give_the_same_curves_with_either_backend(name, emotion):
    sound = speechlike(12.0)
    made = [
        animate(sound, emotion, sample_rate=16_000, model=name, backend=backend)
        for backend in ("torch", "onnx")
    ]
    controls = default_controls()
    span = controls.maximum - controls.minimum
    for part in ("curves", "neutral"):
        ours, theirs = (getattr(each, part).values for each in made)
        assert (np.abs(ours - theirs) / span).max() <= TOLERANCE
    np.testing.assert_allclose(made[0].predicted, made[1].predicted, atol=TOLERANCE)
    assert made[0].clipped == made[1].clipped


def test_stored_weights_are_those_of_the_file_or_their_type_is_named(plain_folder, tmp_path):
    shutil.copy(plain_folder / "model.json", tmp_path)
    weights = {
        "half": np.arange(6, dtype=np.float16).reshape(2, 3), "one": np.float32([[0.5]]),
        "many": np.arange(3), "empty": np.zeros((0, 2)), "flag": np.array([True, False]),
    }  # fmt: skip
    save_file(weights, tmp_path / "model.safetensors")
    found = stored_weights(tmp_path)
    assert found.keys() == weights.keys()
    for name, value in weights.items():
        assert found[name].dtype == value.dtype
        np.testing.assert_array_equal(found[name], value)
    save_file(weights | {"odd": np.int8([1])}, tmp_path / "model.safetensors")
    with pytest.raises(CheckpointError, match="'odd' has the type I8; use one of F16, F32"):
        stored_weights(tmp_path)


def test_onnx_rejects_other_devices_and_unknown_backends():
    with pytest.raises(DeitalkError, match="runs on cpu only"):
        load_onnx("default", device="cuda")
    with pytest.raises(DeitalkError, match="'tensorflow' is unknown; use auto, torch, onnx"):
        load_network("default", backend="tensorflow")


COMMAND = """
import sys
sys.argv = {argv!r}
from deitalk.cli import main
try:
    main()
except SystemExit as exit:
    assert not exit.code, exit.code
slow = {{"torch", "onnx", "scipy", "pandas", "librosa", "transformers", "matplotlib", "safetensors.torch"}}
print("LOADED", sorted(slow & set(sys.modules)))
"""


def test_live_imports_no_torch():
    """Nor another of the slow packages."""
    sample = str(Path(__file__).parents[3] / "docs/samples/promise.flac")
    code = COMMAND.format(argv=["deitalk", "live", sample, "--seconds", "0.5", "--port", "9"])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "LOADED []"


def test_packages_of_the_small_installation_are_enough(tmp_path):
    """The list of docs/onnx.md; all other requirements of the package are hidden."""
    root = Path(__file__).parents[3]
    document = (root / "docs/onnx.md").read_text(encoding="utf-8")
    (listed,) = re.findall(r"^pip install (numpy .*)$", document, re.MULTILINE)
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = {re.split(r"[\[<>=~! ]", line)[0].lower() for line in project["dependencies"]}
    others = names - set(listed.split())
    hidden = [
        module
        for module, owners in packages_distributions().items()
        if {owner.lower() for owner in owners} & others
    ]
    assert {"torch", "transformers", "fastapi"} <= set(hidden)
    arguments = ["animate", str(root / "docs/samples/promise.flac"), "--emotion", "happy"]
    arguments += ["-o", str(tmp_path / "take")]
    code = f"import sys; sys.modules.update(dict.fromkeys({hidden!r})); sys.argv = "
    code += f"['deitalk', *{arguments!r}]; from deitalk.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(read_curves(tmp_path / "take/curves.csv")) == 262


@pytest.mark.parametrize("causal_pair", ["plain"], indirect=True)
@pytest.mark.parametrize("name", ["whisper", "causal"])
def test_the_readout_of_the_lips_matters(causal_pair, name, request, monkeypatch):
    """It moves the curves, which the graphs equal with it."""
    network = request.getfixturevalue(name)
    sound, rows = speechlike(71 / 30), weights(71, happy=0.6)
    before = network.read(sound, rows).neutral
    monkeypatch.setattr(network, "lips", None)
    assert np.abs(network.read(sound, rows).neutral - before).max() > 0.01
