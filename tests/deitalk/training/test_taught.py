"""A causal model taught by one that is given the whole clip: rows, windows, a run and its model."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk.config import load_config
from deitalk.data.clips import read_clips
from deitalk.data.taught import one_clip_each
from deitalk.data.windows import read_waveform
from deitalk.emotions import EMOTIONS
from deitalk.errors import ConfigError
from deitalk.live.animator import LiveAnimator
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.training.curve_losses import start_as
from deitalk.training.curves import CurveTask, train_curves
from tests.dataset import waveform, write_dataset

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
SMALL = (
    "model.frontend={kind: causal_mel, n_mels: 16, conv_channels: [2, 2, 2], spec_hidden: 2, "
    "spectral_size: 8, time_hidden: 12, time_layers: 1}",
    "model.emotion_size=8",
    "model.motion_channels=[4, 4]",
    "model.decoder_channels=8",
    "model.decoder_dilations=[1, 2]",
    "loss.lips=0",
    "data.window_frames=40",
    "train.batch_size=3",
    "train.steps=4",
    "train.evaluate_every=2",
    "train.precision=float32",
)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def teacher(tmp_path_factory) -> Path:
    frontend = SMALL[0].replace("causal_mel", "mel").replace("12", "6")
    config = load_config(
        CONFIGS / "live.yaml",
        [*SMALL, frontend, "train.teacher=null", "data.taught_passes=0"],
    )
    torch.manual_seed(7)
    folder = tmp_path_factory.mktemp("teacher") / "model"
    save_model(folder, DEITalk(config.model), config, {})
    return folder


@pytest.fixture(scope="module")
def run(data, teacher, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    train_curves(
        load_config(CONFIGS / "live.yaml", [*SMALL, f"train.teacher={teacher}"]), data, out
    )
    return out


def test_rows_hold_what_the_teacher_predicts(run, data, teacher):
    clips = one_clip_each(read_clips(data, "train"), 0)
    first = np.load(run / "taught/0/clips.npy")
    rows = np.load(run / "taught/0/curves.npy")
    assert list(np.diff(first)[::2]) == [90] * len(clips[::2])  # every second one is as it was
    network = load_model(teacher)
    sound = torch.from_numpy(read_waveform(clips[0].audio))
    emotion = torch.zeros(90, 5)
    emotion[:, EMOTIONS.index(clips[0].emotion)] = 1
    curves = network.decode(network.analyse(sound, 90), emotion).numpy()
    assert np.abs(rows[:90] - curves).max() < 1e-3
    assert set(np.load(run / "taught/0/emotion.npy")[first[1] : first[2]]) == {
        EMOTIONS.index(clips[1].emotion)
    }


def test_inputs_are_what_the_frontend_gathers(run, data):
    clips = one_clip_each(read_clips(data, "train"), 0)
    model = load_model(run / "last")
    frontend = model.frontend
    sound = torch.from_numpy(read_waveform(clips[0].audio))[None]
    inputs = torch.from_numpy(np.load(run / "taught/0/inputs.npy")[:90]).float()[None]
    whole, taught = frontend(sound, 80), frontend(inputs, 80)
    assert (whole - taught)[:, 10:].abs().max() < 0.02  # begins without the rows of silence


def test_trained_model_animates_live_and_whole(run, data):
    model = load_model(run / "best")
    assert model.is_causal
    animator = LiveAnimator(run / "best", emotion="happy")
    frames = np.concatenate((animator.feed(waveform(3)), animator.finish()))
    assert frames.shape == (90, 185) and np.isfinite(frames).all()


def test_spectral_layers_are_the_teachers_and_kernels_turn_to_the_past(data, teacher, tmp_path):
    config = load_config(CONFIGS / "live.yaml", [*SMALL, f"train.teacher={teacher}"])
    task = CurveTask(config, data)
    task.read(tmp_path)
    student, theirs = task._network(), load_model(teacher)
    copied = start_as(student, theirs)
    assert any(name.startswith("frontend.spectral.") for name in copied)
    ours = student.decoder.layers[1].conv.weight
    given = theirs.decoder.layers[1].conv.weight
    assert torch.equal(ours[..., 1], given[..., 0]) and not ours[..., 0].any()
    assert torch.allclose(ours.sum(-1), given.sum(-1), atol=1e-6)


def test_settings_that_do_not_fit_are_refused():
    for wrong, rule in (
        ("train.teacher=null", "needs train.teacher"),
        ("model.positions=true", "positions: false"),
        ("model.saliency_frames=null", "saliency_frames"),
    ):
        with pytest.raises(ConfigError, match=rule):
            load_config(CONFIGS / "live.yaml", [wrong])
