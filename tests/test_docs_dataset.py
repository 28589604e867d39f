"""docs/dataset.md: its table names every column, its example is a dataset that trains."""

import re
from pathlib import Path

import numpy as np
import pytest

from deitalk.data import clips as reader
from deitalk.data.checks import inspect_dataset
from deitalk.data.clips import REQUIRED, read_clips, read_intensity, read_phones
from deitalk.data.windows import WindowBatches
from deitalk.research.config import TrainingDataConfig, read_training
from deitalk.research.corpus.build import COLUMNS
from deitalk.research.evaluation.curves import ADULT_YEARS
from rig import default_controls

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/dataset.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The folder made by the Python code of the page."""
    folder = tmp_path_factory.mktemp("page")
    block = next(b for b in re.findall(r"```python\n(.*?)```", PAGE, re.S) if "clips.csv" in b)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile(block, "dataset.md", "exec"), {})
    return folder / "my_captures"


def columns():
    """Column -> whether it is required according to the page."""
    rows = re.findall(r"^\| `(\w+)` \| (yes|no) \|", PAGE, re.M)
    return {name: needed == "yes" for name, needed in rows}


def test_page_names_every_column():
    named = columns()
    assert [name for name, needed in named.items() if needed] == list(REQUIRED)
    listing = reader.__doc__.split("clips.csv             ")[1].split("\n    audio/")[0]
    assert set(named) == set(re.findall(r"\w+", listing))
    assert set(COLUMNS) <= set(named)


def test_page_states_the_numbers_of_the_code():
    assert f"−{reader.MAX_OFFSET_SECONDS:g} to {reader.MAX_OFFSET_SECONDS:g}" in PAGE
    assert f"children (under {ADULT_YEARS})" in PAGE
    for option in re.findall(r"`data\.(\w+)`", PAGE):
        assert option in TrainingDataConfig.model_fields


def test_example_is_read_as_described(example):
    anna, ben = read_clips(example)
    assert (anna.name, anna.emotion, anna.speaker, anna.split) == (
        "anna_01", "happy", "anna", "train",
    )  # fmt: skip
    assert (ben.voice, ben.source, ben.offset_seconds) == ("neutral", "recording", 0)
    assert [phone for _, _, phone in read_phones(anna.phones)] == ["AA", "M", "SIL"]
    assert read_intensity(anna.intensity, np.array([0.75])) == pytest.approx(0.4)


def test_example_has_no_errors(example):
    checks = {check.name: check for check in inspect_dataset(example).checks}
    assert "error" not in {check.level for check in checks.values()}
    for name in ("files", "controls", "lengths", "speakers"):
        assert checks[name].level == "ok", checks[name]


def test_example_gives_training_windows(example):
    config = read_training(ROOT / "configs/tiny.yaml")
    batches = WindowBatches(read_clips(example, "train"), default_controls(), config.data, 0, 2)
    window = next(iter(batches))
    assert window.curves.shape == (2, 32, 185)
    assert window.curves[..., default_controls().index("CTRL_C_jaw.ty")].max() > 0.3
    assert window.emotion.argmax(dim=1).tolist() == [2, 2]


@pytest.mark.slow
def test_example_trains(example, tmp_path):
    from deitalk.research.training.curves import train_curves

    best = train_curves(read_training(ROOT / "configs/tiny.yaml"), example, tmp_path / "run")
    assert best["step"] in (3, 6)


def test_the_folder_becomes_parquet_as_written(example, monkeypatch):
    datasets = pytest.importorskip("datasets", reason="needs the package datasets")
    monkeypatch.chdir(example.parent)
    block = next(b for b in re.findall(r"```python\n(.*?)```", PAGE, re.S) if "to_parquet" in b)
    exec(compile(block, "dataset.md", "exec"), {})
    table = datasets.load_dataset("parquet", data_files="my_captures.parquet")["train"]
    assert table["clip"][:] == ["anna_01", "ben_01"]
    assert np.shape(table[0]["curves"]) == (180, len(default_controls()))
