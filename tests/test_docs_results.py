"""Numbers in documents are those of the reports in docs/results, which are of today's weights."""

import importlib.util
import json
from pathlib import Path

import pytest

from deitalk.models.folder import embedded_models, model_folder, weights_hash

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
RESULTS = sorted((ROOT / "docs/results").glob("*.json"))


@pytest.fixture(scope="module")
def maker():
    path = ROOT / "docs/make_results.py"
    module = importlib.util.module_from_spec(
        spec := importlib.util.spec_from_file_location("make_results", path)
    )
    spec.loader.exec_module(module)
    return module


def test_tables_are_those_of_the_reports(maker):
    for path in maker.DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        assert "<!-- table " in text
        assert text == maker.written(text), f"{path.name}: run `make docs`"


def test_changed_report_changes_the_table(maker, monkeypatch):
    changed = json.loads(json.dumps(maker.report("default-test")))
    changed["groups"]["librispeech"]["bilabial_window_auc"] = 0.5
    read = maker.report
    monkeypatch.setattr(maker, "report", lambda n: changed if n == "default-test" else read(n))
    alone = maker.short(changed["network"]["librispeech"]["bilabial_window_auc"])
    assert f"| bilabial AUC, windows | .500 ({alone}) |" in maker.written(
        maker.DOCUMENTS[0].read_text(encoding="utf-8")
    )


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_reports_are_of_the_weights_of_today(path):
    """New weights need a new evaluation: `deitalk evaluate default ... -o docs/results/...`."""
    report = json.loads(path.read_text(encoding="utf-8"))
    if report.get("model") in embedded_models():
        assert report["sha256"] == weights_hash(model_folder(report["model"]))


def test_every_report_has_its_command(maker):
    assert {path.stem for path in RESULTS} <= set(maker.COMMANDS)


def test_score_of_one_seed_has_no_deviation(maker):
    scores = {"lpe": {"mean": 0.0421, "sd": float("nan"), "n": 1}, "epe": {"mean": None, "n": 0}}
    assert [maker._spread(scores, name) for name in scores] == ["42.1", "–"]
    scores["lpe"] |= {"sd": 0.001, "n": 2}
    assert maker._spread(scores, "lpe") == "42.1 ± 1.0"


def test_number_is_written_without_its_zero(maker):
    assert [maker.short(x) for x in (0.9588, 1.0, -0.25, 0.0)] == [".959", "1.000", "-.250", ".000"]
    assert maker.short(10.54, 1) == "10.5"


def test_readme_has_the_scores_of_the_card(maker):
    rows = {
        name: next(row for row in README.splitlines() if row.startswith(f"| `{name}`"))
        for name in ("default", "live")
    }
    for name, row in rows.items():
        auc = maker.report(f"{name}-test")["groups"]["librispeech"]["bilabial_window_auc"]
        lips = maker.report(f"{name}-lips")["animated"]["mean"]
        opening, jaw = (maker.short(lips[f"{measure} r"], 2) for measure in ("opening", "jaw"))
        assert f"bilabial AUC {maker.short(auc)};" in row
        assert f"opening {opening}, jaw {jaw}" in row
    speed = maker.report("default-speed")["clip"]["rtf_cpu"]
    assert f"real-time factor {maker.short(speed)}" in rows["default"]
