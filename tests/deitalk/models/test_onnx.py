"""Curve models as ONNX files: equal to torch at every length, and read without torch."""

import base64
import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk import animate
from deitalk.config.curves import Config, ModelConfig
from deitalk.config.frontends import MelConfig
from deitalk.config.rules import RulesConfig
from deitalk.emotions import EMOTIONS
from deitalk.errors import CheckpointError, DeitalkError
from deitalk.live.animator import LiveAnimator
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import embedded_models
from deitalk.models.load import load_network
from deitalk.models.onnx import OnnxNetwork, load_onnx
from deitalk.models.onnx import network as network_module
from deitalk.models.onnx.rules import LIVE, WHOLE
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.research.evaluation.clip_scores import live_frames
from rig import default_controls, read_curves
from tests.command import ran
from tests.deitalk.models.test_curve_model import MEL, SMALL
from tests.deitalk.postprocess.test_curve_pass import inputs, passed
from tests.each import each

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from deitalk.models.onnx.export import OPSET, export_onnx, operators  # noqa: E402

RIG_LAYERS = MEL | {"rig_layers": 1, "phases": 2, "tapers": 3}
TOLERANCE = 1e-4
"""Of a control's range."""
CONTROL_FLOW = {"If", "Loop", "Scan", "DFT", "STFT", "ScatterElements", "ScatterND"}


def tiny(**settings):
    """A network whose rig layers and styles change the curves."""
    torch.manual_seed(6)
    config = {"frontend": MelConfig(**RIG_LAYERS), "saliency_frames": 31} | SMALL | settings
    model = DEITalk(ModelConfig(**config)).eval()
    with torch.no_grad():
        model.decoder.output.weight.normal_(std=0.2)
        model.decoder.style.weight.normal_()
        for layer in model.frontend.rig:
            layer.project.weight.normal_(std=0.3)
    return model


WHISPER = {
    "kind": "whisper", "checkpoint": None, "n_mels": 16, "width": 32, "heads": 4,
    "intermediate": 48, "layers": (1, 2),
}  # fmt: skip
CAUSAL = {
    "kind": "causal_whisper", "checkpoint": None, "n_mels": 16, "width": 32, "heads": 4,
    "intermediate": 48, "layers": (1, 2),
}  # fmt: skip


def of_frontend(frontend, **settings):
    """A network of another frontend, with random curves."""
    torch.manual_seed(7)
    chosen = SMALL | {"frontend": frontend, "saliency_frames": 31} | settings
    config = Config.model_validate({"model": chosen})
    network = DEITalk(config.model, rules=config.rules).eval()
    with torch.no_grad():
        network.decoder.output.weight.normal_(std=0.2)
        network.decoder.style.weight.normal_()
    return network


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


@pytest.fixture(scope="module", params=["plain", "tuned"])
def causal(request):
    parts = TUNED if request.param == "tuned" else {}
    network = of_frontend(CAUSAL, positions=False, actors=("ann", "bob"), **parts)
    return with_random_parts(network) if parts else network


@pytest.fixture(scope="module")
def exported_causal(causal, tmp_path_factory):
    path = tmp_path_factory.mktemp("onnx") / "causal.onnx"
    export_onnx(causal, path, name="causal")
    return load_onnx(path)


@pytest.fixture(scope="module")
def model():
    return tiny(actors=("ann", "bob"))


