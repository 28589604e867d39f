"""Recordings and outputs at a URL, and on the machines of a Ray cluster."""

import os
import shutil
import threading
from pathlib import Path

import pytest

from deitalk.batch import cloud
from deitalk.batch.cloud import file_system
from deitalk.batch.run import animate_batch
from deitalk.batch.source import SUMMARY
from deitalk.errors import DataError, MissingError
from rig.errors import TargetError

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def memory(lines, monkeypatch, tmp_path):
    """An empty storage service with the recordings in ``memory://in``."""
    monkeypatch.setenv("DEITALK_CACHE", str(tmp_path / "cache"))
    system, _ = file_system("memory://in")
    system.store.clear()
    system.pseudo_dirs[:] = [""]
    system.put(str(lines), "/in", recursive=True)
    return system


def names(system):
    found = (name.removeprefix("/out/") for name in system.find("/out"))
    return {name for name in found if not name.startswith(".")}


def test_url_gives_the_files_of_a_folder(run, memory):
    run(formats="csv;take")
    assert run("memory://in", "memory://out", formats="csv;take").counts["done"] == 3
    assert memory.cat_file("/out/anna/a.csv") == (run.out / "anna/a.csv").read_bytes()
    assert {"c/take.json", "c/c.unreal.json", "c.csv", SUMMARY} <= names(memory)


def test_another_machine_goes_on_with_the_journal(run, orders, memory, tmp_path):
    run("memory://in", "memory://out")
    shutil.rmtree(tmp_path / "cache")
    orders.clear()
    assert run("memory://in", "memory://out").counts["unchanged"] == 3 and not orders


def test_ended_run_at_a_url_goes_on_here(run, orders, memory, monkeypatch):
    def end(*given):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(cloud, "_copy", end)
        run("memory://in", "memory://out")
    assert not names(memory), "nothing of a run that is ended"
    orders.clear()
    assert run("memory://in", "memory://out").counts["unchanged"] == 3 and not orders
    assert SUMMARY in names(memory)


def test_what_is_removed_at_a_url_is_made_again(run, orders, memory):
    run("memory://in", "memory://out")
    memory.rm_file("/out/c.csv")
    orders.clear()
    assert run("memory://in", "memory://out").counts["done"] == 1 and len(orders) == 1
    assert "c.csv" in names(memory)


def test_file_of_the_user_at_a_url_stays(run, memory):
    run("memory://in", "memory://out", formats="npz")
    memory.pipe_file("/out/c.csv", b"mine")
    memory.pipe_file("/out/anna/a.npz", b"edited")
    report = run("memory://in", "memory://out", formats="csv")
    assert {row.output: row.status for row in report.rows} == {
        "anna/a": "done", "anna/b": "done", "c": "failed",
    }  # fmt: skip
    assert memory.cat_file("/out/c.csv") == b"mine"
    assert names(memory) == {
        "anna/a.csv", "anna/a.npz", "anna/b.csv", "c.csv", "c.npz", SUMMARY, "batch-failed.csv",
    }  # fmt: skip


def test_url_that_cannot_be_used_is_one_line(run, memory):
    memory.pipe_file("/other/mine.txt", b"mine")
    with pytest.raises(TargetError, match="did not write"):
        run("memory://in", "memory://other")
    with pytest.raises(DataError, match="does not exist"):
        run("memory://nowhere", "memory://out")
    with pytest.raises(DataError, match="nosuch://"):
        run("nosuch://nowhere", "memory://out")


def test_files_that_left_the_cache_stay_at_the_url(run, orders, memory, tmp_path):
    """Programs that tidy a cache take files by their age."""
    run("memory://in", "memory://out", formats="csv")
    memory.pipe_file("/out/notes.txt", b"mine")
    run("memory://in", "memory://out", formats="csv")
    before = {name: memory.cat_file(f"/out/{name}") for name in names(memory)}
    for path in (tmp_path / "cache/batch").rglob("*"):
        if path.name in ("notes.txt", "c.csv"):
            path.unlink()
    orders.clear()
    run("memory://in", "memory://out", formats="csv")
    assert memory.cat_file("/out/notes.txt") == b"mine" and not orders
    assert memory.cat_file("/out/c.csv") == before["c.csv"]


def test_file_that_is_edited_at_a_url_during_the_run_is_not_replaced(run, memory, monkeypatch):
    run("memory://in", "memory://out", formats="csv")
    copy = cloud._copy

    def edited(url, folder):
        memory.pipe_file("/out/c.csv", b"mine")
        copy(url, folder)

    with monkeypatch.context() as patch, pytest.raises(DataError, match=r"c\.csv changed there"):
        patch.setattr(cloud, "_copy", edited)
        run("memory://in", "memory://out", formats="csv", emotion="happy")
    assert memory.cat_file("/out/c.csv") == b"mine"


@pytest.mark.parametrize("name", ["../c.csv", "anna/../../c.csv", "/c.csv"])
def test_names_at_a_url_stay_in_the_folder(run, memory, tmp_path, monkeypatch, name):
    """Stores whose names are any text: a key may have `..` as a part."""
    run(out="memory://out")
    found = memory.find("/out", detail=True)
    found[f"/out/{name}"] = dict(next(iter(found.values())), size=7)
    monkeypatch.setattr(type(memory), "find", lambda *given, **how: found)
    with pytest.raises(DataError, match="outside of it"):
        run(out="memory://out")
    assert not [*tmp_path.glob("cache/batch/c.csv")] and not (tmp_path / "cache/c.csv").exists()


def test_missing_ray_is_one_line(run, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(MissingError, match="pip install"):
        run(ray="auto")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Ray, about its own parts
def test_cluster_finishes_when_a_machine_ends(run, lines, model, tmp_path, monkeypatch):
    """Two machines on this one; the second is killed after the first results."""
    ray = pytest.importorskip("ray", reason="needs Ray (extra ray)")
    pytest.importorskip("pyarrow", reason="needs Ray Data (extra ray)")
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    manifest = lines / "many.csv"
    rows = [f"{('c.flac', 'anna/a.wav')[i % 2]},{i}" for i in range(64)]
    manifest.write_text("audio,output\n" + "\n".join(rows) + "\n")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    other = cluster.add_node(num_cpus=1)
    ended = threading.Event()

    def progress(share, text):
        if not ended.is_set():
            ended.set()
            cluster.remove_node(other, allow_graceful=False)

    try:
        report = animate_batch(
            manifest, tmp_path / "out", model=model, ray=cluster.address, progress=progress
        )
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert ended.is_set() and report.counts["done"] == 64
    whole = run(manifest, tmp_path / "whole")
    assert whole.counts["done"] == 64
    for i in range(64):
        name = f"{i}.csv"
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
