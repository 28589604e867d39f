"""Training of a small causal model: its command, its parts, and what the sound becomes."""

import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch
import yaml

from deitalk.config.load import load_config
from deitalk.data.augment_waveform import Surroundings
from deitalk.models.checkpoint import load_model
from deitalk.models.folder import GRAPH, model_folder
from deitalk.pipeline.curves import animate
from deitalk.research.config import read_training
from deitalk.research.corpus.performance import split_of
from deitalk.research.training.small_model import (
    RATE,
    ROOM_SAMPLES,
    Chance,
    Changes,
    Sounds,
    at_level,
    joined,
    main,
    rate_at,
)
from tests.dataset import waveform

CONFIG = Path(__file__).resolve().parents[4] / "configs" / "small.yaml"
CPU = torch.device("cpu")
SPEAKER = next(name for name in map(str, range(99)) if split_of(f"made:{name}") == "train")
SMALL = {"width": 16, "heads": 2, "intermediate": 16, "n_mels": 16}


def write(path: Path, sound: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, sound, 16_000, subtype="PCM_16")
    return path


@pytest.fixture
def given(tmp_path) -> list[str]:
    """Arguments of the command: a second of sound, noise, a room and a small configuration."""
    write(tmp_path / "speech/one.flac", waveform(0, 1.2))
    (tmp_path / "speech/made.tsv").write_text(f"path\tspeaker\ttext\none.flac\t{SPEAKER}\tah\n")
    noise = np.random.default_rng(0).normal(0, 0.1, 16_000)
    write(tmp_path / "noise/hiss.flac", noise)
    write(tmp_path / "rooms/hall.flac", np.r_[np.zeros(50), 0.9, 0.2 * noise[:3000]])
    tree = yaml.safe_load(CONFIG.read_text())
    tree["model"] |= {"decoder_channels": 8, "decoder_dilations": [1], "emotion_size": 4}
    tree["model"]["frontend"] |= SMALL
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(tree))
    places = {"noise": "noise", "rooms": "rooms", "config": "small.yaml"}
    named = [word for key, name in places.items() for word in (f"--{key}", str(tmp_path / name))]
    sizes = ["--batch", "2", "--chunk", "2", "--frames", "30"]
    return [str(tmp_path / "speech"), *named, *sizes, "-o", str(tmp_path / "small")]


def test_two_steps_give_a_folder_that_animates(given, tmp_path, capsys):
    main([*given, "--steps", "2"])
    folder = tmp_path / "small"
    assert (folder / GRAPH).is_file()
    assert "step 2: loss" in capsys.readouterr().out
    model, teacher = load_model(folder), load_model("default")
    assert model.rules == read_training(CONFIG).rules
    torch.testing.assert_close(model.lips.shown.weight, teacher.lips.shown.weight)
    assert model.frontend.norms[0].running_var.std() > 0, "measured"
    curves = animate(tmp_path / "speech/one.flac", model=folder).curves
    assert np.isfinite(curves.values).all()
    assert np.ptp(curves.values) > 0


def test_configuration_is_that_of_the_embedded_model():
    stored = load_config(model_folder("small") / "config.yaml")
    assert read_training(CONFIG).model == stored.model
    assert read_training(CONFIG).rules == stored.rules


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--steps", "0"], "'0' must be a whole number of 1 or more"),
        (["--share", "made"], "'made' is not SOURCE=NUMBER"),
        (["--share", "grid=2"], "share grid: no such source in train; name one of made"),
        (["--config", str(CONFIG.with_name("mel.yaml"))], "needs model.frontend of the kind"),
        (["--teacher", "mel"], "teacher mel: has no readout"),
        (["--device", "abacus"], "abacus"),
        (["--held-out", f"made:{SPEAKER}"], "no recording of a training speaker"),
    ],
)
def test_wrong_arguments_are_one_line_and_nothing_is_written(
    given, tmp_path, capsys, change, message
):
    with pytest.raises(SystemExit):
        sys.exit(main([*given, *change]))
    assert message in capsys.readouterr().err
    assert not (tmp_path / "small").exists()


def test_recordings_are_joined_without_silent_ends_at_one_level(tmp_path):
    tone = np.sin(2 * np.pi * 200 / 16_000 * np.arange(16_000))
    quiet, silence = np.zeros(20_000), write(tmp_path / "none.wav", np.zeros(4000))
    paths = [
        write(tmp_path / f"{k}.wav", np.r_[quiet, gain * tone, quiet])
        for k, gain in enumerate((0.5, 0.05))
    ]
    sound = joined([*paths, silence]) / 32767
    halves = np.split(sound, 2)
    assert len(halves[0]) == pytest.approx(16_000 + 2 * 4800, abs=10)
    levels = [np.sqrt(np.mean(half**2)) for half in halves]
    np.testing.assert_allclose(levels, 0.06, rtol=0.02)


def test_a_source_that_is_drawn_more_often_gives_more_windows(tmp_path):
    times = np.arange(16_000) / 16_000
    paths = {
        name: [write(tmp_path / f"{name}.wav", 0.1 * np.sin(2 * np.pi * hertz * times))]
        for name, hertz in (("low", 100), ("high", 1000))
    }
    sounds = Sounds(paths, {"high": 3.0}, 4000, CPU)
    windows = sounds.windows(1000, Chance(0, CPU), at_any_speed=True)
    assert windows.shape == (1000, 4000)
    crossings = (windows[:, 1:].sign() != windows[:, :-1].sign()).sum(1)
    is_high = (crossings > 150).float().mean()
    assert is_high == pytest.approx(0.75, abs=0.05)


def test_changed_windows_keep_their_time_and_differ_in_level():
    """The loudest moment of a click stays where it is in most rooms and colours."""
    click = torch.zeros(64, 8000)
    click[:, 3000:3400] = torch.sin(torch.arange(400) / 3)
    rng = np.random.default_rng(0)
    room = np.r_[np.zeros(700), 1, 0.05 * rng.normal(size=ROOM_SAMPLES)].astype(np.float32)
    noise = rng.normal(0, 0.1, 5000).astype(np.float32)
    changes = Changes(Surroundings((noise,), (room,)), 8000, Chance(0, CPU))
    changed = changes(at_level(click))
    assert changed.shape == click.shape
    assert torch.isfinite(changed).all()
    inside = changed[:, 2950:3450].square().mean(1) > changed[:, :2500].square().mean(1)
    assert inside.float().mean() > 0.9
    assert changed.std(1).log10().std() > 0.2


def test_rate_rises_and_falls():
    rates = [rate_at(share) for share in (0, 0.02, 0.04, 0.52, 1)]
    np.testing.assert_allclose(rates, RATE * np.array([0.02, 0.52, 1, 0.5, 0]), atol=2e-6)
