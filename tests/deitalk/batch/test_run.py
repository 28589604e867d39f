"""A whole batch: outputs, what is done again, what is refused."""

import csv
import os
import shutil
from functools import partial

import numpy as np
import pytest
import soundfile

from deitalk import animate
from deitalk.batch.performer import Performer
from deitalk.batch.source import FAILED, SUMMARY
from deitalk.emotions import read_actor
from deitalk.errors import CheckpointError, DataError, DeitalkError
from deitalk.models.curve_model import DEITalk
from deitalk.research.evaluation.benchmark_curves import speechlike
from rig import read_curves
from rig.errors import TargetError
from tests.deitalk.batch.conftest import InProcess
from tests.interrupt import count_writes, kill_at_write
from tests.written import changed_files


def table(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def status(report):
    return {row.output: row.status for row in report.rows}


def files(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and ".deitalk-batch" not in path.parts
    }


def test_outputs_are_those_of_animate(run, lines, model, tmp_path):
    report = run(emotion="happy", formats="csv;npz")
    assert status(report) == {"anna/a": "done", "anna/b": "done", "c": "done"}
    animate(lines / "anna" / "a.wav", "happy", model=model).save(tmp_path / "one.csv")
    assert (run.out / "anna/a.csv").read_bytes() == (tmp_path / "one.csv").read_bytes()
    assert len(read_curves(run.out / "c.npz")) == 15
    rows = table(run.out / SUMMARY)
    assert [float(row["seconds"]) for row in rows] == [0.6, 0.7, 0.5]
    assert not (run.out / FAILED).exists() and report.out == str(run.out)


class OnGpu(Performer):
    """Reads lines together, as on a GPU."""

    def __init__(self, *given, **named):
        super().__init__(*given, **named)
        self.together = 100


def test_lines_that_a_gpu_reads_together_are_those_of_animate(run, lines, model, rng, monkeypatch):
    """Of any lengths, to rounding; and each alone where that fails."""
    monkeypatch.setattr("deitalk.batch.run.Performer", OnGpu)
    calls = []
    read = DEITalk.read_together
    monkeypatch.setattr(DEITalk, "read_together", lambda *given: calls.append(1) or read(*given))
    for number in range(10):
        sound = speechlike(0.8) + 0.02 * rng.standard_normal(12_800)
        soundfile.write(lines / f"{number}.wav", sound[: 12_800 - 700 * number], 16_000)
    assert run(emotion="happy", formats="npz").counts["done"] == 13 and len(calls) > 1
    for number in range(10):
        alone = animate(lines / f"{number}.wav", "happy", model=model).curves
        found = read_curves(run.out / f"{number}.npz")
        np.testing.assert_allclose(found.values, alone.values, atol=1e-5)
    monkeypatch.setattr(DEITalk, "read_together", None)
    assert run(emotion="sad").counts["done"] == 13


def test_take_folders_are_those_of_animate(run, lines):
    run(formats="take", fps=60)
    take = run.out / "anna" / "a"
    assert len(read_curves(take / "curves.csv")) == 2 * 18
    assert {"take.json", "audio.wav", "intensity.csv", "a.unreal.json"} <= set(os.listdir(take))
    assert changed_files(take) == []
    assert run(formats="take", fps=60).counts["unchanged"] == 3


def test_second_run_does_nothing(run, orders):
    run()
    before = files(run.out)
    orders.clear()
    report = run()
    assert report.counts == {"done": 0, "unchanged": 3, "edited": 0, "failed": 0}
    assert not orders
    assert {n: d for n, d in files(run.out).items() if "/" in n} == {
        n: d for n, d in before.items() if "/" in n
    }


def test_changed_row_is_the_only_one_done_again(run, orders, lines):
    manifest = lines / "lines.csv"
    manifest.write_text("audio,emotion\nanna/a.wav,happy\nanna/b.wav,happy\n")
    run(manifest)
    before = files(run.out)
    manifest.write_text("audio,emotion\nanna/a.wav,happy\nanna/b.wav,sad\nc.flac,sad\n")
    orders.clear()
    assert status(run(manifest)) == {"anna/a": "unchanged", "anna/b": "done", "c": "done"}
    assert [order.output for order in orders] == ["anna/b", "c"]
    after = files(run.out)
    assert after["anna/a.csv"] == before["anna/a.csv"]
    assert after["anna/b.csv"] != before["anna/b.csv"]


@pytest.mark.parametrize(("formats", "is_named"), [("csv;npz", True), ("csv;livelink", False)])
def test_a_time_code_that_no_format_has_is_a_warning(run, formats, is_named):
    for row in run(formats=formats, timecode="10:00:00:00").rows:
        assert ("starts at 0" in row.warnings) is is_named


def test_recording_counts_by_its_bytes(run, orders, lines):
    run()
    sound = lines / "anna" / "a.wav"
    os.utime(sound, (1, 1))
    soundfile.write(lines / "c.flac", speechlike(0.9), 16_000)
    assert status(run()) == {"anna/a": "unchanged", "anna/b": "unchanged", "c": "done"}
    orders.clear()
    run()
    assert not orders, "the new time of the recording is kept"


def test_settings_and_model_are_part_of_the_key(run, lines, model, tmp_path):
    run()
    assert run(intensity=2.0).counts["done"] == 3
    other = shutil.copytree(model, tmp_path / "other")
    config = other / "config.yaml"
    config.write_text(config.read_text().replace("peak: 0.25", "peak: 0.3"))
    assert run(intensity=2.0, model=str(other)).counts["done"] == 3


def test_onnx_gives_the_curves_of_torch(run, tmp_path):
    """Of the embedded model: the small one of the other tests has no graph."""
    for backend in ("torch", "onnx"):
        done = run(out=tmp_path / backend, formats="npz", backend=backend, model="default")
        assert done.counts["done"] == 3
    for name in ("c.npz", "anna/a.npz"):
        found, wanted = (read_curves(tmp_path / backend / name) for backend in ("onnx", "torch"))
        np.testing.assert_allclose(found.values, wanted.values, atol=1e-4)


def test_content_of_a_track_is_part_of_the_key(run, lines):
    manifest, track = lines / "lines.csv", lines / "moods.csv"
    manifest.write_text("audio,emotion\nanna/a.wav,moods.csv\n")
    track.write_text("time,emotion,strength\n0,happy,1\n")
    assert status(run(manifest)) == {"anna/a": "done"}
    os.utime(track, (1, 1))
    assert status(run(manifest)) == {"anna/a": "unchanged"}
    track.write_text("time,emotion,strength\n0,sad,1\n")
    assert status(run(manifest)) == {"anna/a": "done"}


def test_edited_output_stays(run):
    run()
    (run.out / "c.csv").write_text("edited")
    assert status(run())["c"] == "edited"
    report = run(emotion="happy")
    assert status(report)["c"] == "failed" and "was changed since" in report.failed[0].error
    assert (run.out / "c.csv").read_text() == "edited"


def test_file_of_the_user_is_never_replaced(run):
    run(formats="npz")
    (run.out / "c.csv").write_text("mine")
    (run.out / "anna" / "b").mkdir()
    (run.out / "anna" / "b" / "take.json").write_text("mine")
    report = run(formats="csv;take")
    assert status(report) == {"anna/a": "done", "anna/b": "failed", "c": "failed"}
    assert (run.out / "c.csv").read_text() == "mine"
    assert (run.out / "anna/b/take.json").read_text() == "mine"
    assert (run.out / "c.npz").is_file() and not (run.out / "anna" / "a.npz").exists()


@pytest.mark.parametrize("formats", ["csv", "take"])
def test_file_put_at_an_output_meanwhile_stays(run, orders, monkeypatch, tmp_path, formats):
    """Between the check before the first line and the end of its own."""
    out = tmp_path / "meanwhile"
    mine = out / ("c.csv" if formats == "csv" else "c/take.json")
    perform = InProcess.run

    def put_first(self, orders):
        mine.parent.mkdir(parents=True, exist_ok=True)
        mine.write_text("mine")
        yield from perform(self, orders)

    monkeypatch.setattr(InProcess, "run", put_first)
    report = run(out=out, formats=formats)
    assert status(report) == {"anna/a": "done", "anna/b": "done", "c": "failed"}
    assert mine.read_text() == "mine"


def test_bad_lines_are_reported_and_the_others_done(run, lines):
    (lines / "broken.wav").write_bytes(b"RIFF no sound")
    (lines / "empty.wav").touch()
    manifest = lines / "lines.csv"
    manifest.write_text(
        "audio,emotion\nbroken.wav,\nempty.wav,\nnone.wav,\nc.flac,hapy\nanna/a.wav,\n"
    )
    report = run(manifest)
    assert report.counts == {"done": 1, "unchanged": 0, "edited": 0, "failed": 4}
    rows = table(run.out / FAILED)
    assert [row["number"] for row in rows] == ["1", "2", "3", "4"]
    for row, words in zip(rows, ("audio", "0 bytes", "no recording", "hapy"), strict=True):
        assert words in row["error"]
    (lines / "none.wav").write_bytes((lines / "anna" / "a.wav").read_bytes())
    assert status(run(manifest))["none"] == "done"


def test_killed_batch_goes_on_without_loss(run, lines, tmp_path):
    """Killed at any write, the next run gives the files of an uninterrupted one."""
    run(out=tmp_path / "whole", formats="csv;npz")
    whole = files(tmp_path / "whole")
    root = tmp_path / "outs"
    root.mkdir()
    writes = count_writes(root, lambda: run(out=root / "count", formats="csv;npz"))
    assert writes > 20
    for number in range(2, writes, 5):
        out = root / str(number)
        kill_at_write(number, root, partial(run, out=out, formats="csv;npz"))
        assert all(files(out).get(n, data) == data for n, data in whole.items() if "/" in n)
        assert run(out=out, formats="csv;npz").counts["failed"] == 0, number
        found = files(out)
        assert found.pop(SUMMARY) and found.pop(".deitalk-manifest.json")
        assert found == {n: d for n, d in whole.items() if n in found} and len(found) == 6


def test_killed_replacement_goes_on_without_loss(run, lines, tmp_path):
    for number in (9, 18, 26, 34):
        out = tmp_path / str(number)
        run(out=out, formats="take")
        kill_at_write(number, out, partial(run, out=out, formats="take", emotion="happy"))
        report = run(out=out, formats="take", emotion="happy")
        assert report.counts["failed"] == 0, (number, report.failed)
        assert all(changed_files(out / row.output) == [] for row in report.rows)


def test_folder_with_files_of_others_is_refused(run):
    run.out.mkdir()
    (run.out / "mine.txt").write_text("mine")
    with pytest.raises(TargetError, match="did not write"):
        run()


def test_journal_of_another_version_or_damaged_is_refused(run):
    import sqlite3

    run()
    path = run.out / ".deitalk-batch" / "journal.sqlite"
    with sqlite3.connect(path) as journal:
        journal.execute("UPDATE about SET value = '99' WHERE name = 'format'")
    journal.close()
    with pytest.raises(TargetError, match="another version"):
        run()
    path.write_bytes(b"no journal" * 1000)
    with pytest.raises(TargetError, match="damaged"):
        run()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"model": "none"}, CheckpointError, "no model there"),
        ({"model": "sdfa"}, CheckpointError, "a mesh model"),
        ({"source": "none.csv"}, DataError, "does not exist"),
        ({"workers": 0}, ValueError, "1 or more"),
        ({"formats": ""}, ValueError, "no format"),
        ({"formats": ["csv"]}, DeitalkError, "a text such as"),
        ({"source": ["a.wav"]}, DeitalkError, "a path or a URL"),
        ({"emotion": "hapy"}, ValueError, "hapy"),
        ({"backend": "jax"}, ValueError, "auto, torch, onnx"),
        ({"device": "cuda:99"}, DeitalkError, r"torch finds \w+ CUDA device"),
        ({"device": "gpu", "ray": "local"}, DeitalkError, "cuda:N"),
        ({"life": "nose=1"}, ValueError, "nose"),
        ({"listen": 1e9}, ValueError, "0 to 600"),
    ],
)
def test_wrong_command_is_one_line_and_writes_nothing(run, options, error, words):
    with pytest.raises(error, match=words):
        run(**options)
    assert not run.out.exists()