@pytest.fixture(scope="module")
def exported(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("onnx") / "tiny.onnx"
    export_onnx(model, path, name="tiny")
    return load_onnx(path)


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


@each("n_frames", [1, 2, 7, 64, 65, 131])
def test_onnx_equals_torch_at_any_length(model, exported, n_frames):
    sound = speechlike(n_frames / 30)[: n_frames * 1600 // 3]
    rows = weights(n_frames, happy=0.6, sad=0.4)
    assert_equal(exported.read(sound, rows, "bob"), model.read(sound, rows, "bob"))


@pytest.fixture(scope="module")
def whisper():
    network = of_frontend(WHISPER, actors=("ann", "bob"), effort=True)
    with torch.no_grad():  # layers and positions that matter
        for weight in network.frontend.encoder.parameters():
            weight.normal_(std=0.2)
    network.frontend.measure([speechlike(4.0)])
    return network


@pytest.fixture(scope="module")
def exported_whisper(whisper, tmp_path_factory):
    path = tmp_path_factory.mktemp("onnx") / "whisper.onnx"
    export_onnx(whisper, path, name="whisper")
    return load_onnx(path)


@each("n_frames", [1, 2, 30, 31, 299, 300, 301, 330, 571, 701])
def test_whisper_equals_torch_at_any_length(whisper, exported_whisper, n_frames):
    """One piece, two and three; the last one is short, or begins a frame before the end."""
    sound = speechlike(n_frames / 30)[: n_frames * 1600 // 3]
    rows = weights(n_frames, happy=0.6, sad=0.4)
    found = exported_whisper.read(sound, rows, "bob", gain=0.5)
    assert_equal(found, whisper.read(sound, rows, "bob", gain=0.5))
    assert not set(operators(exported_whisper.path)) & CONTROL_FLOW


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


def test_damaged_parts_are_refused_in_one_line(exported_whisper, tmp_path):
    content = onnx.load(str(exported_whisper.path))
    (entry,) = (entry for entry in content.metadata_props if entry.key == "parts")
    entry.value = "[1"
    onnx.save(content, str(tmp_path / "x.onnx"))
    with pytest.raises(CheckpointError, match="damaged metadata; export the model again"):
        load_onnx(tmp_path / "x.onnx")


def test_causal_model_of_a_whole_recording_equals_torch(causal, exported_causal):
    for n_frames in (1, 40):
        sound = speechlike(n_frames / 30)[: n_frames * 1600 // 3]
        rows = weights(n_frames, happy=0.6, sad=0.4)
        for actor in ("ann", "bob"):
            found = exported_causal.read(sound, rows, actor, gain=0.5)
            assert_equal(found, causal.read(sound, rows, actor, gain=0.5))
    assert not set(operators(exported_causal.path)) & CONTROL_FLOW


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


@pytest.mark.parametrize("value", [None, "{", '{"behind": 6, "ahead": 6}'])
def test_a_file_without_its_rules_is_refused_in_one_line(exported, tmp_path, value):
    content = onnx.load(str(exported.path))
    entry = next(entry for entry in content.metadata_props if entry.key == WHOLE)
    content.metadata_props.remove(entry)
    if value is not None:
        content.metadata_props.add(key=WHOLE, value=value)
    onnx.save(content, str(tmp_path / "x.onnx"))
    with pytest.raises(CheckpointError, match="damaged metadata; export the model again"):
        animate(speechlike(0.5), sample_rate=16_000, model=tmp_path / "x.onnx")


def test_models_for_whole_clips_are_refused_live(exported):
    with pytest.raises(CheckpointError, match="needs the whole clip; use the model live"):
        LiveAnimator(str(exported.path))


def test_actors_differ_as_they_do_in_torch(model, exported):
    with torch.no_grad():
        model.decoder.actors.weight.normal_()
    sound, rows = speechlike(1.0), weights(30, angry=1)
    assert exported.actors == ("ann", "bob") == model.actors
    before = exported.read(sound, rows, "ann").emotional
    np.testing.assert_allclose(before, exported.read(sound, rows, "bob").emotional, atol=1e-6)
    model.decoder.actors.weight.data.zero_()


def test_long_recordings_are_divided_on_frames_that_lie_on_samples(exported, monkeypatch):
    """Parts of 90 frames with 60 of context, more than the tiny network remembers."""
    sound, rows = speechlike(8.0), weights(240, happy=1)
    whole = exported.read(sound, rows)
    shares = []
    monkeypatch.setattr(exported, "_part", 90)
    monkeypatch.setattr(exported, "_before", 60)
    monkeypatch.setattr(exported, "_after", 60)
    parts = exported.read(sound, rows, progress=shares.append)
    assert shares == [90 / 240, 180 / 240, 1]
    assert parts.emotional.shape == whole.emotional.shape
    assert np.abs(parts.emotional - whole.emotional).max() < 0.01


def test_metadata_describes_controls_rules_and_input(model, exported):
    about = exported.metadata
    assert json.loads(about["controls"]) == list(model.controls.names)
    assert json.loads(about["rest"]) == pytest.approx(model.controls.rest.tolist())
    assert json.loads(about["emotions"]) == list(EMOTIONS)
    assert (about["sample_rate"], about["frame_rate"], about["level_db"]) == (
        "16000",
        "30",
        "-23.0",
    )
    assert RulesConfig.model_validate(json.loads(about["rules"])) == model.rules == exported.rules
    content = onnx.load(str(exported.path))
    assert [entry.version for entry in content.opset_import if not entry.domain] == [OPSET]
    inputs = {
        i.name: [d.dim_param for d in i.type.tensor_type.shape.dim] for i in content.graph.input
    }
    assert {name: shape[0] for name, shape in inputs.items()} == {
        "sound": "S",
        "emotion": "T",
        "place": "T",
    }


def test_file_has_standard_operators_without_control_flow(exported):
    found = operators(exported.path)
    assert found["LSTM"] == 4 and found["Conv"] >= 9
    assert not set(found) & CONTROL_FLOW


def test_animate_gives_the_same_curves_with_either_backend(model, tmp_path, monkeypatch):
    monkeypatch.setenv("DEITALK_CACHE", str(tmp_path / "cache"))
    settings = Config(model=model.config, name="tiny")
    save_model(tmp_path / "tiny", model, settings, {})
    sound = speechlike(2.0)
    torch_made, onnx_made = (
        animate(sound, "happy", sample_rate=16_000, model=tmp_path / "tiny", backend=backend)
        for backend in ("torch", "onnx")
    )
    span = model.controls.maximum - model.controls.minimum
    difference = np.abs(torch_made.curves.values - onnx_made.curves.values) / span
    assert difference.max() <= TOLERANCE
    (kept,) = (tmp_path / "cache").glob("model-*.onnx")
    written = kept.stat().st_mtime_ns
    assert isinstance(load_network(tmp_path / "tiny", backend="onnx"), OnnxNetwork)
    assert kept.stat().st_mtime_ns == written, "exported once"


@each(
    ("settings", "message"),
    [({"intensity": False}, "intensity module"), ({"frontend": MEL | {"recurrence": "window"}}, "recurrence: segment")],
)  # fmt: skip
def test_export_rejects_models_with_other_parts(settings, message, tmp_path):
    if "frontend" in settings:
        settings = {"frontend": MelConfig(**settings["frontend"])}
    chosen = {
        "frontend": MelConfig(**MEL),
        "motion_channels": (8,),
        "decoder_channels": 8,
    } | settings
    with pytest.raises(CheckpointError, match=message):
        export_onnx(DEITalk(ModelConfig(**chosen)), tmp_path / "x.onnx")
    assert not (tmp_path / "x.onnx").exists()


def test_load_onnx_rejects_what_is_no_export(tmp_path, exported):
    with pytest.raises(CheckpointError, match=r"none\.onnx"):
        load_onnx(tmp_path / "none.onnx")
    (tmp_path / "text.onnx").write_text("not a graph")
    with pytest.raises(CheckpointError, match=r"text\.onnx: cannot be read as ONNX"):
        load_onnx(tmp_path / "text.onnx")
    other = onnx.load(str(exported.path))
    del other.metadata_props[:]
    onnx.save(other, str(tmp_path / "other.onnx"))
    with pytest.raises(CheckpointError, match="no exported deitalk model"):
        load_onnx(tmp_path / "other.onnx")


def test_onnx_rejects_other_devices_and_unknown_backends():
    with pytest.raises(DeitalkError, match="runs on cpu only"):
        load_onnx("default", device="cuda")
    with pytest.raises(DeitalkError, match="'tensorflow' is unknown; use torch or onnx"):
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


def run_without_torch(*arguments):
    """Run a command; none of the slow packages may be loaded at its end."""
    code = COMMAND.format(argv=["deitalk", *arguments])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "LOADED []"


def test_live_with_an_onnx_file_imports_no_torch(exported_causal):
    sample = Path(__file__).parents[3] / "docs/samples/promise.flac"
    model = str(exported_causal.path)
    run_without_torch("live", str(sample), "--model", model, "--seconds", "0.5", "--port", "9")


def test_packages_of_the_small_installation_are_enough(exported, tmp_path):
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
    arguments += ["--model", str(exported.path), "-o", str(tmp_path / "take")]
    code = f"import sys; sys.modules.update(dict.fromkeys({hidden!r})); sys.argv = "
    code += f"['deitalk', *{arguments!r}]; from deitalk.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(read_curves(tmp_path / "take/curves.csv")) == 262


@pytest.mark.slow
def test_default_in_onnx_equals_torch(tmp_path):
    if "default" not in embedded_models():
        pytest.skip("the default weights are not in this checkout")
    model = load_model("default")
    export_onnx(model, tmp_path / "default.onnx")
    sound, rows = speechlike(40.0), weights(1200, angry=0.8, surprised=0.2)
    assert_equal(load_onnx(tmp_path / "default.onnx").read(sound, rows), model.read(sound, rows))


@pytest.mark.parametrize(
    ("frontend", "settings"),
    [(WHISPER, {"effort": True}), (CAUSAL, {"positions": False, "effort": True})],
    ids=["whole", "causal"],
)
def test_readout_of_the_lips_is_in_the_graph(frontend, settings, tmp_path):
    network = of_frontend(frontend, lips=True, **settings)
    with torch.no_grad():
        for weight in network.lips.parameters():
            weight.normal_(std=0.05)
    export_onnx(network, tmp_path / "lips.onnx")
    sound, rows = speechlike(71 / 30), weights(71, happy=0.6)
    expected = network.read(sound, rows)
    assert_equal(load_onnx(tmp_path / "lips.onnx").read(sound, rows), expected)
    network.lips = None
    assert np.abs(network.read(sound, rows).neutral - expected.neutral).max() > 0.01


@pytest.mark.parametrize("option", ["-o", "--onnx"])
def test_export_to_a_name_of_onnx_writes_that_file(tmp_path, model, option):
    save_model(tmp_path / "model", model, Config(model=model.config), {})
    ran("model", "export", tmp_path / "model", option, tmp_path / "x.onnx")
    assert (tmp_path / "x.onnx").is_file()
    assert load_onnx(tmp_path / "x.onnx").controls.names == model.controls.names
