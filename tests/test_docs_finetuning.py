"""docs/finetuning.md: its commands on captures run as written, on takes named as there."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

from deitalk.audio.load import load_audio
from deitalk.cli import app
from deitalk.data.captures.sync import LEAST_CORRELATION, SHIFTED_SECONDS
from deitalk.data.captures.take import LEAST_JAW
from deitalk.models.checkpoint import load_model
from deitalk.models.folder import embedded_models
from deitalk.pipeline.curves import animate
from rig import write_curves
from tests.media import write_sound

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/finetuning.md").read_text(encoding="utf-8")


def commands() -> list[list[str]]:
    """Lines of the page's blocks that begin with ``deitalk data``."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", PAGE, re.S | re.M)
    lines = [line for block in blocks for line in block.splitlines()]
    return [
        shlex.split(line)[1:]
        for line in lines
        if line.startswith("deitalk data ") and "talk.mp4" not in line
    ]


@pytest.fixture
def takes(tmp_path, monkeypatch) -> Path:
    """Two takes as Live Link Face leaves them, of a model's curves."""
    monkeypatch.chdir(tmp_path)
    wave = np.tile(load_audio(ROOT / "docs/samples/amiable.flac").waveform, 2)
    for number, emotion in enumerate(("happy", "sad"), 1):
        name = f"anna_{emotion}_{number}"
        folder = tmp_path / "takes" / f"20260311_{name}"
        folder.mkdir(parents=True)
        soundfile.write(tmp_path / "speech.wav", wave, 16_000)
        curves = animate(tmp_path / "speech.wav", emotion, model=load_model("live")).curves
        write_curves(folder / f"{name}_iPhone.csv", curves, format="livelink")
        write_sound(folder / f"{name}_iPhone.mov", wave[:, None], 16_000, picture=True)
        (folder / "take.json").write_text("{}")
    return tmp_path


@pytest.mark.skipif("default" not in embedded_models(), reason="needs the embedded weights")
def test_commands_from_a_take_to_a_checked_dataset_run_as_written(takes):
    lines = commands()
    assert [line[1] for line in lines] == ["import", "check", "import", "check", "check"]
    for line in lines:
        done = CliRunner().invoke(app, line)
        assert done.exit_code == 0, (line, done.output, done.exception)
    assert {p.name for p in (takes / "anna_data").iterdir()} >= {"clips.csv", "takes.csv", "check"}
    table = (takes / "anna_data/clips.csv").read_text()
    assert ",happy,anna," in table and ",sad,anna," in table


def test_numbers_of_the_page_are_those_of_the_code():
    assert f"from {SHIFTED_SECONDS * 1000:g} ms" in PAGE
    assert f"{LEAST_JAW:g}²" in PAGE and LEAST_CORRELATION < 0.38