def test_full_disk_ends_the_batch_with_one_line(run, monkeypatch):
    import errno

    def full(path, curves):
        raise OSError(errno.ENOSPC, "No space left on device")

    from dataclasses import replace

    from rig.formats import table as known

    formats = tuple(replace(f, write=full) if f.name == "npz" else f for f in known.FORMATS)
    monkeypatch.setattr(known, "FORMATS", formats)
    with pytest.raises(TargetError, match="no space left; free some"):
        run(formats="csv;npz")
    monkeypatch.undo()


def test_lines_of_an_actor_share_a_reference(run, orders, lines):
    for number in range(3):
        soundfile.write(lines / f"line{number}.wav", (0.5 + number / 10) * speechlike(1.0), 16_000)
    manifest = lines / "lines.csv"
    manifest.write_text(
        "audio,actor\n" + "".join(f"line{i}.wav,Anna B\n" for i in range(3)) + "c.flac,\n"
    )
    report = run(manifest)
    (reference,) = (run.out / "batch-actors").iterdir()
    assert reference.name.startswith("anna-b-") and read_actor(reference).recordings == 3
    assert report.counts["done"] == 4
    assert [order.acting.voice for order in orders if order.output == "c"] == [None]
    assert all(
        o.acting.voice == read_actor(reference)
        for o in orders
        if not o.only_voice and o.output != "c"
    )
    orders.clear()
    assert run(manifest).counts["unchanged"] == 4 and not orders
    reference.unlink()
    assert run(manifest).counts["unchanged"] == 4, "measured again to the same value"


def test_the_order_of_a_manifest_changes_no_reference(run, lines, monkeypatch, rng):
    """Neither which lines of many are measured, nor the traits that are drawn from them."""
    monkeypatch.setattr("deitalk.batch.actors.MOST_LINES", 4)
    for number in range(7):
        sound = (0.2 + number / 10) * speechlike(0.6 + number / 10)
        soundfile.write(lines / f"line{number}.wav", sound, 16_000)
    made = []
    for order in (range(7), rng.permutation(7)):
        manifest = lines / f"lines{len(made)}.csv"
        manifest.write_text("audio,actor\n" + "".join(f"line{k}.wav,anna\n" for k in order))
        run(manifest, out=run.out / str(len(made)))
        made.append((run.out / str(len(made)) / "batch-actors/anna.json").read_bytes())
    assert made[0] == made[1]
