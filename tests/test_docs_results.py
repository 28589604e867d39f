"""Numbers in documents are those of the reports in docs/results, which are of today's weights."""

import hashlib
import json
import sys
from pathlib import Path

import pytest
from safetensors.numpy import load_file

from deitalk.models.folder import embedded_models, model_folder, weight_files, weights_hash

ROOT = Path(__file__).resolve().parents[1]
RESULTS = sorted((ROOT / "docs/results").glob("*.json"))


sys.path.insert(0, str(ROOT / "docs"))
import make_reports  # noqa: E402
import make_results as maker  # noqa: E402
from result_tables import models  # noqa: E402
from result_tables.commands import COMMANDS, GROUPS, PLACES  # noqa: E402


def test_tables_are_those_of_the_reports():
    for path in maker.DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        assert text == maker.written(text), f"{path.name}: run `make docs`"


@pytest.mark.parametrize("path", RESULTS)
def test_reports_are_of_the_weights_of_today(path):
    """New weights need a new evaluation: `python docs/make_reports.py --group weights`."""
    report = json.loads(path.read_text(encoding="utf-8"))
    if report.get("model") in embedded_models():
        assert report["sha256"] == weights_hash(model_folder(report["model"]))
    for file, sha256 in report.get("files", {}).items():
        assert sha256 == hashlib.sha256((ROOT / file).read_bytes()).hexdigest()


def test_reports_and_commands_are_the_same():
    assert {path.stem for path in RESULTS} == {*COMMANDS}
    assert len(COMMANDS) == sum(map(len, GROUPS.values()))


def test_sizes_are_those_of_the_weights():
    """Of a model's own files: `live` has the encoder of `default`."""
    for name in embedded_models():
        folder = model_folder(name)
        files = [load_file(path) for path in weight_files(folder) if path.parent == folder]
        assert models.numbers(name) == sum(part.size for file in files for part in file.values())


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_can_be_run_with_its_places(name, tmp_path):
    places = {word: str(tmp_path / "data") for word in PLACES}
    words = make_reports.filled(COMMANDS[name], places, tmp_path)
    assert not any(word.split("/")[0] in ("corpus", "LIPS", "OUT", "lips_rig") for word in words)
    command, file = make_reports.runnable(words, tmp_path / "report.json")
    assert command[0] == sys.executable
    assert file is not None or "--json" in command
    assert file is None or "--speed" not in command  # which prints its report
