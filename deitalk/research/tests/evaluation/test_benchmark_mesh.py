"""SDFA's Table 4 on a short clip: rows, columns, sizes, and the shared spectra."""

import json

import pytest
from typer.testing import CliRunner

from deitalk.research.cli import app
from deitalk.research.evaluation import benchmark_mesh as mesh_timing
from deitalk.research.evaluation.benchmark_mesh import PUBLISHED, STAGES, as_markdown, table_4
from tests.closeness import SHARE
from tests.command import ran


@pytest.mark.slow  # the recogniser's 123 million weights
def test_table_4_of_a_short_clip_has_every_stage():
    report = table_4(threads=1, repeats=1, seconds=0.3)
    assert report["frames"] == 18
    assert list(report["milliseconds"]) == list(PUBLISHED)
    for name, stages in report["milliseconds"].items():
        is_solved = name == "SDFA"
        for stage in STAGES:
            has_stage = is_solved or stage not in ("set static mesh", "reconstruct mesh")
            assert (stages[stage] is not None) == has_stage
        assert stages["total with loading"] > stages["audio feature"]
    windows = report["per_window"]
    assert windows["largest_difference"] < SHARE * windows["largest"]
    # 85 and 180 components of 8,434 triangles, their means and deviations, float32.
    numbers = 8434 * (6 * 86 + 3 * 181) + 85 + 180
    assert report["megabytes"]["SDFA"]["fixed"] == pytest.approx(4 * numbers / 2**20)
    recogniser = report["megabytes"]["VOCA-style"]["recogniser"]
    assert recogniser == pytest.approx(477.3, rel=0.03)  # SDFA §4.4: VOCA with DeepSpeech
    assert "| audio feature |" in as_markdown(report)


def test_command_prints_the_table(monkeypatch):
    row = dict.fromkeys(STAGES, 1.5)
    report = {
        "frames": 306,
        "threads": 2,
        "milliseconds": {name: row for name in PUBLISHED},
        "megabytes": {name: {"trained": 2.0, "fixed": 3.0} for name in PUBLISHED},
        "recogniser_ms": 100.0,
        "per_window": {"shared_ms": 10.0, "windows_ms": 50.0, "ratio": 5.0,
                       "largest_difference": 1e-7, "largest": 1.0},
    }  # fmt: skip
    calls = []
    monkeypatch.setattr(mesh_timing, "table_4", lambda *given: calls.append(given) or report)
    result = ran("evaluate", "--speed", "--mesh", "--threads", "2")
    assert calls == [(2, 3)]
    assert "| audio feature | 1.5 | 376 | 1.5 | 9253 | 1.5 | 4201 |" in result.output
    assert "5.0 times 10" in result.output
    result = CliRunner().invoke(app, ["evaluate", "--speed", "--mesh", "--json"])
    assert json.loads(result.output.splitlines()[-1])["frames"] == 306
