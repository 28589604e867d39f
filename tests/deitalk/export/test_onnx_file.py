"""ONNX files for other programs: finished curves equal to those of `animate` and of live voices."""

import json
import os
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from deitalk import animate
from deitalk.audio.frames import frame_count
from deitalk.audio.load import load_audio
from deitalk.emotions import LABELS, IntensityCurve
from deitalk.errors import CheckpointError
from deitalk.export import onnx_file as module
from deitalk.export.finished import FinishedClip
from deitalk.export.finished_live import FinishedLive
from deitalk.live.animator import LiveAnimator
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.tracing import OPSET
from deitalk.postprocess.tracks import N_MOTION, N_VARIANTS
from tests.command import ran
from tests.deitalk.models.test_onnx import CAUSAL, CONTROL_FLOW, WHISPER, of_frontend

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")
from deitalk.export.onnx_file import export_onnx, operators  # noqa: E402

TOLERANCE = 1e-4
"""Of a control's range."""
REST = 0.5
"""Share of the expression that stays in silence."""


LIVE = "live", pytest.param("small", marks=pytest.mark.slow)
"""Embedded models of voices that have not ended."""


def opened(path):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = 1, 3
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """File of an embedded model by its name, written once."""
    folder = tmp_path_factory.mktemp("finished")

    @cache
    def write(name):
        export_onnx(load_model(name), folder / f"{name}.onnx", name=name)
        return folder / f"{name}.onnx"

    return write


@pytest.fixture(scope="module")
def clip(exported):
    return opened(exported("default"))


@pytest.fixture(scope="module", params=LIVE)
def voices(exported, request):
    """Name of a causal model, and its file."""
    return request.param, opened(exported(request.param))


def one_hot(emotion, *shape):
    rows = np.zeros((*shape, len(LABELS)), np.float32)
    rows[..., LABELS.index(emotion)] = 1
    return rows


def finished(session, sound, emotion, curve=None, factor=1.0, ways=None):
    """Curves, neutral curves and predicted intensity of a recording."""
    total = frame_count(len(sound))
    shown = np.full(total, -1) if curve is None else curve
    given = {
        "sound": np.asarray(sound, np.float32),
        "emotion": one_hot(emotion, total),
        "intensity": np.stack((shown, np.full(total, factor), np.full(total, REST))),
        "variants": np.zeros((total, N_VARIANTS + 1)) if ways is None else ways,
        "motion": np.zeros((total, N_MOTION), np.float32),
    }
    return session.run(None, {name: array.astype(np.float32) for name, array in given.items()})


def assert_same(found, made, controls):
    span = controls.maximum - controls.minimum
    curves, neutral, predicted = found
    assert (np.abs(curves - made.curves.values) / span).max() <= TOLERANCE
    assert (np.abs(neutral - made.neutral.values) / span).max() <= TOLERANCE
    np.testing.assert_allclose(predicted, made.predicted, atol=TOLERANCE)


def recorded(name):
    return np.array(load_audio(f"docs/samples/{name}.flac").waveform)


def vowel(seconds, pitch=120.0):
    """A sound that a voice holds."""
    times = np.arange(round(16_000 * seconds)) / 16_000
    waves = [np.sin(2 * np.pi * k * pitch * times) / k for k in range(1, 12)]
    return (0.08 * np.sum(waves, axis=0)).astype(np.float32)


@cache
def sounds():
    """Recordings of every kind that the rules tell apart."""
    speech = recorded("promise")
    still = np.zeros(5_000, np.float32)
    noise = np.random.default_rng(0).normal(0, 0.01, 48_000).astype(np.float32)
    silence = np.zeros(24_000, np.float32)
    return {
        "cut in speech": speech[8_000:40_000],
        "one frame": speech[20_000:20_400],
        "under 0.35 s": speech[20_000:25_000],
        "one more sample": speech[8_000:24_001],
        "a pause": np.concatenate((speech[8_000:32_000], silence, silence, speech[60_000:84_000])),
        "a short end": np.concatenate((speech[8_000:40_000], silence[:5_000])),
        "a long end": np.concatenate((speech[8_000:40_000], silence, silence)),
        "noise": noise,
        "silence": silence,
        "speech in noise": speech[:48_000] + noise,
        "quiet": 0.003 * speech[:48_000],
        "a held vowel": np.concatenate((speech[8_000:24_000], vowel(2.0), speech[24_000:40_000])),
        "held sounds": np.concatenate((vowel(1.2), still, vowel(0.8), still, still, vowel(2, 200))),
        "offset": 0.05 + speech[:48_000],
        "many pieces": np.concatenate((speech, 0.2 * speech, speech[:60_000])),
    }


