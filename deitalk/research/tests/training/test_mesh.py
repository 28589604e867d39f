"""Training of mesh models on seconds of data: learning, files, resuming, pictures, processes."""

import math
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
import yaml
from typer.testing import CliRunner

from deitalk.config.load import load_config
from deitalk.errors import ConfigError, DataError
from deitalk.evaluation.figures import can_draw
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.cli import app
from deitalk.research.config import MeshTrainingConfig, read_training
from deitalk.research.meshes import training as module
from deitalk.research.meshes.folder import (
    MeshFolder,
    MeshSequence,
    read_mesh_folder,
    write_mesh_folder,
)
from deitalk.research.meshes.predict import predict_mesh
from deitalk.research.meshes.training import MeshTask, copy_encoder, train_mesh, validate_mesh
from deitalk.research.training.pictures import draw_clips
from rig.face.identity import IDENTITIES
from tests.command import ran
from tests.dataset import write_dataset
from tests.deitalk.models.test_mesh_model import (
    KARRAS,
    LIPS,
    SEGMENT,
    STYLES,
    VOCA,
    model,
    sheet,
    spoken,
    tiny,
)

CONFIGS = Path(__file__).resolve().parents[4] / "configs"


def write_sheets(out: Path, *, with_lips: bool = True) -> Path:
    """A mesh folder of two speakers with one sound and opposite motion."""
    template = sheet()
    both = [
        MeshSequence(speaker, speaker, "train", partial(spoken, template, style))
        for speaker, style in STYLES.items()
    ]
    write_mesh_folder(
        out, dict.fromkeys(STYLES, template), both, fps=30, unit_mm=10,
        lips=LIPS if with_lips else None, basis_frames=24, basis_error_mm=0.2,
    )  # fmt: skip
    return out


@pytest.fixture(scope="module")
def sequences(tmp_path_factory) -> Path:
    return write_sheets(tmp_path_factory.mktemp("meshes") / "folder")


@pytest.fixture(scope="module")
def folder(sequences) -> MeshFolder:
    return read_mesh_folder(sequences)


@pytest.mark.parametrize(
    ("frontend", "motion", "steps", "more"),
    [
        (SEGMENT, "gradients", 140, {"segment_frames": 8, "lip_weight": 1.0, "ema": 0.9}),
        (KARRAS, "offsets", 80, {"segment_frames": 8, "schedule": "one_cycle"}),
    ],
)
def test_tiny_model_learns_the_motion_of_two_speakers(
    sequences, tmp_path, frontend, motion, steps, more
):
    """The sound is the same, so the motion can follow from the label only."""
    config = tiny(frontend, motion, steps=steps, learning_rate=1e-2, evaluate_every=steps, **more)
    best = train_mesh(config, sequences, tmp_path / "run")
    sdfa, errors_mm = load_model(tmp_path / "run/best"), []
    for speaker, style in STYLES.items():
        template = sdfa.template(speaker)
        waveform, truth = spoken(template, style)
        error_mm = 10 * np.linalg.norm(predict_mesh(sdfa, waveform, speaker) - truth, axis=-1)
        motion_mm = 10 * np.linalg.norm(truth - template.vertices, axis=-1)
        # standing still would cost all of the motion, and so would one motion for both
        assert error_mm.mean() < 0.5 * motion_mm.mean()
        errors_mm.append(error_mm.mean())
    assert best["development"]["mean_mm"] == pytest.approx(np.mean(errors_mm), rel=0.1, abs=0.05)
    losses = pd.read_csv(tmp_path / "run/metrics.csv")
    value = "stretch_value" if motion == "gradients" else "offsets_value"
    assert losses[value].iloc[-1] < 0.5 * losses[value].iloc[0]
    assert ("lips" in losses) == ("lip_weight" in more)


def test_command_trains_on_embedded_heads(tmp_path):
    data = write_dataset(tmp_path / "data", 2, 1, 1.1)  # both train on what one emotion has
    settings = tmp_path / "tiny.yaml"
    settings.write_text(yaml.safe_dump(tiny(steps=2).model_dump(mode="json")))
    run = tmp_path / "run"
    ran("train", settings, "--data", data, "-o", run, "--set", "train.seed=1")
    sdfa = load_model(run / "best")
    assert sdfa.speakers == tuple(sorted(IDENTITIES[i].name for i in (0, 3)))
    scores, _ = validate_mesh(sdfa, read_mesh_folder(run / "meshes"))
    assert math.isfinite(scores["lively_mm"]) and scores["lively_mm"] > scores["mean_mm"] > 0
    assert load_config(run / "config.yaml").train.seed == 1


def test_command_refuses_weights_to_start_from(tmp_path):
    config = str(CONFIGS / "sdfa.yaml")
    arguments = ["train", config, "--data", str(tmp_path), "-o", str(tmp_path / "run")]
    result = CliRunner().invoke(app, [*arguments, "--from", "default"])
    assert isinstance(result.exception, ConfigError) and "--from" in str(result.exception)
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, DataError)
    assert "neither" in str(result.exception)
    assert not (tmp_path / "run/metrics.csv").exists()


