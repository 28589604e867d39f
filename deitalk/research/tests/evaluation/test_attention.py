"""Attention of networks equals the weights in their computation; the command."""

import json

import numpy as np
import pandas as pd
import pytest
import torch
from typer.testing import CliRunner

from deitalk.audio.load import write_wav
from deitalk.audio.mel import nearest_spectra
from deitalk.audio.voice_activity import normalise_level, speech_activity
from deitalk.config.curves import ModelConfig
from deitalk.config.frontends import WhisperConfig
from deitalk.config.load import parse_config
from deitalk.errors import CheckpointError, DataError, DeitalkError
from deitalk.models.checkpoint import save_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.cli import app
from deitalk.research.evaluation.attention import attention_of, corpus_attention, frontend_weights
from deitalk.research.evaluation.report import identified
from rig.errors import RigError

FRONTEND = {
    "kind": "mel", "window_seconds": 0.032, "frame_rate": 60, "n_mels": 16,
    "conv_channels": [4, 4, 4], "spec_hidden": 4, "spectral_size": 8, "time_hidden": 8,
    "window_frames": 16, "query_frames": 3, "attention_size": 4, "recurrence": "segment",
    "weight_norm": False,
}  # fmt: skip


def settings(**changes):
    model = {
        "frontend": FRONTEND | changes, "emotion_size": 8, "style_size": 4,
        "motion_channels": [8, 8, 8, 8], "classifier_size": 4, "decoder_channels": 8,
    }  # fmt: skip
    return parse_config({"name": "tiny", "model": model})


def network(**changes):
    """Random weights whose attention is far from even."""
    torch.manual_seed(0)
    model = DEITalk(settings(**changes).model).eval()
    with torch.no_grad():
        model.frontend.attention.score.weight.mul_(40)
        model.frontend.attention.key_project.weight.mul_(40)
    return model


def speech(seconds=1.4):
    t = np.arange(int(16_000 * seconds)) / 16_000
    return (0.3 * np.sin(2 * np.pi * 150 * t) * (np.sin(9 * t) > 0)).astype(np.float32)


