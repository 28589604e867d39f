"""A frozen frontend: its weights stay, and its features are computed once per clip."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.config.curves import Config
from deitalk.data.augment_waveform import Surroundings
from deitalk.data.clips import read_clips
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.waveforms import recorded_frames
from deitalk.data.windows import WindowBatches, load_clip
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.config import read_training
from deitalk.research.training.ablation import Variant, ablate
from deitalk.research.training.curves import train_curves
from deitalk.research.training.encoded_passes import EncodedPasses
from tests.dataset import write_dataset

pytestmark = pytest.mark.usefixtures("empty_pictures")

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
    config = read_training(TINY, (*mine, *overrides))
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


def test_features_on_disk_are_mapped_and_computed_once(data, source, tmp_path, monkeypatch):
    clips = read_clips(data, "train")
    length = tiny().data.window_frames
    found, shares = FrozenFeatures(str(source), tmp_path / "features"), []
    found.prepare(clips, length, progress=shares.append)
    assert shares == [n / len(clips) for n in range(1, len(clips) + 1)]
    assert len(list((tmp_path / "features").iterdir())) == len({clip.audio for clip in clips})
    n_frames = max(recorded_frames(str(clips[0].audio)), length)
    features = found.features(clips[0], n_frames)
    assert isinstance(features, np.memmap)
    np.testing.assert_array_equal(
        features, FrozenFeatures(str(source)).features(clips[0], n_frames)
    )
    again = FrozenFeatures(str(source), tmp_path / "features")
    monkeypatch.setattr(again.owner, "frontend", torch.nn.Identity())  # encodes nothing
    again.prepare(clips, length)
    assert again.features(clips[0], n_frames).shape == features.shape
    monkeypatch.setattr("deitalk.data.waveforms.load_audio", None)  # nor do windows read a sound
    controls = load_model(source).controls
    batches = WindowBatches(clips, controls, tiny().data, 0, 2, frozen_features=again)
    assert batches.item(0).waveform.shape == (length, features.shape[1])


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
    for name in ("curves", "frames", "total", "intensity", "known"):
        assert torch.equal(getattr(window, name), getattr(same, name)), name
    places = window.frames.tolist()
    loaded_clips = [load_clip(clip, model.controls) for clip in clips]
    offered = []
    for loaded in loaded_clips:
        waveform = loaded.waveform.astype(np.float32) * np.float32(loaded.unit)
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
    first = frozen_features.features(clips[0], 10)
    assert np.isfinite(first).all() and len(calls) <= 2


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


class Loudness:
    """A frontend of one feature, the loudest sample of each frame; it counts its calls."""

    output_size = 1
    is_causal = False

    def __init__(self):
        self.calls = 0

    def encode(self, waveform, n_frames, **options):
        self.calls += 1
        padded = torch.nn.functional.pad(waveform, (0, 534 * n_frames - len(waveform)))
        return padded[: 534 * n_frames].view(n_frames, 534).abs().amax(dim=1, keepdim=True)


SOUNDS = [Path("a.wav"), Path("b.wav"), Path("c.wav")]


def sound_of(path: Path) -> np.ndarray:
    """A recording of 20, 40 or 60 frames."""
    place = SOUNDS.index(path)
    return np.random.default_rng(place).normal(0, 0.1, 533 * 20 * (place + 1)).astype(np.float32)


def passes(folder: Path, frontend, number: int, seed: int = 0) -> EncodedPasses:
    surroundings = Surroundings()
    return EncodedPasses.write(
        folder, SOUNDS, sound_of, frontend, surroundings, passes=number, seed=seed
    )


def test_first_pass_is_the_recordings_as_they_are(tmp_path):
    found = passes(tmp_path, Loudness(), 2)
    for place, path in enumerate(SOUNDS):
        n_frames = 20 * (place + 1)
        expected = Loudness().encode(torch.from_numpy(sound_of(path)), n_frames).numpy()
        assert found.speed(0, path) == 1
        np.testing.assert_allclose(found.window(0, path, 0, n_frames), expected, rtol=1e-3)
        np.testing.assert_allclose(found.window(0, path, 7, 5), expected[7:12], rtol=1e-3)


def test_other_passes_change_speed_and_sound(tmp_path):
    found = passes(tmp_path, Loudness(), 6)
    speeds = {found.speed(k, path) for k in range(1, 6) for path in SOUNDS}
    assert len(speeds) > 5 and 0.82 <= min(speeds) < 1 < max(speeds) <= 1.25
    for k in range(1, 6):
        for place, path in enumerate(SOUNDS):
            begin, end = found.tables[k][place : place + 2, 0]
            n_frames = 20 * (place + 1) / found.speed(k, path)
            assert end - begin == pytest.approx(n_frames, abs=1.5), "as long as it sounds"
        assert not np.array_equal(
            found.window(k, SOUNDS[0], 0, 10), found.window(0, SOUNDS[0], 0, 10)
        )


def test_interrupted_passes_are_continued_and_finished_ones_kept(tmp_path):
    """An interrupted pass has no table; it is encoded again, with the same result."""
    whole = passes(tmp_path / "whole", Loudness(), 3)
    passes(tmp_path / "parts", Loudness(), 2)
    (tmp_path / "parts/1.table.npy").unlink()
    (tmp_path / "parts/1.npy").write_bytes(b"torn")
    frontend = Loudness()
    again = passes(tmp_path / "parts", frontend, 3)
    assert frontend.calls == 2 * len(SOUNDS)
    for ours, theirs in zip(again.rows + again.tables, whole.rows + whole.tables, strict=True):
        assert np.array_equal(ours, theirs)
    frontend = Loudness()
    passes(tmp_path / "parts", frontend, 3)
    assert frontend.calls == 0