@pytest.mark.parametrize("kind", sounds())
def test_finished_curves_of_a_recording_are_those_of_animate(kind, clip, default):
    sound = sounds()[kind]
    emotion = ("angry", "disgust", "happy")[[*sounds()].index(kind) % 3]
    made = animate(sound, emotion, sample_rate=16_000, model=default, life="off", variant="plain")
    assert_same(finished(clip, sound, emotion), made, default.controls)


def test_an_intensity_curve_and_a_factor_are_applied(clip, default):
    sound = recorded("amiable")[:48_000]
    times = np.arange(frame_count(len(sound))) / 30
    curve = 0.5 + 0.5 * np.sin(times)
    made = animate(
        sound, "sad", sample_rate=16_000, model=default, life="off", variant="plain", intensity=0.7,
        intensity_curve=IntensityCurve(times, curve),
    )  # fmt: skip
    assert_same(finished(clip, sound, "sad", curve, 0.7), made, default.controls)
    made = animate(
        sound, "sad", sample_rate=16_000, model=default, life="off", variant="plain", intensity=1.5
    )
    assert_same(finished(clip, sound, "sad", factor=1.5), made, default.controls)


def test_the_graph_equals_its_module_in_torch(clip, default):
    """Also where motion is given."""
    sound, total = recorded("promise")[:40_000], 75
    rng = np.random.default_rng(1)
    given = {
        "sound": sound,
        "emotion": rng.dirichlet(np.ones(len(LABELS)), total).astype(np.float32),
        "intensity": rng.uniform(-0.5, 1, (3, total)).astype(np.float32),
        "variants": rng.uniform(0, 0.2, (total, N_VARIANTS + 1)).astype(np.float32),
        "motion": rng.uniform(0, 1, (total, N_MOTION)).astype(np.float32),
    }
    module = FinishedClip(default).eval()
    with torch.no_grad():
        expected = module(*(torch.from_numpy(array) for array in given.values()))
    still = clip.run(None, given | {"motion": 0 * given["motion"]})
    found = clip.run(None, given)
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs.numpy(), atol=TOLERANCE)
    assert np.abs(found[0] - still[0]).max() > 0.1, "motion is played"


def spoken(session, sounds, emotions, factors):
    """Curves of streams side by side [shape=(B, T, C)], by docs/onnx.md."""
    about = session.get_modelmeta().custom_metadata_map
    window, before, behind, size = (
        json.loads(about[name]) for name in ("window", "before", "behind", "state")
    )
    batch, total = len(sounds), max(frame_count(len(sound)) for sound in sounds)
    longest = max(map(len, sounds))
    padded = np.zeros((batch, before + longest + window + 16_000), np.float32)
    for row, sound in zip(padded, sounds, strict=True):
        row[before : before + len(sound)] = sound
    state = np.zeros((batch, size), np.float32)
    rows = []
    for frame in range(total + behind):
        start = frame * 16_000 // 30
        given = {
            "sound": padded[:, start : start + window],
            "emotion": np.stack([one_hot(emotion) for emotion in emotions]),
            "intensity": np.array([(factor, REST) for factor in factors], np.float32),
            "variants": np.zeros((batch, N_VARIANTS + 1), np.float32),
            "motion": np.zeros((batch, N_MOTION), np.float32),
            "state": state,
        }
        curves, _, state = session.run(None, given)
        rows.append(curves)
    return np.stack(rows[behind:], axis=1)


def test_finished_frames_of_live_streams_are_those_of_the_animator(voices):
    """Speech, a quiet voice that pauses, and noise, each in its emotion."""
    speech = recorded("promise")
    pause = np.zeros(30_000, np.float32)
    sounds = [
        np.concatenate((speech[8_000:32_000], vowel(1.5), pause[:9_000], vowel(0.6))),
        np.concatenate((0.1 * speech[30_000:50_000], pause, speech[8_000:24_000])),
        np.random.default_rng(0).normal(0, 0.02, 40_000).astype(np.float32),
    ]
    emotions, factors = ("happy", "disgust", "neutral"), (1.0, 0.6, 1.3)
    name, session = voices
    found = spoken(session, sounds, emotions, factors)
    network = load_model(name)
    span = network.controls.maximum - network.controls.minimum
    for k, (sound, emotion, factor) in enumerate(zip(sounds, emotions, factors, strict=True)):
        animator = LiveAnimator(network, emotion, intensity=factor, life="off", variant="plain")
        expected = np.concatenate((animator.feed(sound), animator.finish()))
        off = np.abs(found[k, : len(expected)] - expected) / span
        assert off.max() <= TOLERANCE, (k, off.max())


