"""Windows: sound and curves stay in time, and batches do not depend on workers and processes."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from torch.utils.data import DataLoader

from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import normalise_level
from deitalk.config.curves import DataConfig
from deitalk.data.clips import read_clips
from deitalk.data.windows import ClipCache, LoadedClip, WindowBatches, cut, load_clip
from rig import RigCurves, default_controls, read_curves, write_curves
from tests.dataset import CLICKS, FPS, JAW, RATE, SECONDS, write_dataset

CONTROLS = default_controls()
SECONDS_FRAMES = int(SECONDS * 30)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"))


def step_clip(at: float = 1.0, seconds: float = 2.0) -> LoadedClip:
    """A click and, at the same moment, a step of every curve."""
    waveform = np.zeros(int(seconds * RATE), np.float32)
    waveform[round(at * RATE)] = 1
    times = np.arange(int(seconds * FPS)) / FPS
    values = np.repeat((times >= at - 1e-9)[:, None], 3, axis=1).astype(np.float16)
    intensity = (times / seconds).astype(np.float32)
    return LoadedClip(waveform, times, values, intensity, np.ones(3, bool))


@pytest.mark.parametrize("speed", [0.82, 1.0, 1.1, 1.25])
@pytest.mark.parametrize("first", [0, 7, 20])
def test_click_stays_with_the_step_of_the_curves(speed, first):
    loaded = step_clip()
    waveform, curves, _, total = cut(loaded, first, 45, speed)
    expected = 1.0 / speed - first / 30
    assert np.abs(waveform).argmax() / RATE == pytest.approx(expected, abs=2 / RATE)
    crossed = np.interp(0.5, curves[:, 0], np.arange(45) / 30)
    assert crossed == pytest.approx(expected, abs=1 / 30)
    assert total == int(np.ceil(60 / speed))


def test_middle_of_a_clip_is_the_middle_of_the_whole():
    loaded = step_clip()
    whole_wave, whole_curves, whole_intensity, _ = cut(loaded, 0, 60)
    wave, curves, intensity, _ = cut(loaded, 21, 20)
    np.testing.assert_array_equal(wave, whole_wave[21 * RATE // 30 :][: len(wave)])
    np.testing.assert_allclose(curves, whole_curves[21:41], atol=1e-6)
    np.testing.assert_allclose(intensity, whole_intensity[21:41], atol=1e-6)


def test_clip_in_memory_is_the_recording_to_16_bits(folder):
    clip = read_clips(folder, "train")[0]
    loaded = load_clip(clip, CONTROLS)
    assert loaded.waveform.dtype == np.int16 and loaded.values.dtype == np.float16
    expected = normalise_level(load_audio(clip.audio).waveform)
    window, *_ = cut(loaded, 0, SECONDS_FRAMES)
    np.testing.assert_allclose(window, expected, rtol=0, atol=np.abs(expected).max() / 60_000)
    # 3 s: 48000 samples of 2 bytes; 180 rows of curves of 2 bytes, times of 8, intensities of 4
    assert loaded.n_bytes == 48_000 * 2 + 180 * (185 * 2 + 8 + 4)


def test_memory_is_bounded_and_what_was_used_last_stays(folder, monkeypatch):
    import deitalk.data.windows as module

    clips = read_clips(folder, "train")
    size = load_clip(clips[0], CONTROLS).n_bytes
    read: list[str] = []

    def reads(clip, controls, **options):
        read.append(clip.name)
        return load_clip(clip, controls)

    monkeypatch.setattr(module, "load_clip", reads)
    cache = ClipCache(CONTROLS, max_bytes=2 * size)
    for i in (0, 1, 0, 2, 0, 1):  # 2 displaces 1, not 0
        assert cache.read(clips[i]).values.shape == (180, 185)
        assert cache.n_bytes <= 2 * size
    assert read == ["clip0", "clip1", "clip2", "clip1"]
    small = ClipCache(CONTROLS, max_bytes=1)
    small.read(clips[0])
    small.read(clips[0])
    assert read[4:] == ["clip0"] and small.n_bytes == size, "one clip stays"


def config(**changes: object) -> DataConfig:
    return DataConfig(window_frames=32, stride_frames=5, **changes)  # type: ignore[arg-type]


def batches(folder: Path, **changes: object) -> WindowBatches:
    clips = read_clips(folder, "train")
    options: dict[str, object] = {"seed": 3, "batch_size": 4} | changes
    settings = options.pop("config", config(augment=True))
    return WindowBatches(clips, CONTROLS, settings, **options)  # type: ignore[arg-type]


def take(iterable, n: int) -> list:
    iterator = iter(iterable)
    return [next(iterator) for _ in range(n)]


def same(a, b) -> bool:
    return all(
        torch.equal(torch.nan_to_num(x), torch.nan_to_num(y)) for x, y in zip(a, b, strict=True)
    )


def test_batch_is_the_same_for_any_number_of_workers(folder):
    here = take(batches(folder), 4)
    for workers in (1, 2):
        there = take(DataLoader(batches(folder), batch_size=None, num_workers=workers), 4)
        assert all(same(a, b) for a, b in zip(here, there, strict=True)), workers
    assert not same(here[0], here[1]) and not same(here[0], take(batches(folder, seed=4), 1)[0])


def test_window_holds_its_position_in_the_clip(folder):
    plain = batches(folder, config=config())
    for number in range(12):
        window = plain.item(number)
        first = int(window.frames[0])
        assert first % 5 == 0 and int(window.total) == SECONDS * 30
        assert window.frames.tolist() == list(range(first, first + 32))
        assert first + 32 <= int(window.total)
        jaw = window.curves[:, CONTROLS.index(JAW)].numpy()
        at = (first + np.arange(32)) / 30
        middle = np.any([(at > s + 0.03) & (at < s + 0.17) for s in CLICKS], axis=0)
        outside = np.all([(at < s - 0.03) | (at > s + 0.23) for s in CLICKS], axis=0)
        np.testing.assert_allclose(jaw[middle], 0.6, atol=1e-3)
        np.testing.assert_allclose(jaw[outside], 0.0, atol=1e-3)
        sound = window.waveform.numpy()
        level = [np.abs(sound[round(i / 30 * RATE) :][:500]).max() for i in range(32)]
        if middle.any() and outside.any():
            assert np.min(np.array(level)[middle]) > 5 * np.median(np.array(level)[outside])
        assert window.emotion.sum() == window.voice.sum() == 1
        assert 0 <= window.intensity.min() and window.intensity.max() <= 0.8 + 1e-6


def test_recorded_speech_has_the_configured_share(folder):
    drawn = batches(folder, config=config(real_fraction=0.8))
    sources = [drawn._draw(np.random.default_rng(i)).source for i in range(400)]
    assert np.mean([s == "recording" for s in sources]) == pytest.approx(0.8, abs=0.06)


def test_load_clip_rejects_curves_without_frames_or_controls(folder, tmp_path):
    clip = read_clips(folder)[0]
    curves = read_curves(clip.curves)
    short = tmp_path / "short.csv"
    short.write_text(",".join(("frame", "time", *CONTROLS.names)) + "\n")
    changed = clip.__class__(**{**clip.__dict__, "curves": short})
    with pytest.raises(ValueError, match=r"short\.csv has no rows"):
        load_clip(changed, CONTROLS)
    few = CONTROLS.names[:180]
    other = tmp_path / "few.npz"
    write_curves(other, RigCurves(curves.values[:, :180], few, fps=FPS))
    with pytest.raises(ValueError, match=r"few\.npz.*lacks 5 controls|control"):
        load_clip(clip.__class__(**{**clip.__dict__, "curves": other}), CONTROLS)


def test_unknown_controls_are_at_rest(tmp_path):
    """A source that holds the jaw alone: what its file claims of other controls is dropped."""
    folder = write_dataset(tmp_path, 2, 0)
    jaw = CONTROLS.index("CTRL_C_jaw.ty")
    whole = load_clip(read_clips(folder)[0], CONTROLS)
    (folder / "known.txt").write_text("CTRL_C_jaw.ty\n")
    table = pd.read_csv(folder / "clips.csv", dtype=str).assign(known=["known.txt", ""])
    table.to_csv(folder / "clips.csv", index=False)
    clips = read_clips(folder)
    loaded = load_clip(clips[0], CONTROLS)
    assert np.flatnonzero(loaded.known).tolist() == [jaw]
    np.testing.assert_array_equal(loaded.values[:, jaw], whole.values[:, jaw])
    others = np.arange(len(CONTROLS)) != jaw
    rest = CONTROLS.rest.astype(np.float16)
    assert (loaded.values[:, others] == rest[others]).all() and whole.values[:, others].any()
    batches = WindowBatches(clips, CONTROLS, DataConfig(window_frames=30), 0, 8)
    assert set(next(iter(batches)).known.sum(dim=1).tolist()) == {1.0, 185.0}
