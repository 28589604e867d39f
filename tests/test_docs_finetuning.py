"""docs/finetuning.md: its commands on captures run as written, on takes named as there."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import soundfile

from deitalk.audio.load import load_audio
from deitalk.frontends.whisper import WhisperFrontend
from deitalk.models.checkpoint import load_model
from deitalk.models.folder import describe_model, embedded_models
from deitalk.pipeline.curves import animate
from rig import read_curves, write_curves
from tests.command import ran
from tests.media import write_sound

pytestmark = pytest.mark.usefixtures("empty_pictures")
ROOT = Path(__file__).resolve().parents[1]
APP = ROOT / "deitalk/preview/app/index.html"
"""The page's program, which `make page` builds."""
PAGE = (ROOT / "docs/finetuning.md").read_text(encoding="utf-8")


def commands(verbs: str) -> list[list[str]]:
    """Lines of the page's blocks with one of some verbs, for the takes of `anna`."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", PAGE, re.S | re.M)
    lines = [line for block in blocks for line in block.splitlines()]
    others = ("talk.mp4", "facegood", "my_rig", "my_org", "new_take")
    return [
        shlex.split(line.removeprefix(found[1]))
        for line in lines
        if (found := re.match(f"(deitalk|python -m deitalk.research) ({verbs}) ", line))
        and not any(word in line for word in others)
    ]


@pytest.fixture
def takes(tmp_path, monkeypatch) -> Path:
    """Two takes as Live Link Face leaves them, of a model's curves."""
    monkeypatch.chdir(tmp_path)
    wave = np.tile(load_audio(ROOT / "docs/samples/amiable.flac").waveform, 5)
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


@pytest.fixture
def one_hearing(monkeypatch) -> None:
    """An encoder of equal weights hears equal sound once: no command here changes it."""
    kept, encode = {}, WhisperFrontend.encode

    def once(frontend, waveform, n_frames, *given, **named):
        weights = sum(float(p.detach().double().sum()) for p in frontend.parameters())
        key = (weights, waveform.numpy().tobytes(), n_frames, given, named.get("gain"))
        if key not in kept:
            kept[key] = encode(frontend, waveform, n_frames, *given, **named)
        return kept[key]

    monkeypatch.setattr(WhisperFrontend, "encode", once)


def run(lines: list[list[str]]) -> None:
    for line in lines:
        ran(*line)


@pytest.mark.skipif("default" not in embedded_models(), reason="needs the embedded weights")
def test_python_of_the_page_runs_as_written(takes, one_hearing, capsys, monkeypatch):
    """But for the number of steps."""
    section = PAGE.partition("### From Python\n")[2].partition("\n## ")[0]
    blocks = re.findall(r"^```python\n(.*?)^```", section, re.S | re.M)
    (module,) = (block for block in blocks if "(RigDecoder)" in block)
    (takes / "my_decoders.py").write_text(module)
    monkeypatch.syspath_prepend(str(takes))
    text = "\n".join(block for block in blocks if block != module)
    assert text.count('"train.steps": 160') == 2
    small = '"train.steps": 1, "train.batch_size": 2, "train.workers": 0'
    text = text.replace('"train.steps": 160', small)
    exec(compile(text, "finetuning.md", "exec"), {})
    assert capsys.readouterr().out.startswith("the regression for ")
    for folder in ("runs/anna_again/best", "runs/smooth/best", "runs/recurrent/best", "take_again"):
        assert (takes / folder).is_dir()


@pytest.mark.skipif("default" not in embedded_models(), reason="needs the embedded weights")
def test_commands_from_takes_to_a_dataset_and_a_tuned_model_run_as_written(takes, one_hearing):
    """As written; the takes are two, in an emotion each."""
    lines = commands("data")
    assert [line[1] for line in lines] == ["import", "check", "import", "check", "check"]
    run(lines)
    assert {p.name for p in (takes / "anna_data").iterdir()} >= {"clips.csv", "takes.csv", "check"}
    table = (takes / "anna_data/clips.csv").read_text()
    assert ",happy,anna," in table and ",sad,anna," in table
    assert "`--set train.steps=" in PAGE
    lines = commands("finetune|animate|model mix|folds")
    assert [line[0] for line in lines] == ["finetune", "animate", "folds", "model"]
    run(lines)
    report = json.loads((takes / "runs/anna/report.json").read_text())
    assert {"before", "after", "loudness", "mean pose"} <= report["scores"].keys()
    errors = {name: report["scores"][name]["error_of_mean_pose"] for name in ("after", "mean pose")}
    assert errors["after"] < errors["mean pose"]
    assert (takes / "runs/anna/compare.html").is_file() == APP.is_file()
    files = {p.stat().st_ino: p.stat().st_size for p in (takes / "runs/anna").rglob("*")}
    assert sum(files.values()) < 60e6
    folds = json.loads((takes / "runs/anna_folds/folds.json").read_text())["folds"]
    assert set(folds) == set(pd.read_csv(takes / "anna_data/takes.csv")["take"])
    assert np.isfinite(read_curves(takes / "take/curves.csv").values).all()
    assert describe_model(takes / "softer")["training"]["mixed"]["share"] == 0.6