def test_the_live_graph_equals_its_module_in_torch(voices):
    """Streams in any number, at any frame of their own; motion too."""
    name, session = voices
    module = FinishedLive(load_model(name)).eval()
    rng = np.random.default_rng(2)
    states = [np.zeros((1, module.first(1).shape[1]), np.float32)]
    for _ in range(8):
        given = [
            rng.normal(0, 0.1, (1, module.window)).astype(np.float32), one_hot("sad", 1),
            np.ones((1, 2), np.float32),
            np.zeros((1, N_VARIANTS + 1), np.float32), rng.uniform(0, 1, (1, N_MOTION)).astype(np.float32), states[-1],
        ]  # fmt: skip
        with torch.no_grad():
            states.append(module(*map(torch.from_numpy, given))[2].numpy())
    together = np.concatenate(states)
    for batch in (1, len(together)):
        arrays = [np.repeat(array, batch, axis=0) for array in given[:5]] + [together[-batch:]]
        with torch.no_grad():
            expected = module(*map(torch.from_numpy, arrays))
        names = [entry.name for entry in session.get_inputs()]
        for ours, theirs in zip(
            session.run(None, dict(zip(names, arrays, strict=True))), expected, strict=True
        ):
            np.testing.assert_allclose(ours, theirs.numpy(), atol=TOLERANCE)


@pytest.mark.parametrize("name", LIVE)
def test_some_frames_a_call_are_those_of_one_a_call(name):
    """As many as the network looks ahead, of two streams; emotion and motion of each frame."""
    each = FinishedLive(load_model(name)).eval()
    some = FinishedLive(load_model(name), each.delay).eval()
    total, sound = 18, torch.from_numpy(recorded("promise")[8_000:24_000].copy())
    sounds = F.pad(torch.stack((sound, 0.3 * sound)), (each.before, 0))
    rng = np.random.default_rng(3)
    given = [
        torch.from_numpy(values.astype(np.float32))
        for values in (
            rng.dirichlet(np.ones(len(LABELS)), (2, total)),
            rng.uniform(0, 0.2, (2, total, N_VARIANTS + 1)),
            rng.uniform(0, 1, (2, total, N_MOTION)),
        )
    ]

    def curves(module, count):
        state, found = module.first(2), []
        for frame in range(0, total, count):
            start, now = frame * 16_000 // 30, frame if count == 1 else slice(frame, frame + count)
            emotion, variants, motion = (values[:, now] for values in given)
            window = sounds[:, start : start + module.window]
            factors = torch.tensor([[1.0, REST], [0.7, 1.0]])
            rows, _, state = module(window, emotion, factors, variants, motion, state)
            found.append(rows.view(2, count, -1))
        return torch.cat(found, dim=1)[:, each.behind :]

    with torch.no_grad():
        np.testing.assert_allclose(curves(some, each.delay), curves(each, 1), atol=TOLERANCE)


@pytest.mark.parametrize("name", ["default", *LIVE])
def test_files_have_standard_operators_without_control_flow(exported, name):
    content = onnx.load(exported(name))
    onnx.checker.check_model(content)
    assert not set(operators(exported(name))) & CONTROL_FLOW
    assert [(entry.domain, entry.version) for entry in content.opset_import] == [("", OPSET)]
    texts = {entry.key: entry.value for entry in content.metadata_props}
    assert json.loads(texts["emotions"]) == list(LABELS)
    assert len(json.loads(texts["controls"])) == len(json.loads(texts["rest"])) == 185


