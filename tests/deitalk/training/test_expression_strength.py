"""Expression strength that is planted in captures, measured there and learnt from the voice."""

import numpy as np
import pandas as pd
import pytest
import soundfile

from deitalk.data.clips import read_clips
from deitalk.errors import ConfigError
from deitalk.evaluation.smoothness import load_example, predict
from deitalk.models.checkpoint import load_model
from deitalk.training.tuning.expression_strength import expression_axes, label_intensity
from deitalk.training.tuning.task import FinetuneTask, finetune
from rig import RigCurves, write_curves
from tests.dataset import JAW, RATE
from tests.deitalk.training.conftest import CONTROLS, recipe

BROWS = ("CTRL_L_brow_raiseIn.ty", "CTRL_R_brow_raiseIn.ty")
SECONDS, FPS = 6, 30
LEARNT = np.ones(len(CONTROLS), bool)


def planted(seed: int) -> np.ndarray:
    """Strength of every frame: a second each of 0.2 or 1."""
    return np.repeat(np.roll([0.2, 0.2, 1, 0.2, 1, 1], seed), FPS)


def voice(strength: np.ndarray, seed: int) -> np.ndarray:
    """Syllables that are high where the expression is strong, and quieter there."""
    rng = np.random.default_rng(seed)
    t = np.arange(SECONDS * RATE) / RATE
    strong = np.repeat(strength, RATE // FPS + 1)[: len(t)] > 0.5
    tone = np.where(strong, np.sin(2 * np.pi * 2500 * t), np.sin(2 * np.pi * 300 * t))
    syllables = np.sin(2 * np.pi * 4 * t + rng.uniform(0, 6)) > -0.5
    level = np.where(strong, 0.05, 0.2) * syllables
    return (level * tone + 1e-4 * rng.standard_normal(len(t))).astype(np.float32)


def write_captures(folder, emotion: str = "happy", n: int = 8):
    """Neutral clips, and clips of an emotion whose brows rise by the strength."""
    rows = []
    for i in range(n):
        shown = emotion if i % 2 else "neutral"
        strength = planted(i) if shown != "neutral" else np.full(SECONDS * FPS, 0.1)
        curves = np.tile(CONTROLS.rest, (len(strength), 1))
        talk = 0.5 + 0.5 * np.sin(np.arange(len(strength)) * 0.9 + i)
        curves[:, CONTROLS.index(JAW)] = talk
        for name in BROWS:
            raised = 0.6 * strength
            curves[:, CONTROLS.index(name)] = 0.02 * np.sin(np.arange(len(strength))) + raised
        write_curves(folder / f"{i}.npz", RigCurves(curves, CONTROLS.names, fps=FPS))
        soundfile.write(folder / f"{i}.wav", voice(strength, i), RATE)
        split = "train" if i < n - 2 else "validation"
        rows.append((f"c{i}", f"{i}.wav", f"{i}.npz", shown, "anna", split))
    columns = ["clip", "audio", "curves", "emotion", "speaker", "split"]
    pd.DataFrame(rows, columns=columns).to_csv(folder / "clips.csv", index=False)
    return folder


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    return write_captures(tmp_path_factory.mktemp("captures"))


def test_measured_strength_is_the_planted_one(captures, tmp_path):
    """Though the jaw moves more than the brows; a neutral clip has none."""
    clips = read_clips(captures)
    axes = expression_axes(clips, CONTROLS, LEARNT)
    assert set(axes) == {("anna", "happy")}
    labelled = label_intensity(clips, axes, CONTROLS, tmp_path / "intensity")
    for i, clip in enumerate(labelled):
        measured = load_example(clip, CONTROLS).intensity
        if clip.emotion == "neutral":
            assert not measured.any()
        else:
            assert np.corrcoef(measured, planted(i))[0, 1] > 0.85, "smoothed, so below 1"
            assert measured.max() <= 1 and np.ptp(measured) > 0.5
    strong = axes["anna", "happy"].weights
    assert np.abs(strong).argmax() in [CONTROLS.index(name) for name in BROWS]


def test_emotion_that_looks_neutral_has_no_strength(tmp_path, captures):
    table = pd.read_csv(captures / "clips.csv", dtype=str)
    clips = [clip for clip in read_clips(captures) if clip.emotion == "neutral"]
    assert not expression_axes(clips, CONTROLS, LEARNT)
    folder = tmp_path / "calm"
    folder.mkdir()
    for i in range(8):
        for kind in ("wav", "npz"):
            (folder / f"{i}.{kind}").symlink_to(captures / f"{i - i % 2}.{kind}")
    table.to_csv(folder / "clips.csv", index=False)
    assert not expression_axes(read_clips(folder), CONTROLS, LEARNT)


@pytest.mark.slow
def test_intensity_is_learnt_from_captured_motion(captures, tmp_path):
    """Strong expressions come with a quiet, high voice, which the base takes for a weak one.

    What no capture shows is moved exactly as before, though the guidance of the rest changed.
    """
    steps = ("train.steps=50", "train.evaluate_every=50", "train.learning_rate=1e-3")
    config = recipe("default", *steps, "data.window_frames=96")
    scores = finetune(config, captures, tmp_path / "run")
    assert scores["after"]["intensity_r"] > max(0.5, scores["before"]["intensity_r"] + 0.5)
    tuned, model = load_model(tmp_path / "run" / "last"), load_model("default")
    assert tuned.config.kept_intensity and not model.config.kept_intensity
    example = load_example(read_clips(captures, "validation")[0], CONTROLS)
    before, after = (predict(network, example)[0] for network in (model, tuned))
    kept = [CONTROLS.index(name) for name in tuned.config.kept_controls]
    assert np.array_equal(before[:, kept], after[:, kept]) and len(kept) == len(CONTROLS) - 3


def test_intensity_stays_the_base_s_unless_an_expression_shows(base, data, captures):
    """The clips of `data` are in one emotion each, and none is neutral but the first."""
    off = FinetuneTask(recipe(base, "tune.intensity=base"), captures)
    assert not off.axes and not off.config.model.kept_intensity and not off.config.loss.contrast
    on = FinetuneTask(recipe(base), captures).config
    assert on.loss.contrast == on.loss.classification == 0.1 and on.loss.intensity == 20
    with pytest.raises(ConfigError, match=r"tune\.intensity=captured: no captured emotion differs"):
        FinetuneTask(recipe(base, "tune.intensity=captured"), data)
