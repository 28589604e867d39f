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
from result_tables import common, models, speed  # noqa: E402
from result_tables.commands import COMMANDS, GROUPS, PLACES, WEIGHTS  # noqa: E402


@pytest.fixture
def changed(tmp_path, monkeypatch):
    """A copy of the results, in which a report can be changed."""
    for path in RESULTS:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(common, "RESULTS", tmp_path)
    common.report.cache_clear()

    def change(name, *keys, value):
        whole = found = json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
        for key in keys[:-1]:
            found = found[key]
        found[keys[-1]] = value
        (tmp_path / f"{name}.json").write_text(json.dumps(whole), encoding="utf-8")
        common.report.cache_clear()

    yield change
    common.report.cache_clear()


def test_tables_are_those_of_the_reports():
    for path in maker.DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        assert text == maker.written(text), f"{path.name}: run `make docs`"


def test_every_report_stands_in_a_table(changed):
    """With its report gone, some table cannot be written."""
    for path in RESULTS:
        (common.RESULTS / path.name).rename(common.RESULTS / "gone")
        common.report.cache_clear()
        with pytest.raises(FileNotFoundError):
            for table in maker.TABLES.values():
                table()
        (common.RESULTS / "gone").rename(common.RESULTS / path.name)


@pytest.mark.parametrize(
    ("page", "row", "keys"),
    [
        (
            "MODEL_CARD.md",
            "| bilabial AUC, windows | .123 (",
            ("default-test", "groups", "librispeech", "bilabial_window_auc"),
        ),
        ("README.md", "| .12 / ", ("default-lips", "animated", "mean", "opening r")),
        ("README.md", "| .123 |", ("default-speed", "clip", "rtf_cpu")),
        (
            "docs/life.md",
            "| lids | .12 (",
            ("motion-energy", "takes", "neutral", "lids", 0),
        ),
    ],
)
def test_changed_report_changes_the_table(changed, page, row, keys):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert row not in text
    changed(*keys, value=0.123)
    assert row in maker.written(text)


@pytest.mark.parametrize("path", RESULTS)
def test_reports_are_of_the_weights_of_today(path):
    """New weights need a new evaluation: `python docs/make_reports.py --group weights`."""
    report = json.loads(path.read_text(encoding="utf-8"))
    if report.get("model") in embedded_models():
        assert report["sha256"] == weights_hash(model_folder(report["model"]))
    for file, sha256 in report.get("files", {}).items():
        assert sha256 == hashlib.sha256((ROOT / file).read_bytes()).hexdigest()


def test_reports_of_the_weights_name_them():
    for name in WEIGHTS:
        assert common.report(name)["model"] in embedded_models(), name


def test_reports_and_commands_are_the_same():
    assert {path.stem for path in RESULTS} == {*COMMANDS}
    assert len(COMMANDS) == sum(map(len, GROUPS.values()))


def test_times_state_the_machine_and_are_of_one():
    for name in GROUPS["timing"]:
        assert {"processor", "cores"} <= set(common.report(name)["machine"]), name


def test_times_of_two_machines_share_no_table(changed):
    changed("mesh-speed-2", "machine", "processor", value="another")
    with pytest.raises(ValueError, match="different machines"):
        speed.table_4()


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


def test_place_that_is_missing_or_unknown_is_named(tmp_path):
    with pytest.raises(ValueError, match="LIPS is needed"):
        make_reports.filled(COMMANDS["default-lips"], {}, tmp_path)
    with pytest.raises(ValueError, match="must be WORD=PATH"):
        make_reports.read_places(None, ["LIP=x"])


def test_command_that_fails_leaves_the_report(tmp_path, monkeypatch):
    monkeypatch.setattr(make_reports, "RESULTS", tmp_path)
    monkeypatch.setitem(make_reports.COMMANDS, "head-motion", "python -m rig.absent LIPS")
    (tmp_path / "head-motion.json").write_text("before")
    with pytest.raises(ValueError, match="wrote no report"):
        make_reports.make("head-motion", {"LIPS": str(tmp_path / "none")})
    assert (tmp_path / "head-motion.json").read_text() == "before"
