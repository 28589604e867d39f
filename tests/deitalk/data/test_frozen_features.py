"""A borrowed frontend: it stays as it is, is asked once a clip, and says what it always says."""

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
def lender(data, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "lender"
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
def test_the_frontend_stays_and_the_rest_learns(data, lender, tmp_path, augment):
    asked = tiny(f"train.frozen_frontend={lender}", f"data.augment={augment}", "train.ema=0.5")
    train_curves(asked, data, tmp_path / "run")
    before, after = frontend(lender), frontend(tmp_path / "run" / "last")
    assert all(torch.equal(before[name], after[name]) for name in before)
    torch.manual_seed(asked.train.seed)
    fresh = DEITalk(asked.model).decoder.state_dict()
    learnt = load_model(tmp_path / "run" / "last").decoder.state_dict()
    assert any(not torch.equal(fresh[name], learnt[name]) for name in fresh)


def test_windows_carry_what_the_frontend_says_of_the_whole_clip(data, lender):
    clips = read_clips(data, "train")
    config = tiny(f"train.frozen_frontend={lender}")
    model = load_model(lender)
    frozen_features = FrozenFeatures(str(lender))
    plain = WindowBatches(clips, model.controls, config.data, seed=3, batch_size=2)
    heard = WindowBatches(
        clips, model.controls, config.data, seed=3, batch_size=2, frozen_features=frozen_features
    )
    window, same = heard.item(5), plain.item(5)
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
    assert float((window.waveform - moved).abs().max()) > 10 * nearest, "silence is heard otherwise"


def test_a_clip_is_heard_once(data, lender, monkeypatch):
    clips = read_clips(data, "train")[:1]
    frozen_features = FrozenFeatures(str(lender))
    calls = []
    encode = frozen_features._owner.frontend.encode
    monkeypatch.setattr(
        frozen_features._owner.frontend, "encode", lambda *args: calls.append(1) or encode(*args)
    )
    batches = WindowBatches(
        clips, load_model(lender).controls, tiny().data, 0, 2, frozen_features=frozen_features
    )
    for number in range(12):
        batches.item(number)
    assert 1 <= len(calls) <= 2  # again only for a window that reaches further beyond the end
    first = frozen_features.features(clips[0], np.zeros(16_000, np.float32), 10)
    assert np.isfinite(first).all() and len(calls) <= 2


def test_a_model_of_other_ears_is_refused_in_one_line(data, lender, tmp_path):
    asked = tiny(f"train.frozen_frontend={lender}", "model.frontend.time_hidden=8")
    with pytest.raises(ConfigError, match=r"built otherwise than model\.frontend") as refused:
        train_curves(asked, data, tmp_path / "run")
    assert "\n" not in str(refused.value)


def test_variants_share_what_was_heard(data, lender, tmp_path, monkeypatch):
    made = []
    original = FrozenFeatures.__init__
    monkeypatch.setattr(
        FrozenFeatures, "__init__", lambda self, name: made.append(name) or original(self, name)
    )
    variants = [Variant("full", TINY, ()), Variant("still", TINY, ("loss.velocity=0",))]
    overrides = [f"train.frozen_frontend={lender}", "train.batch_size=2", "train.workers=0"]
    table = ablate(
        variants, data, tmp_path / "runs", steps=2, seeds=2, split="validation", probes=0,
        overrides=overrides,
    )  # fmt: skip
    assert set(table) == {"full", "still"} and len(made) == 1
