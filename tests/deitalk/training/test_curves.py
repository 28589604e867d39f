"""Training, end to end on seconds of data: files, learning, resuming, guards, two processes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from deitalk.config import Config, load_config, parse_config
from deitalk.data.clips import read_clips
from deitalk.errors import ConfigError, DataError
from deitalk.figures.canvas import can_draw
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DEITalk
from deitalk.training.curve_loss import Loss, control_weights
from deitalk.training.curves import _accelerator, _start, _step, n_steps, train
from rig import default_controls
from tests.dataset import write_dataset

CONTROLS = default_controls()
TINY = Path(__file__).resolve().parents[3] / "configs" / "tiny.yaml"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"))


def tiny(*overrides: str) -> Config:
    """A run of 6 steps that evaluates at 3 and 6."""
    mine = ("train.steps=6", "train.evaluate_every=3", "train.batch_size=4", "train.workers=0")
    return load_config(TINY, (*mine, *overrides))


@pytest.fixture(scope="module")
def finished(data, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "whole"
    train(tiny("model.dropout=0.1"), data, out)
    return out


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_model(folder).state_dict()


def equal(a: Path, b: Path) -> bool:
    first, second = weights(a), weights(b)
    return first.keys() == second.keys() and all(torch.equal(first[k], second[k]) for k in first)


def test_a_run_leaves_exactly_its_files(finished):
    files = sorted(str(p.relative_to(finished)) for p in finished.rglob("[!.]*") if p.is_file())
    model = ["config.yaml", "model.json", "model.safetensors"]
    pictures = [f"curves/{step:06d}.png" for step in (3, 6)] if can_draw() else []
    assert files == sorted(
        ["config.yaml", "development.csv", "metrics.csv", "state.pt", *pictures]
        + [f"{kind}/{name}" for kind in ("best", "last") for name in model]
    )
    assert load_config(finished / "config.yaml") == tiny("model.dropout=0.1")
    metrics = pd.read_csv(finished / "metrics.csv")
    assert metrics["step"].tolist() == [6]
    assert np.isfinite(metrics[["position", "velocity", "total", "gradient_norm"]]).all().all()
    scores = pd.read_csv(finished / "development.csv")
    assert scores["step"].tolist() == [3, 6]


class Killed(Exception):
    pass


def test_a_killed_run_goes_on_to_the_same_weights_bit_for_bit(
    data, finished, tmp_path, monkeypatch
):
    out = tmp_path / "killed"
    whole = tiny("model.dropout=0.1")
    import deitalk.training.curves as module

    steps = {"n": 0}
    original = module._step

    def dies_at_5(*args: object) -> dict[str, float]:
        steps["n"] += 1
        if steps["n"] == 5:
            raise Killed
        return original(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "_step", dies_at_5)
    with pytest.raises(Killed):
        train(whole, data, out)
    monkeypatch.undo()
    told: list[int] = []
    best = train(whole, data, out, resume=True, progress=lambda step, total, _: told.append(step))
    assert told == [3, 6, 6], "from the saved state to the last step and its evaluation"
    for kind in ("best", "last"):
        assert equal(out / kind, finished / kind), kind
    for name in ("metrics.csv", "development.csv"):
        assert (out / name).read_text() == (finished / name).read_text(), "no row twice"
    assert set(best) == {"step", "development"}


def test_resuming_a_finished_run_says_what_it_found(data, finished):
    before = (finished / "state.pt").stat().st_mtime_ns
    best = train(tiny("model.dropout=0.1"), data, finished, resume=True)
    assert best["step"] in (3, 6) and "score" in best["development"]
    assert (finished / "state.pt").stat().st_mtime_ns == before


def test_a_used_folder_or_other_settings_are_refused(data, finished):
    with pytest.raises(DataError, match="holds a run already; set resume"):
        train(tiny(), data, finished)
    with pytest.raises(ConfigError, match=r"begun with another model\.dropout, train\.seed"):
        train(tiny("train.seed=9"), data, finished, resume=True)


def test_a_damaged_state_is_one_line(data, finished, tmp_path):
    (tmp_path / "config.yaml").write_text((finished / "config.yaml").read_text())
    (tmp_path / "state.pt").write_bytes(b"not a state")
    with pytest.raises(DataError, match=r"state\.pt: damaged"):
        train(tiny("model.dropout=0.1"), data, tmp_path, resume=True)


def test_the_loss_falls_where_there_is_little_to_learn(data, tmp_path):
    config = tiny("train.steps=50", "train.evaluate_every=50", "train.learning_rate=3e-3")
    lines: list[float] = []
    train(config, data, tmp_path / "run", progress=lambda s, n, v: lines.append(v.get("total", 0)))
    lines = [line for line in lines if line]  # without the start and the evaluation
    metrics = pd.read_csv(tmp_path / "run" / "metrics.csv")
    assert metrics["step"].tolist() == [25, 50] and len(lines) == 2
    first = first_loss(config, data)
    assert metrics["position"].iloc[-1] < 0.6 * first["position"]
    assert metrics["total"].iloc[-1] < 0.8 * first["total"]


def batches(config: Config, data: Path):
    from deitalk.data.windows import Batches

    clips = read_clips(data, "train")
    return iter(Batches(clips, CONTROLS, config.data, config.train.seed, config.train.batch_size))


def first_loss(config: Config, data: Path) -> dict[str, float]:
    torch.manual_seed(config.train.seed)
    loss = Loss(config, CONTROLS, torch.device("cpu"))
    with torch.no_grad():
        parts = loss(DEITalk(config.model), next(batches(config, data)))
    return {name: float(part) for name, part in parts.items()}


def test_fine_tuning_begins_with_the_given_weights(data, finished, tmp_path):
    config = tiny("model.dropout=0.1", "train.steps=1", "train.learning_rate=1e-12")
    train(config, data, tmp_path / "tuned", start_from=finished / "last")
    tuned, start = weights(tmp_path / "tuned" / "last"), weights(finished / "last")
    learnt = [k for k in start if "running" not in k and start[k].dtype.is_floating_point]
    assert all(torch.allclose(tuned[k], start[k], atol=1e-6) for k in learnt)
    with pytest.raises(ConfigError, match="do not fit the configuration's model"):
        train(tiny("model.style_size=3"), data, tmp_path / "other", start_from=finished / "last")


def test_without_validation_clips_the_last_weights_are_the_best(data, tmp_path):
    folder = write_dataset(tmp_path / "data", n_validation=0)
    best = train(tiny(), folder, tmp_path / "run")
    assert best["step"] == 6 and equal(tmp_path / "run" / "best", tmp_path / "run" / "last")


def test_tensorboard_is_written_where_it_is_asked_for(data, tmp_path):
    pytest.importorskip("tensorboard", reason="needs the extra 'tensorboard'")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    train(tiny("train.steps=3"), data, tmp_path / "run", tensorboard=True)
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard"))
    events.Reload()
    for table, column, tag in (
        ("metrics", "total", "metrics/total"),
        ("development", "dev_score", "development/score"),
    ):
        rows = pd.read_csv(tmp_path / "run" / f"{table}.csv")
        told = [(event.step, event.value) for event in events.Scalars(tag)]
        assert told == [(3, pytest.approx(rows[column].iloc[0], rel=1e-5))]


def test_no_training_clips_is_one_line(tmp_path):
    folder = write_dataset(tmp_path / "data", n_train=0)
    with pytest.raises(DataError, match="no clips to train on"):
        train(tiny(), folder, tmp_path / "run")


def test_a_bad_batch_is_left_out_and_many_in_a_row_end_the_run(data, monkeypatch):
    config = tiny()
    model = DEITalk(config.model)
    run = _start(config, model, 6)
    accelerator = _accelerator(config.train)
    network, run.optimizer = accelerator.prepare(run.model, run.optimizer)
    loss = Loss(config, CONTROLS, torch.device("cpu"))
    good = next(batches(config, data))
    bad = good._replace(waveform=good.waveform * torch.nan)
    before = {k: v.clone() for k, v in model.state_dict().items() if v.dtype.is_floating_point}
    values = _step(run, network, loss, bad, config.train, accelerator)
    assert not np.isfinite(values["gradient_norm"]) and run.bad_steps == 1
    assert all(torch.equal(model.state_dict()[k], v) for k, v in before.items())
    _step(run, network, loss, good, config.train, accelerator)
    assert run.bad_steps == 0
    assert any(not torch.equal(model.state_dict()[k], v) for k, v in before.items())
    with pytest.raises(DataError, match="20 gradients in a row are not finite; lower train"):
        for _ in range(20):
            _step(run, network, loss, bad, config.train, accelerator)
    for mean, value in zip(run.average.buffers(), run.model.buffers(), strict=True):
        assert mean.isfinite().all() and value.isfinite().all()


def test_steps_come_from_epochs_over_the_real_windows(data):
    clips = read_clips(data, "train")
    config = parse_config(
        {
            "train": {"epochs": 10, "batch_size": 4},
            "data": {"window_frames": 40, "stride_frames": 5},
        }
    )
    # 4 clips of 90 frames: (90 - 40) / 5 + 1 = 11 windows each.
    assert n_steps(config, clips) == 110
    assert n_steps(tiny(), clips) == 6


def test_weights_of_controls_are_named_by_control_part_or_subset():
    out = control_weights({"lip": 2.0, "lipsTogether": 3.0, "CTRL_C_jaw.ty": 4.0}, CONTROLS)
    assert out[CONTROLS.index("CTRL_C_jaw.ty")] == 4
    assert out[CONTROLS.index("CTRL_L_mouth_lipsTogetherU.ty")] == 3, "later entries win"
    assert out[CONTROLS.index("CTRL_L_mouth_cornerPull.ty")] == 2
    assert out[CONTROLS.index("CTRL_L_brow_down.ty")] == 1
    with pytest.raises(ConfigError, match="'moustache' is no control"):
        control_weights({"moustache": 1.0}, CONTROLS)


@pytest.mark.slow
@pytest.mark.parametrize("contrast", ["0.1", "0"])
def test_two_processes_make_the_model_that_one_makes(data, tmp_path, contrast):
    # Batch statistics differ between half batches, so the frontend here has none.
    config = tmp_path / "config.yaml"
    config.write_text(WITHOUT_BATCH_STATISTICS)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}

    def fit(launcher: list[str], out: Path) -> None:
        options = ["--data", str(data), "-o", str(out), "--set", f"loss.contrast={contrast}"]
        command = [sys.executable, *launcher, "-m", "deitalk", "train", str(config), *options]
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
    start = DEITalk(load_config(config).model).state_dict()
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