@pytest.mark.parametrize("stack", [1, 2])
def test_weights_equal_those_of_the_frontend(stack):
    """Applied to the memory they give the result of `along`, including the first and last frame."""
    frontend = network(time_stack=stack, spectral_size=8).frontend
    waveform, n_frames = torch.from_numpy(speech()), 42
    weights = frontend_weights(frontend, waveform, n_frames)
    centres = nearest_spectra(n_frames, 60, stack)
    length, window = int(centres[-1]) + 1, 16 // stack
    with torch.no_grad():
        mel = frontend.mel(waveform.unsqueeze(0), length * stack, 0)
        memory, _ = frontend.recurrent(frontend.spectral(mel).reshape(1, length, -1))
        wanted = frontend.attention.along(memory, centres, window)[0]
    index = centres.unsqueeze(1) + torch.arange(window) - window // 2
    attended = torch.einsum("tl,tld->td", weights, memory[0][index.clamp(0, length - 1)])
    torch.testing.assert_close(attended, wanted, atol=1e-5, rtol=1e-4)
    assert weights.max() > 3 / window  # not even, so that the comparison is meaningful
    assert (weights[0, : window // 2] == 0).all()  # nothing before the recording


def test_rows_are_at_rig_frames():
    result = attention_of(network(), speech(1.4))
    assert result.weights.shape == (42, 16)
    assert (result.fps, result.frame_rate) == (30, 60)
    np.testing.assert_allclose(result.weights.sum(axis=1), 1, rtol=1e-5)
    sound = normalise_level(speech(), activity=speech_activity(speech()))
    again = frontend_weights(network().frontend, torch.from_numpy(sound), 42)
    np.testing.assert_allclose(result.weights, again, atol=1e-6)


def test_models_without_temporal_attention_are_refused():
    with pytest.raises(CheckpointError, match="recurrence: segment"):
        attention_of(network(recurrence="window"), speech())

    class Other:
        config = ModelConfig(frontend=WhisperConfig(checkpoint=None))

    with pytest.raises(CheckpointError, match="no temporal attention"):
        attention_of(Other(), speech())


@pytest.fixture
def dataset(tmp_path):
    """Two recordings; the first is in two clips, as with two emotions."""
    from rig import RigCurves, default_controls, write_curves

    folder = tmp_path / "data"
    for name in ("audio", "curves", "phones"):
        (folder / name).mkdir(parents=True)
    controls = default_controls()
    rest = RigCurves(np.tile(controls.rest, (42, 1)), controls.names)
    rows = []
    for clip, recording in (("a-happy", "a"), ("a-sad", "a"), ("b-sad", "b")):
        write_curves(folder / "curves" / f"{clip}.npz", rest)
        write_wav(folder / "audio" / f"{recording}.wav", speech())
        (folder / "phones" / f"{recording}.csv").write_text(
            "start,end,phone\n0,0.3,SIL\n0.3,0.6,AA1\n0.6,0.72,P\n0.72,1.4,SIL\n"
        )
        rows.append({
            "clip": clip, "audio": f"audio/{recording}.wav", "curves": f"curves/{clip}.npz",
            "emotion": "sad", "speaker": "ann", "split": "validation",
            "phones": f"phones/{recording}.csv",
        })  # fmt: skip
    pd.DataFrame(rows).to_csv(folder / "clips.csv", index=False)
    return folder


def test_recording_of_several_clips_counts_once(dataset):
    vowels, plosives = corpus_attention(network(), dataset)
    assert (vowels.phones, plosives.phones) == (("AA", "AA"), ("P", "P"))
    row = attention_of(network(), speech()).weights[round(0.66 * 30)]
    np.testing.assert_allclose(plosives.rows[0], row, atol=1e-3)  # 16 bit on the disk
    assert len(corpus_attention(network(), dataset, n_clips=1)[0].phones) == 1
    (dataset / "phones" / "b.csv").write_text("start,end,phone\n0.3,0.6,IY1\n")
    vowels, plosives = corpus_attention(network(), dataset)
    assert (vowels.phones, plosives.phones) == (("AA", "IY"), ("P",))
    with pytest.raises(DataError, match="no clip of split 'test' has phones"):
        corpus_attention(network(), dataset, split="test")


def run(*arguments):
    return CliRunner().invoke(app, ["attention", *map(str, arguments)])


def test_command_draws_a_clip_and_a_corpus(dataset, tmp_path):
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    save_model(tmp_path / "model", network(), settings(), {})
    model = ("--model", tmp_path / "model")
    sound, phones = dataset / "audio" / "a.wav", dataset / "phones" / "a.csv"
    plain = run(sound, "-o", tmp_path / "clip.png", *model, "--json")
    known = identified(str(tmp_path / "model"))
    assert json.loads(plain.stdout) == {"out": str(tmp_path / "clip.png"), **known}
    report = json.loads(
        run(sound, "--phones", phones, "-o", tmp_path / "b.png", *model, "--json").stdout
    )
    pooled = json.loads(run(dataset, "-o", tmp_path / "c.png", *model, "--json").stdout)
    assert (report["vowels"]["phones"], pooled["vowels"]["phones"]) == (1, 2)
    assert 0 < report["plosives"]["evenness"] < 1
    assert report["plosives"]["evenness"] == pytest.approx(pooled["plosives"]["evenness"])
    for name in ("clip.png", "b.png", "c.png"):
        assert imread(tmp_path / name)[..., :3].std() > 0.05
    for arguments, message in (
        ((sound, "-o", tmp_path / "clip.png"), "exists"),
        ((sound, "-o", tmp_path / "clip.gif"), r"a picture is .png, .svg or .pdf"),
        ((dataset, "--phones", phones, "-o", tmp_path / "d.png"), "goes with one recording"),
    ):
        error = run(*arguments, *model).exception
        assert isinstance(error, DeitalkError | RigError) and message in str(error)