@pytest.fixture(scope="module")
def finished(sequences, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "deitalk.research.training.pictures.draw_clips", draw_clips
        )  # pictures are looked at
        train_mesh(resumable(), sequences, out)
    return out


def resumable(**train: Any) -> MeshTrainingConfig:
    """Four steps, saved at 2 and 4, with everything that a state must hold."""
    settings = {"ema": 0.9, "schedule": "one_cycle", "lip_weight": 0.5, **train}
    config = tiny(SEGMENT, **settings)
    return config.model_copy(update={"data": config.data.model_copy(update={"augment": True})})


def test_run_leaves_exactly_its_files(finished):
    files = sorted(str(p.relative_to(finished)) for p in finished.rglob("[!.]*") if p.is_file())
    names = ["config.yaml", "model.json", "model.safetensors", "templates.npz"]
    pictures = [f"curves/{step:06d}.png" for step in (2, 4)] if can_draw() else []
    assert files == sorted(
        ["config.yaml", "development.csv", "metrics.csv", "state.pt", *pictures]
        + [f"{kind}/{name}" for kind in ("best", "last") for name in names]
    )
    metrics = pd.read_csv(finished / "metrics.csv")
    assert metrics["step"].tolist() == [4]
    terms = [f"{b}_{k}" for b in ("stretch", "rotation") for k in ("value", "difference")]
    expected = ["step", *terms, "lips", "total", "gradient_norm", "learning_rate"]
    assert list(metrics) == expected and np.isfinite(metrics).all().all()
    assert pd.read_csv(finished / "development.csv")["step"].tolist() == [2, 4]


