"""`data check --fix`: what is planted is written back, all else stays."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from deitalk.audio.load import load_audio, write_wav
from deitalk.cli.data import app
from deitalk.data.captures.imported import import_captures
from deitalk.data.captures.mend import rename_emotions
from deitalk.data.checks import inspect_dataset
from deitalk.data.clips import read_clips, read_known
from deitalk.models.checkpoint import load_model
from deitalk.pipeline.curves import animate
from rig import RigCurves, default_controls, read_curves, write_curves
from tests.deitalk.cli.test_cli import ROOT
from tests.deitalk.data.captures.test_import import rows_of
from tests.written import changed_files

CONTROLS = default_controls()
JAW = "CTRL_C_jaw.ty"
LATE = 6 / 30
OPEN = 0.08


@pytest.fixture(scope="module")
def takes(tmp_path_factory) -> Path:
    """Two takes with silence around: one in time, one 6 frames late; the jaw rests at 0.08."""
    folder = tmp_path_factory.mktemp("takes")
    model = load_model("live")
    for name, late in (("amiable", 0.0), ("promise", LATE)):
        speech = load_audio(ROOT / f"docs/samples/{name}.flac").waveform
        quiet = 1e-4 * np.random.default_rng(0).standard_normal(40_000).astype(np.float32)
        wave = np.concatenate([quiet, speech, quiet])
        write_wav(folder / f"{name}.wav", wave)
        curves = animate(folder / f"{name}.wav", "neutral", model=model, life="off").curves
        values = curves.values.copy()
        values[:, curves.index(JAW)] = OPEN + (1 - OPEN) * values[:, curves.index(JAW)]
        moved = np.roll(values, round(late * curves.fps), axis=0)
        write_curves(folder / f"{name}.npz", RigCurves(moved, curves.names, fps=curves.fps))
    return folder


@pytest.fixture
def data(takes, tmp_path) -> Path:
    labels = {"actor": "anna", "emotion": "neutral"}
    import_captures([takes], tmp_path / "data", **labels, keep_listening=True)
    return tmp_path / "data"


def test_offset_of_the_late_take_and_the_open_jaw_are_found_and_fixed(data):
    found = {c.name: c for c in inspect_dataset(data).checks}
    assert found["offset"].level == "warning" and "promise (+" in found["offset"].text
    assert "amiable" not in found["offset"].text
    assert found["rest pose"].level == "warning" and JAW in found["rest pose"].text
    imported = {row["clip"]: float(row["offset_s"]) for row in rows_of(data)}
    before = {p: p.read_bytes() for p in data.rglob("*") if p.is_file()}

    done = CliRunner().invoke(app, ["check", str(data), "--fix"])
    assert done.exit_code == 0, done.output
    assert "fixed: offset of 1 takes, rest pose of anna" in done.stderr

    for row in rows_of(data):
        expected = -LATE if row["take"] == "promise" else 0.0
        moved = float(row["offset_s"]) - imported[row["clip"]]
        assert moved == pytest.approx(expected, abs=1 / 60)  # half a frame
        assert row["curves"].startswith("mended/") and row["known"] == "mended/known-1.txt"
        jaw = read_curves(data / row["curves"])[JAW]
        assert float(np.percentile(jaw, 10)) < 0.02
    known = read_known(data / "mended/known-1.txt", CONTROLS)
    assert known[CONTROLS.index(JAW)] and not known[CONTROLS.index("CTRL_lookAtSwitch.ty")]
    kept = ("audio", "curves", "known")
    assert all(p.read_bytes() == b for p, b in before.items() if p.parent.name in kept)
    assert (data / "check/clips.csv").read_bytes() == before[data / "clips.csv"]
    report = (data / "check/report.md").read_text()
    assert "| promise | anna |" in report and "Rest pose of anna" in report
    assert changed_files(data) == []

    again = {c.name: c for c in inspect_dataset(data).checks}
    assert {again[n].level for n in ("offset", "rest pose", "dead")} == {"ok"}
    table = (data / "clips.csv").read_bytes()
    assert CliRunner().invoke(app, ["check", str(data), "--fix"]).exit_code == 0
    assert (data / "clips.csv").read_bytes() == table


def test_labels_edited_by_hand_survive_the_fix(data):
    path = data / "clips.csv"
    path.write_text(path.read_text().replace(",neutral,anna", ",Happiness,anna"))
    assert rename_emotions(data) == len(rows_of(data))
    assert {clip.emotion for clip in read_clips(data)} == {"happy"}


def test_fix_needs_takes_and_all_clips(tmp_path, data):
    assert "leave --most out" in str(
        CliRunner().invoke(app, ["check", str(data), "--fix", "--most", "1"]).exception
    )
    text = (data / "clips.csv").read_text()
    (data / "clips.csv").write_text(text.replace(",take,", ",old,"))
    result = CliRunner().invoke(app, ["check", str(data), "--fix"])
    assert "no clip states its take" in str(result.exception)
