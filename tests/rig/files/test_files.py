"""Writing files and folders: complete or not at all, at whatever step a process ends."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from rig.errors import TargetError
from rig.files import (
    atomic_write,
    claim,
    output_folder,
    remove_leftovers,
)
from rig.files.manifest import MANIFEST


def fill(target, contents, **options):
    with output_folder(target, kind="take", **options) as stage:
        for name, text in contents.items():
            (stage / name).parent.mkdir(parents=True, exist_ok=True)
            (stage / name).write_text(text)


def run_unprivileged(function):
    """Exit code of a child process that runs a function without root's rights."""
    child = os.fork()
    if child == 0:
        try:
            if os.geteuid() == 0:
                os.setgid(65534)
                os.setuid(65534)
            function()
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def content(folder):
    """Texts of all files but deitalk's own records."""
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != MANIFEST
    }


def test_atomic_write_keeps_old_file_on_error(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("old")
    with pytest.raises(RuntimeError), atomic_write(path) as beside:
        beside.write_text("half")
        raise RuntimeError
    assert content(tmp_path) == {"a.csv": "old"}


def test_atomic_write_through_link_keeps_link(tmp_path):
    (tmp_path / "real.csv").write_text("old")
    link = tmp_path / "link.csv"
    link.symlink_to("real.csv")
    with atomic_write(link) as beside:
        beside.write_text("new")
    assert link.is_symlink() and (tmp_path / "real.csv").read_text() == "new"


def test_atomic_write_keeps_permissions_of_replaced_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("old")
    path.chmod(0o640)
    with atomic_write(path) as beside:
        beside.write_text("new")
    assert path.stat().st_mode & 0o777 == 0o640


def test_atomic_write_takes_longest_name(tmp_path):
    path = tmp_path / ("n" * 251 + ".csv")
    with atomic_write(path) as beside:
        beside.write_text("x")
    assert path.read_text() == "x"


def test_leftovers_are_removed_for_their_target_only(tmp_path):
    with pytest.raises(KeyError), atomic_write(tmp_path / "a.csv") as first:
        first.write_text("x")
        left = first.with_name(first.name)
        raise KeyError
    left.write_text("left by a killed process")
    (tmp_path / ".deitalk-mine").write_text("a user's file of a similar name")
    assert remove_leftovers(tmp_path, "b.csv") == 0
    assert remove_leftovers(tmp_path, "a.csv") == 1
    assert [path.name for path in tmp_path.iterdir()] == [".deitalk-mine"]
    assert remove_leftovers(tmp_path / "nowhere") == 0


HOLDER = """
import sys, time
from rig.files import output_folder
with output_folder(sys.argv[1], kind="take", force=True) as stage:
    (stage / "curves.csv").write_text("theirs")
    print("ready", flush=True)
    time.sleep(float(sys.argv[2]))
"""


def holder(target, seconds):
    path = os.pathsep.join(sys.path)
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(target), str(seconds)],
        stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert process.stdout.readline() == b"ready\n"
    return process


@pytest.mark.parametrize("exists", [False, True])
def test_claim_rejects_a_second_process(tmp_path, exists):
    take = tmp_path / "take"
    if exists:
        fill(take, {"curves.csv": "1"})
    first = holder(take, 30)
    with pytest.raises(TargetError, match="written by another process"):
        fill(take, {"curves.csv": "2"}, force=True)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    hidden = [p.name for p in (take if exists else tmp_path).glob(".deitalk-*-*-*")]
    assert len(hidden) == 1  # the stage of the killed process
    fill(take, {"curves.csv": "2"}, force=True)  # a lock ends with its process
    assert content(take) == {"curves.csv": "2"}
    assert list(tmp_path.rglob(".deitalk-*-*-*")) == []


def test_claim_is_reentrant_in_its_thread_only(tmp_path):
    found = []

    def other():
        try:
            with claim(tmp_path / "t"):
                found.append("free")
        except TargetError:
            found.append("refused")

    def run():
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()

    with claim(tmp_path / "t"):
        with claim(tmp_path / "t"):
            run()
        run()
    run()
    assert found == ["refused", "refused", "free"]


def test_claim_works_without_a_cache_folder(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DEITALK_CACHE", str(tmp_path / "file" / "below"))
    fill(tmp_path / "t", {"a": "1"})
    assert content(tmp_path / "t") == {"a": "1"}
