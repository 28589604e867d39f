"""Lines of a batch that follow one another."""

import json

import numpy as np
import pytest
import soundfile

from deitalk import animate
from deitalk.research.evaluation.benchmark_curves import speechlike
from rig import read_curves
from tests.deitalk.batch.conftest import InProcess
from tests.deitalk.batch.test_run import files, status


def scene(lines, rng, count):
    """A manifest of a scene: each line begins where the one before it ends."""
    table = ["audio,after"]
    for number in range(count):
        sound = speechlike(0.5 + 0.1 * (number % 4)) + 0.02 * rng.standard_normal(1)
        soundfile.write(lines / f"{number:03}.wav", sound, 16_000)
        before = f"{number - 1:03}" if number else ""
        table.append(f"{number:03}.wav,{before}")
    order = [table[0], *sorted(table[1:], key=lambda row: row[::-1])]  # not that of the scene
    path = lines / "scene.csv"
    path.write_text("\n".join(order) + "\n")
    return path


def test_lines_of_a_scene_begin_where_those_before_end(run, lines, model, rng):
    report = run(scene(lines, rng, 5), emotion="happy", formats="take")
    assert status(report) == {f"{k:03}": "done" for k in range(5)}
    before = None
    for k in range(5):
        wanted = animate(lines / f"{k:03}.wav", "happy", model=model, after=before)
        found = read_curves(run.out / f"{k:03}/curves.json")
        assert np.abs(found.values - wanted.curves.values).max() < 1e-4
        before = wanted
    assert len({json.dumps(take["traits"]) for take in takes_of(run.out)}) == 1


def takes_of(out):
    return [json.loads(path.read_text()) for path in sorted(out.glob("*/take.json"))]


def test_scene_is_the_same_whatever_the_order_of_the_work(run, lines, model, rng, monkeypatch):
    table = scene(lines, rng, 6)
    run(table, out=run.out / "one")
    monkeypatch.setattr(InProcess, "run", backwards(InProcess.run))
    run(table, out=run.out / "other")
    rows = table.read_text().splitlines()
    (lines / "again.csv").write_text("\n".join([rows[0], *rows[:0:-1]]) + "\n")
    run(lines / "again.csv", out=run.out / "third")
    for other in ("other", "third"):
        for path in sorted((run.out / "one").glob("0*.csv")):
            assert path.read_bytes() == (run.out / other / path.name).read_bytes()


def backwards(ordered):
    def run_backwards(workers, orders):
        return ordered(workers, orders[::-1])

    return run_backwards


def test_scene_goes_on_where_it_was(run, orders, lines, rng):
    table = scene(lines, rng, 6)
    first = run(table)
    assert first.counts["done"] == 6
    whole = files(run.out)
    orders.clear()
    assert run(table).counts["unchanged"] == 6 and not orders
    (run.out / "003.csv").unlink()
    assert status(run(table))["003"] == "done" and [o.output for o in orders] == ["003"]
    assert files(run.out).items() >= {k: v for k, v in whole.items() if k[0] == "0"}.items()


def test_changed_line_changes_those_after_it(run, orders, lines, rng):
    table = scene(lines, rng, 4)
    run(table)
    soundfile.write(lines / "002.wav", speechlike(0.9)[::-1], 16_000)
    orders.clear()
    assert status(run(table)) == {
        "000": "unchanged", "001": "unchanged", "002": "done", "003": "done"
    }  # fmt: skip


def test_line_that_is_followed_later_is_made_again_and_is_the_same(run, lines, rng):
    """The edges of a line are kept only where another needs them."""
    table = scene(lines, rng, 2)
    rows = table.read_text().splitlines()
    first = next(row for row in rows if row.startswith("000"))
    table.write_text(f"{rows[0]}\n{first}\n")
    run(table)
    before = (run.out / "000.csv").read_bytes()
    table.write_text("\n".join(rows) + "\n")
    assert set(status(run(table)).values()) == {"done"}
    assert (run.out / "000.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("rows", "failed"),
    [
        ({"000": "001", "001": "000", "002": ""}, {"000": "waits for it", "001": "waits for it"}),
        ({"000": "000"}, {"000": "waits for it"}),
        ({"000": "", "001": "nowhere"}, {"001": "no take"}),
        ({"absent": "", "001": "absent", "002": "001"},
         {"absent": "no recording", "001": "was not made", "002": "was not made"}),
    ],
)  # fmt: skip
def test_lines_that_have_nothing_to_follow_fail_alone(run, lines, rng, rows, failed):
    scene(lines, rng, 3)
    table = lines / "lines.csv"
    cells = (f"{name}.wav,{name},{after}" for name, after in rows.items())
    table.write_text("\n".join(["audio,output,after", *cells]) + "\n")
    report = run(table)
    found = {row.output: row.error for row in report.failed}
    assert found.keys() == failed.keys()
    for name, words in failed.items():
        assert words in found[name] and "\n" not in found[name]


def test_line_leads_into_a_line_that_is_made_first(run, lines, model, rng):
    scene(lines, rng, 2)
    (lines / "lines.csv").write_text("audio,into\n000.wav,001\n001.wav,\n")
    assert run(lines / "lines.csv", formats="npz").counts["done"] == 2
    after = animate(lines / "001.wav", model=model)
    wanted = animate(lines / "000.wav", model=model, into=after)
    found = read_curves(run.out / "000.npz")
    assert np.abs(found.values - wanted.curves.values).max() < 1e-4
