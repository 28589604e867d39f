"""Training of DEITalk models on seconds of data: files, learning, starts, pictures, processes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from deitalk.config.curves import Config
from deitalk.config.load import load_config
from deitalk.data.clips import read_clips
from deitalk.errors import ConfigError, DataError
from deitalk.evaluation.figures import can_draw
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import Analysis, DEITalk
from deitalk.research.config import read_training
from deitalk.research.training.curves import TrainingLoss, TrainingTask, train_curves
from deitalk.research.training.pictures import clip_rows, shown_examples
from rig import default_controls
from tests.dataset import write_dataset

CONTROLS = default_controls()
TINY = Path(__file__).resolve().parents[4] / "configs" / "tiny.yaml"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"))


def tiny(*overrides: str) -> Config:
    """A run of 6 steps that evaluates at 3 and 6."""
    mine = ("train.steps=6", "train.evaluate_every=3", "train.batch_size=4", "train.workers=0")
    return read_training(TINY, (*mine, *overrides))


@pytest.fixture(scope="module")
def finished(data, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "whole"
    train_curves(tiny("model.dropout=0.1"), data, out)
    return out


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_model(folder).state_dict()


def equal(a: Path, b: Path) -> bool:
    first, second = weights(a), weights(b)
    return first.keys() == second.keys() and all(torch.equal(first[k], second[k]) for k in first)


def test_run_leaves_exactly_its_files(finished):
    files = sorted(str(p.relative_to(finished)) for p in finished.rglob("[!.]*") if p.is_file())
    model = ["config.yaml", "model.json", "model.safetensors"]
    pictures = [f"curves/{step:06d}.png" for step in (3, 6)] if can_draw() else []
    assert files == sorted(
        ["config.yaml", "data.sha256", "development.csv", "metrics.csv", "state.pt", *pictures]
        + [f"{kind}/{name}" for kind in ("best", "last") for name in model]
    )
    assert load_config(finished / "config.yaml") == tiny("model.dropout=0.1")
    metrics = pd.read_csv(finished / "metrics.csv")
    assert metrics["step"].tolist() == [6]
    assert np.isfinite(metrics[["position", "velocity", "total", "gradient_norm"]]).all().all()
    scores = pd.read_csv(finished / "development.csv")
    assert scores["step"].tolist() == [3, 6]


def test_resuming_rejects_a_damaged_state(data, finished, tmp_path):
    run = shutil.copytree(finished, tmp_path / "run")
    (run / "state.pt").write_bytes(b"not a state")
    with pytest.raises(DataError, match=r"state\.pt: damaged"):
        train_curves(tiny("model.dropout=0.1"), data, run, resume=True)


def test_loss_falls_on_a_small_dataset(data, tmp_path):
    config = tiny("train.steps=50", "train.evaluate_every=50", "train.learning_rate=3e-3")
    lines: list[float] = []
    train_curves(
        config, data, tmp_path / "run", progress=lambda s, n, v: lines.append(v.get("total", 0))
    )
    lines = [line for line in lines if line]  # without the start and the evaluation
    metrics = pd.read_csv(tmp_path / "run" / "metrics.csv")
    assert metrics["step"].tolist() == [25, 50] and len(lines) == 2
    first = first_loss(config, data)
    assert metrics["position"].iloc[-1] < 0.6 * first["position"]
    assert metrics["total"].iloc[-1] < 0.8 * first["total"]


def batches(config: Config, data: Path):
    from deitalk.data.windows import WindowBatches

    clips = read_clips(data, "train")
    return iter(
        WindowBatches(clips, CONTROLS, config.data, config.train.seed, config.train.batch_size)
    )


def first_loss(config: Config, data: Path) -> dict[str, float]:
    torch.manual_seed(config.train.seed)
    loss = TrainingLoss(config.loss, CONTROLS, torch.device("cpu"))
    with torch.no_grad():
        parts = loss(DEITalk(config.model), next(batches(config, data)))
    return {name: float(part) for name, part in parts.items()}


def test_fine_tuning_begins_with_the_given_weights(data, finished, tmp_path):
    config = tiny("model.dropout=0.1", "train.steps=1", "train.learning_rate=1e-12")
    train_curves(config, data, tmp_path / "tuned", start_from=finished / "last")
    tuned, start = weights(tmp_path / "tuned" / "last"), weights(finished / "last")
    learnt = [k for k in start if "running" not in k and start[k].dtype.is_floating_point]
    assert all(torch.allclose(tuned[k], start[k], atol=1e-6) for k in learnt)
    with pytest.raises(ConfigError, match="do not fit the configuration's model"):
        train_curves(
            tiny("model.style_size=3"), data, tmp_path / "other", start_from=finished / "last"
        )


def test_frozen_frontend_stays_in_evaluation_mode(data, finished):
    config = tiny("model.dropout=0.1", f"train.frozen_frontend={finished / 'last'}")
    task = TrainingTask(config, data)
    task.build(torch.device("cpu"))
    task.set_training()
    frontend = task.model.get_submodule("frontend")
    assert task.model.training and not any(m.training for m in frontend.modules())
    learning = {id(p) for group in task.optimizer().param_groups for p in group["params"]}
    assert learning and not learning & {id(p) for p in frontend.parameters()}


def test_optimiser_and_weight_decay_are_those_of_the_settings(data):
    for overrides, kind, decay in (
        ((), torch.optim.Adam, 0),
        (("train.optimizer=adamw", "train.weight_decay=0.1"), torch.optim.AdamW, 0.1),
    ):
        task = TrainingTask(tiny(*overrides), data)
        task.build(torch.device("cpu"))
        optimizer = task.optimizer()
        assert type(optimizer) is kind and optimizer.param_groups[0]["weight_decay"] == decay


class Constant(torch.nn.Module):
    """A model whose every control and intensity has one value."""

    def __init__(self, value: float, has_intensity: bool = True) -> None:
        super().__init__()
        self.value = torch.nn.Parameter(torch.tensor(value))
        self.controls, self.has_intensity = CONTROLS, has_intensity

    def analyse(self, waveform: torch.Tensor, n_frames: int, **_: object) -> Analysis:
        strength = torch.full((n_frames,), float(self.value.detach()))
        return Analysis(
            torch.zeros(n_frames, 1), None, None, strength if self.has_intensity else None
        )

    def styles(self, emotion: torch.Tensor, actor: str) -> torch.Tensor:
        return emotion

    def decode(self, analysis: Analysis, emotion: torch.Tensor) -> torch.Tensor:
        return torch.full((len(emotion), len(CONTROLS.names)), float(self.value.detach()))


def test_first_and_last_recorded_clip_are_shown(tmp_path):
    clips = read_clips(write_dataset(tmp_path, 4, 4), "validation")
    assert [clip.source for clip in clips] == ["espeak", "recording"] * 2
    assert list(shown_examples(clips, CONTROLS)) == ["clip5", "clip7"]
    assert list(shown_examples(clips[:2], CONTROLS)) == ["clip5"]
    assert list(shown_examples(clips[:1], CONTROLS)) == ["clip4"], "synthetic, if all are"
    assert shown_examples([], CONTROLS) == {}


def test_shown_rows_are_targets_and_predictions(data):
    ((name, example), *_) = shown_examples(read_clips(data, "validation"), CONTROLS).items()
    shown = clip_rows(name, example, Constant(0.25))  # type: ignore[arg-type]
    assert shown.title == f"{name} ({example.emotion})" and shown.fps == 30
    assert [row.label for row in shown.rows] == ["jaw", "lips together", "intensity"]
    assert all((row.predicted == 0.25).all() for row in shown.rows)
    jaw, lips, intensity = (row.target for row in shown.rows)
    np.testing.assert_array_equal(jaw, example.curves[:, CONTROLS.index("CTRL_C_jaw.ty")])
    np.testing.assert_array_equal(intensity, example.intensity)
    assert lips.shape == jaw.shape and 0.4 < lips.max() <= 1
    without = clip_rows(name, example, Constant(0.25, has_intensity=False))  # type: ignore[arg-type]
    assert without.rows[2].predicted is None


@pytest.mark.slow
def test_two_processes_make_the_weights_of_one(data, tmp_path):
    # Batch statistics differ between half batches, so the frontend here has none.
    config = tmp_path / "config.yaml"
    config.write_text(WITHOUT_BATCH_STATISTICS)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}

    def fit(launcher: list[str], out: Path) -> None:
        given = ["train", str(config), "--data", str(data), "-o", str(out)]
        command = [sys.executable, *launcher, "-m", "deitalk.research", *given]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr[-3000:]
        assert "FutureWarning" not in done.stderr and done.stderr.count("best: step") == 1

    one, two = tmp_path / "one", tmp_path / "two"
    fit([], one)
    fit(["-m", "torch.distributed.run", "--nproc_per_node", "2"], two)  # as configs/README.md says
    # Two runs that knew nothing of each other would both write, or not find their folder empty.
    assert pd.read_csv(two / "metrics.csv")["step"].tolist() == [4], "one process writes"
    first, second, start = weights(one / "last"), weights(two / "last"), None
    torch.manual_seed(0)
    start = DEITalk(read_training(config).model).state_dict()
    moved = sum(float((first[k] - start[k]).abs().sum()) for k in first)
    apart = sum(float((first[k] - second[k]).abs().sum()) for k in first)
    assert moved > 0 and apart < 2e-3 * moved


WITHOUT_BATCH_STATISTICS = """
model:
  frontend:
    kind: wav2vec
    checkpoint: null
    encoder:
      hidden_size: 32
      num_hidden_layers: 1
      num_attention_heads: 2
      intermediate_size: 32
      conv_dim: [16, 16]
      conv_kernel: [10, 8]
      conv_stride: [20, 16]
      num_feat_extract_layers: 2
      num_conv_pos_embeddings: 8
      num_conv_pos_embedding_groups: 2
      hidden_dropout: 0.0
      attention_dropout: 0.0
      activation_dropout: 0.0
      feat_proj_dropout: 0.0
      layerdrop: 0.0
      apply_spec_augment: false
  emotion_size: 16
  motion_channels: [16, 16]
  decoder_channels: 16
  decoder_dilations: [1, 2]
loss:
  contrast: 0.1
data:
  window_frames: 32
train:
  optimizer: adam
  learning_rate: 1e-3
  batch_size: 4
  steps: 4
  evaluate_every: 4
"""
