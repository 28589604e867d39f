"""A frozen frontend: its weights stay, and its features are computed once per clip."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.config import Config, load_config
from deitalk.data.clips import read_clips
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.windows import WindowBatches, load_material
from deitalk.errors import ConfigError
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DEITalk
from deitalk.training.ablation import Variant, ablate
from deitalk.training.curves import train_curves
from tests.dataset import write_dataset

TINY = Path(__file__).resolve().parents[3] / "configs" / "tiny.yaml"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def source(data, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "source"
    train_curves(tiny("train.seed=7"), data, out)
    return out / "last"


def tiny(*overrides: str) -> Config:
    mine = ("train.steps=4", "train.evaluate_every=2", "train.batch_size=2", "train.workers=0")
    config = load_config(TINY, (*mine, *overrides))
    assert isinstance(config, Config)
    return config


def frontend(folder: Path) -> dict[str, torch.Tensor]:
    return load_model(folder).frontend.state_dict()


@pytest.mark.parametrize("augment", [False, True])
def test_training_changes_all_weights_but_the_frontend(data, source, tmp_path, augment):
    config = tiny(f"train.frozen_frontend={source}", f"data.augment={augment}", "train.ema=0.5")
    train_curves(config, data, tmp_path / "run")
    before, after = frontend(source), frontend(tmp_path / "run" / "last")
    assert all(torch.equal(before[name], after[name]) for name in before)
    torch.manual_seed(config.train.seed)
    fresh = DEITalk(config.model).decoder.state_dict()
    learnt = load_model(tmp_path / "run" / "last").decoder.state_dict()
    assert any(not torch.equal(fresh[name], learnt[name]) for name in fresh)


def test_windows_hold_the_features_of_the_whole_clip(data, source):
    clips = read_clips(data, "train")
    config = tiny(f"train.frozen_frontend={source}")
    model = load_model(source)
    frozen_features = FrozenFeatures(str(source))
    plain = WindowBatches(clips, model.controls, config.data, seed=3, batch_size=2)
    frozen = WindowBatches(
        clips, model.controls, config.data, seed=3, batch_size=2, frozen_features=frozen_features
    )
    window, same = frozen.item(5), plain.item(5)
    assert torch.equal(window.curves, same.curves) and torch.equal(window.frames, same.frames)
    places = window.frames.tolist()
    materials = [load_material(clip, model.controls) for clip in clips]
    offered = []
    for material in materials:
        waveform = material.waveform.astype(np.float32) * np.float32(material.unit)
        frames = max(int(np.ceil(len(waveform) / SAMPLE_RATE * FRAME_RATE)), places[-1] + 1)
        padded = np.pad(waveform, (0, max(frames * SAMPLE_RATE // FRAME_RATE - len(waveform), 0)))
        offered.append(model.frontend.encode(torch.from_numpy(padded), frames)[places])
    nearest = min(float((window.waveform - features).abs().max()) for features in offered)
    assert nearest < 2e-3  # half precision
    moved = model.frontend.encode(torch.zeros(SAMPLE_RATE * 9), places[-1] + 1)[places]
    assert float((window.waveform - moved).abs().max()) > 10 * nearest, "silence has other features"


def test_features_of_a_clip_are_computed_once(data, source, monkeypatch):
    clips = read_clips(data, "train")[:1]
    frozen_features = FrozenFeatures(str(source))
    calls = []
    encode = frozen_features.owner.frontend.encode
    monkeypatch.setattr(
        frozen_features.owner.frontend, "encode", lambda *args: calls.append(1) or encode(*args)
    )
    batches = WindowBatches(
        clips, load_model(source).controls, tiny().data, 0, 2, frozen_features=frozen_features
    )
    for number in range(12):
        batches.item(number)
    assert 1 <= len(calls) <= 2  # again only for a window that reaches further beyond the end
    first = frozen_features.features(clips[0], np.zeros(16_000, np.float32), 10)
    assert np.isfinite(first).all() and len(calls) <= 2


def test_training_rejects_a_frontend_of_another_configuration(data, source, tmp_path):
    config = tiny(f"train.frozen_frontend={source}", "model.frontend.time_hidden=8")
    with pytest.raises(ConfigError, match=r"built otherwise than model\.frontend") as refused:
        train_curves(config, data, tmp_path / "run")
    assert "\n" not in str(refused.value)


def test_variants_share_the_features(data, source, tmp_path, monkeypatch):
    made = []
    original = FrozenFeatures.__init__
    monkeypatch.setattr(
        FrozenFeatures, "__init__", lambda self, name: made.append(name) or original(self, name)
    )
    variants = [Variant("full", TINY, ()), Variant("still", TINY, ("loss.velocity=0",))]
    overrides = [f"train.frozen_frontend={source}", "train.batch_size=2", "train.workers=0"]
    table = ablate(
        variants, data, tmp_path / "runs", steps=2, seeds=2, split="validation", probes=0,
        overrides=overrides,
    )  # fmt: skip
    assert set(table) == {"full", "still"} and len(made) == 1