def test_pictures_show_what_the_training_changes(finished):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    from matplotlib.image import imread

    first, second = (imread(finished / f"curves/{step:06d}.png")[..., :3] for step in (2, 4))
    red = [np.abs(picture - (0.84, 0.15, 0.16)).max(axis=2) < 0.2 for picture in (first, second)]
    # Two clips side by side, each with its predicted lip gap and its error.
    for half in np.split(red[0][:, : red[0].shape[1] // 2 * 2], 2, axis=1):
        assert half.sum() > 500
    assert (red[0] != red[1]).any()


@pytest.mark.slow
def test_two_processes_build_one_mesh_folder(tmp_path):
    data = write_dataset(tmp_path / "data", 2, 1, 1.1)
    settings, run = tmp_path / "tiny.yaml", tmp_path / "run"
    settings.write_text(yaml.safe_dump(tiny(steps=2).model_dump(mode="json")))
    launcher = ["-m", "torch.distributed.run", "--nproc_per_node", "2", "-m", "deitalk.research"]
    given = ["train", str(settings), "--data", str(data), "-o", str(run)]
    command = [sys.executable, *launcher, *given]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    assert len(read_mesh_folder(run / "meshes").clips) == 3
    assert pd.read_csv(run / "development.csv")["step"].tolist() == [2]


def built(config: MeshTrainingConfig, sequences: Path) -> MeshTask:
    torch.manual_seed(0)
    task = MeshTask(config, sequences)
    task.read(sequences)
    task.build(torch.device("cpu"))
    return task


def test_bases_are_frozen_and_the_automatic_weights_are_saved(sequences):
    task = built(tiny(VOCA, lip_weight=1.0), sequences)
    names = {name for name, _ in task.model.named_buffers() if "pca" in name}
    assert task.frozen == names and len(names) == 2 * 3
    balance = task.state["balance"]
    batch = next(iter(task.segments))
    parts = task.loss(task.model, batch)
    assert int(balance.steps) == 1
    # On the first step every term is scaled to 1.
    assert parts["total"].item() == pytest.approx(len(parts) - 1, rel=1e-4)


def test_encoder_that_begins_as_another_learns_at_a_third(tmp_path, sequences):
    start = read_training(CONFIGS / "tiny.yaml")
    save_model(tmp_path / "m", DEITalk(start.model, pretrained=False), start, {})
    sizes = start.model.frontend.model_dump()
    rates = {}
    for name in (None, str(tmp_path / "m")):
        task = built(tiny(sizes, start_encoder=name, learning_rate=3e-3), sequences)
        encoder, decoder = task.optimizer().param_groups
        assert {id(p) for p in encoder["params"]} == {
            id(p) for p in task.model.encoder.parameters()
        }
        rates[name is None] = encoder["lr"], decoder["lr"]
    assert rates[True] == (3e-3, 3e-3)
    assert rates[False] == (pytest.approx(1e-3), 3e-3)


def test_start_encoder_rejects_another_analysis_of_the_sound(sequences, tmp_path):
    start = read_training(CONFIGS / "tiny.yaml")
    save_model(tmp_path / "m", DEITalk(start.model, pretrained=False), start, {})
    sizes = start.model.frontend.model_dump()
    for other in ({"tapers": 2}, {"frame_rate": 120.0}, {"window_seconds": 0.03}):
        with pytest.raises(ConfigError, match="its encoder is built otherwise"):
            built(tiny(sizes | other, start_encoder=str(tmp_path / "m")), sequences)


def test_copied_encoder_keeps_the_parts_that_an_ablation_replaces(tmp_path):
    """All else is the start's; a part of another kind must be named."""
    start = read_training(CONFIGS / "tiny.yaml", ["model.frontend.rig_layers=1"])
    save_model(tmp_path / "m", DEITalk(start.model, pretrained=False), start, {})
    sizes = start.model.frontend.model_dump() | {"rig_layers": 0}  # which SDFA has none of
    name = str(tmp_path / "m")
    wanted = load_model(name).frontend.state_dict()
    sdfa = model(frontend=sizes)
    before = {k: v.clone() for k, v in sdfa.encoder.frontend.state_dict().items()}
    copy_encoder(sdfa, name, ("attention",))
    for key, value in sdfa.encoder.frontend.state_dict().items():
        is_new = key.startswith("attention.")
        assert torch.equal(value, (before if is_new else wanted)[key]), key
    convolved = model(frontend=sizes | {"kind": "mel_ablated"}, gathering="convolution")
    copy_encoder(convolved, name, ("spectral",))
    with pytest.raises(ConfigError, match=r"name what differs in train\.start_new"):
        copy_encoder(convolved, name, ())
    without = model(frontend=sizes, centre=False)
    copy_encoder(without, name, ())
    recurrent = without.encoder.frontend.recurrent.state_dict()
    assert all(torch.equal(v, wanted[f"recurrent.{k}"]) for k, v in recurrent.items())


@pytest.fixture
def still(monkeypatch):
    """A model that predicts the template, and the styles it was called with."""
    styles: list[Any] = []

    def predict(sdfa, waveform, style, direction, template):
        styles.append(style)
        n_frames = math.ceil(len(waveform) / 16_000 * 30)
        return np.repeat(template.vertices[None].astype(np.float32), n_frames, axis=0)

    monkeypatch.setattr(module, "predict_mesh", predict)
    return styles


def truth_mm(style: float) -> np.ndarray:
    """Motion of the sheet's vertices [shape=(T, V), mm]."""
    template = sheet()
    return 10 * np.linalg.norm(spoken(template, style)[1] - template.vertices, axis=-1)


def test_scores_of_a_still_face_are_the_motion_itself(folder, still):
    scores, clips = validate_mesh(model(fps=30), folder)
    motion = [truth_mm(style) for style in STYLES.values()]
    assert still == list(STYLES)
    assert scores["mean_mm"] == pytest.approx(np.mean([m.mean() for m in motion]), rel=0.02)
    rims = np.mean([m[:, LIPS.both].mean() for m in motion])
    assert scores["lively_mm"] == pytest.approx(rims, rel=0.02)
    assert scores["score"] == -scores["lively_mm"]
    assert [clip.title for clip in clips] == ["ann (ann)", "bob (bob)"]
    for clip, moved in zip(clips, motion, strict=True):
        gap, error = clip.rows
        np.testing.assert_allclose(error.predicted, moved[:, LIPS.both].mean(axis=1), atol=0.1)
        assert error.target is None and gap.label == "lip gap, mm"
        vertices = sheet().vertices
        at_rest = 10 * np.linalg.norm(
            vertices[LIPS.upper[1:3]] - vertices[LIPS.lower[1:3]], axis=-1
        )
        np.testing.assert_allclose(gap.predicted, at_rest.mean(), rtol=1e-5)
        assert np.ptp(gap.target) > 0.5 and len(gap.target) == len(gap.predicted) == 30


def test_without_lips_the_liveliest_vertices_are_scored(tmp_path, still):
    folder = read_mesh_folder(write_sheets(tmp_path / "m", with_lips=False))
    scores, clips = validate_mesh(model(fps=30), folder)
    motion = [truth_mm(style) for style in STYLES.values()]
    # The twentieth of 49 vertices that moves most: two of them.
    most = np.argsort(motion[0].max(axis=0))[-2:]
    assert scores["lively_mm"] == pytest.approx(
        np.mean([m[:, most].mean() for m in motion]), rel=0.02
    )
    label, target, predicted, _ = clips[0].rows[0]
    assert label == "motion, mm" and np.abs(predicted).max() < 1e-5
    np.testing.assert_allclose(target, motion[0][:, most].mean(axis=1), atol=0.1)


def test_unknown_speaker_is_scored_in_the_first_style(tmp_path, still):
    template = sheet()
    both = [
        MeshSequence("a", "ann", "train", partial(spoken, template)),
        MeshSequence("e", "eve", "validation", partial(spoken, template)),
    ]
    write_mesh_folder(
        tmp_path / "m", {"ann": template, "eve": template}, both, fps=30, unit_mm=10, lips=LIPS
    )
    validate_mesh(model(fps=30), read_mesh_folder(tmp_path / "m"))
    assert still == [0]