def test_half_precision_is_half_the_size_and_changes_nothing_of_embedded_models(
    exported, tmp_path, default, monkeypatch
):
    """Their weights are kept in it. The graph is that of whole precision, which takes long to make."""
    content = onnx.load(exported("default"))
    monkeypatch.setattr(module, "_clip", lambda model: (content, {}))
    ran("model", "export", "default", "-o", tmp_path / "half.onnx", "--precision", "float16")
    whole = exported("default").stat().st_size
    assert (tmp_path / "half.onnx").stat().st_size < 0.52 * whole
    sound = recorded("amiable")[:64_000]
    made = animate(
        sound, "surprised", sample_rate=16_000, model=default, life="off", variant="plain"
    )
    assert_same(
        finished(opened(tmp_path / "half.onnx"), sound, "surprised"), made, default.controls
    )


def test_an_unknown_precision_is_one_line(tmp_path):
    with pytest.raises(CheckpointError, match="precision 'int4' is unknown; use float32, float16"):
        export_onnx(of_frontend(WHISPER), tmp_path / "x.onnx", precision="int4")


@pytest.mark.parametrize(
    ("frontend", "settings"),
    [(WHISPER, {}), (CAUSAL | {"layers": (2, 3)}, {"positions": False})],
    ids=["clip", "live"],
)
def test_models_with_actors_take_their_weights_after_the_emotions(
    frontend, settings, tmp_path, monkeypatch
):
    """By the module that is traced: in its curves, or those in the state of its next frames."""
    network, outputs = of_frontend(frontend, actors=("ann", "bob"), **settings), []
    with torch.no_grad():
        network.decoder.actors.weight.normal_()

    def acted(graph, example, inputs, *rest):
        place = inputs.index("emotion")
        assert example[place].shape[-1] == len(LABELS) + 2
        sound = 0.1 * torch.randn(example[0].shape)
        for actor in range(2):
            given = [sound, *example[1:]]
            given[place] = torch.zeros_like(example[place])
            given[place][..., len(LABELS) + actor] = 1
            with torch.no_grad():
                for _ in range(15 if "state" in inputs else 1):
                    found = graph.eval()(*given)
                    given[-1] = found[-1] if "state" in inputs else given[-1]
            outputs.append(torch.cat([part.flatten() for part in found]))
        return onnx.ModelProto()

    monkeypatch.setattr(module, "traced", acted)
    export_onnx(network, tmp_path / "x.onnx")
    assert (outputs[0] - outputs[1]).abs().max() > 0.01
    texts = {entry.key: entry.value for entry in onnx.load(tmp_path / "x.onnx").metadata_props}
    assert json.loads(texts["actors"]) == ["ann", "bob"]


def test_a_model_without_a_graph_is_refused_in_one_line(tmp_path):
    assert isinstance(load_model("mel"), DEITalk)
    with pytest.raises(CheckpointError, match="only models with a Whisper frontend"):
        export_onnx(load_model("mel"), tmp_path / "x.onnx")
    assert not (tmp_path / "x.onnx").exists()


HEADERS = ("/usr/include/onnxruntime", "/usr/local/include/onnxruntime", "/usr/local/include")


def test_the_example_in_cpp_gives_the_curves(exported, tmp_path, clip):
    headers = [Path(os.environ.get("ONNXRUNTIME_INCLUDE", "")), *map(Path, HEADERS)]
    include = next((f for f in headers if (f / "onnxruntime_cxx_api.h").is_file()), None)
    if include is None or shutil.which("g++") is None:
        pytest.skip("needs g++ and the headers of ONNX Runtime; set ONNXRUNTIME_INCLUDE")
    text = Path("docs/onnx.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```cpp\n(.*?)```", text, re.DOTALL)
    (tmp_path / "clip.cpp").write_text(code)
    (library,) = Path(onnxruntime.__file__).parent.glob("capi/libonnxruntime.so.*")
    (tmp_path / "libonnxruntime.so.1").symlink_to(library)  # the name that the library gives itself
    command = ["g++", "-std=c++17", "clip.cpp", "-o", "clip", f"-I{include}", str(library)]
    command.append(f"-Wl,-rpath,{tmp_path}")
    subprocess.run(command, cwd=tmp_path, check=True)
    sound = recorded("promise")
    sound.tofile(tmp_path / "sound.f32")
    arguments = [exported("default"), "sound.f32", "curves.f32"]
    subprocess.run([tmp_path / "clip", *arguments], cwd=tmp_path, check=True)
    found = np.fromfile(tmp_path / "curves.f32", np.float32).reshape(-1, 185)
    np.testing.assert_allclose(found, finished(clip, sound, "happy")[0], atol=1e-5)
