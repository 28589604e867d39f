"""Writing files and folders: complete or not at all, at whatever step a process ends."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from rig.errors import ExistsError, TargetError
from rig.files import (
    atomic_write,
    check_file,
    check_folder,
    claim,
    kind_of,
    output_folder,
    record,
    recover,
    remove_leftovers,
    remove_written,
)
from rig.files import folder as folders
from rig.files.manifest import MANIFEST
from tests.errors import one_line
from tests.written import changed_files


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


# one file


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


# which targets


def test_check_file_rejects_places_that_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, word in (
        (tmp_path, "folder"),
        (tmp_path / "pipe", "pipe"),
        (Path("/dev/null"), "device"),
        (tmp_path / "no/a.csv", "not a folder"),
        (tmp_path / ("n" * 300), "too long"),
        (Path("a\0b"), "null"),
    ):
        with pytest.raises(TargetError, match=word):
            check_file(path, force=True)


def test_check_file_rejects_existing_file_and_input(tmp_path):
    path, link = tmp_path / "a.csv", tmp_path / "same.csv"
    path.write_text("mine")
    link.hardlink_to(path)
    with pytest.raises(ExistsError, match=r"a\.csv exists"):
        check_file(path)
    check_file(path, force=True, inputs=(None, "<bytes>", tmp_path / "other"))
    with pytest.raises(TargetError, match="is also an input"):
        check_file(path, force=True, inputs=(link,))


@pytest.mark.parametrize("place", [".", "..", "/", "~", "link", "file", "file/below", "/proc"])
def test_check_folder_rejects_places_never_filled(tmp_path, monkeypatch, place):
    home = tmp_path / "home"
    here = tmp_path / "work/here"
    home.mkdir()
    here.mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(here)
    (here / "real").mkdir()
    (here / "link").symlink_to("real")
    (here / "file").write_text("x")
    with one_line(TargetError):
        check_folder(Path(place).expanduser(), kind="take", force=True)
    with (
        pytest.raises(TargetError),
        output_folder(Path(place).expanduser(), kind="take", force=True),
    ):
        pass


@pytest.mark.parametrize("force", [False, True])
def test_check_folder_rejects_foreign_folder(tmp_path, force):
    (tmp_path / "take").mkdir()
    check_folder(tmp_path / "take", kind="take", force=force)  # empty
    (tmp_path / "take/.DS_Store").write_text("written by a file manager")
    check_folder(tmp_path / "take", kind="take", force=force)
    (tmp_path / "take/notes.txt").write_text("mine")
    (tmp_path / "take/take.json").write_text("{}")
    with pytest.raises(TargetError, match=r"did not write \(notes\.txt, take\.json\)"):
        check_folder(tmp_path / "take", kind="take", force=force)


def test_check_folder_rejects_other_kind_input_and_edited_file(tmp_path):
    take = tmp_path / "take"
    fill(take, {"curves.csv": "1", "audio.wav": "2"})
    assert kind_of(take) == "take"
    with pytest.raises(ExistsError, match="exists"):
        check_folder(take, kind="take")
    check_folder(take, kind="take", force=True)
    with pytest.raises(TargetError, match="holds take, not model"):
        check_folder(take, kind="model", force=True)
    with pytest.raises(TargetError, match=r"audio\.wav is also an input"):
        check_folder(take, kind="take", force=True, inputs=(take / "audio.wav",))
    (take / "preview.mp4").write_text("mine")
    with pytest.raises(TargetError, match=r"preview\.mp4 was not written by deitalk"):
        check_folder(take, kind="take", force=True, names=("preview.mp4",))
    (take / "curves.csv").write_text("1, edited")
    with pytest.raises(TargetError, match=r"curves\.csv was changed since"):
        check_folder(take, kind="take", force=True)


@pytest.mark.parametrize("text", ["", "[]", "{}", "{" * 5000, '{"schema": 1, "files": 3}'])
def test_check_folder_rejects_damaged_manifest(tmp_path, text):
    fill(tmp_path / "take", {"a": "1"})
    (tmp_path / "take" / MANIFEST).write_text(text)
    with pytest.raises(TargetError, match="damaged"):
        check_folder(tmp_path / "take", kind="take", force=True)


def test_check_rejects_read_only_places():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o555)

        def refused():
            with pytest.raises(TargetError, match="read-only"):
                check_folder(folder / "take", kind="take")
            with pytest.raises(TargetError, match="cannot be written to"):
                check_file(folder / "a.csv")

        assert run_unprivileged(refused) == 0


# a whole folder


def test_output_folder_replaces_only_own_files(tmp_path):
    take = tmp_path / "deep/take"
    fill(take, {"curves.csv": "1", "old.csv": "2", "sub/a.ply": "3"})
    (take / "notes.txt").write_text("mine")
    (take / "sub/b.ply").write_text("mine too")
    fill(take, {"curves.csv": "new", "take.json": "4"}, force=True)
    assert content(take) == {
        "curves.csv": "new", "take.json": "4", "notes.txt": "mine", "sub/b.ply": "mine too"
    }  # fmt: skip
    assert set(json.loads((take / MANIFEST).read_text())["files"]) == {"curves.csv", "take.json"}
    assert os.listdir(take.parent) == ["take"]


def test_output_folder_keeps_foreign_file_of_a_new_name(tmp_path):
    take = tmp_path / "take"
    fill(take, {"curves.csv": "1"})
    (take / "preview.mp4").write_text("mine")
    with pytest.raises(TargetError, match=r"preview\.mp4 was not written by deitalk"):
        fill(take, {"curves.csv": "2", "preview.mp4": "theirs"}, force=True)
    assert content(take) == {"curves.csv": "1", "preview.mp4": "mine"}


@pytest.mark.parametrize("exists", [False, True])
def test_output_folder_is_as_before_after_an_error(tmp_path, exists):
    take = tmp_path / "take"
    if exists:
        fill(take, {"curves.csv": "1"})
    with pytest.raises(OSError), output_folder(take, kind="take", force=True) as stage:
        (stage / "curves.csv").write_text("2")
        raise OSError(28, "No space left on device")
    assert (content(take) == {"curves.csv": "1"}) if exists else (os.listdir(tmp_path) == [])


def test_remove_written_keeps_what_it_did_not_write(tmp_path):
    fill(tmp_path / "a", {"x": "1", "sub/y": "2"})
    remove_written(tmp_path / "a")
    assert not (tmp_path / "a").exists()

    fill(tmp_path / "b", {"x": "1", "y": "2"})
    (tmp_path / "b" / "y").write_text("edited")
    (tmp_path / "b" / "notes.txt").write_text("mine")
    remove_written(tmp_path / "b")
    left = {path.name for path in (tmp_path / "b").iterdir()}
    assert left == {"y", "notes.txt", MANIFEST} and changed_files(tmp_path / "b") == ["y"]

    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "x").write_text("of another")
    remove_written(tmp_path / "c")
    assert (tmp_path / "c" / "x").exists()


def test_record_lists_files_added_later(tmp_path):
    take = tmp_path / "take"
    fill(take, {"curves.csv": "1"})
    (take / "preview.html").write_text("page")
    record(take, ["preview.html"], kind="take")
    assert changed_files(take) == []
    (take / "preview.html").write_text("edited")
    assert changed_files(take) == ["preview.html"]
    (take / "preview.html").write_text("page")
    fill(take, {"curves.csv": "2"}, force=True)
    assert content(take) == {"curves.csv": "2"}


class Killed(BaseException):
    """Stands for the end of the process."""


def test_exchange_killed_between_any_two_steps_is_finished(tmp_path, monkeypatch):
    """Every file operation of an exchange in turn is the last one before the process ends."""
    old = {"a": "1", "b": "2", "gone": "3", "x/y": "4"}
    new = {"a": "1, new", "b": "2, new", "c": "5", "x/z": "6"}
    user = {"notes.txt": "mine", "x/mine": "too"}
    steps, ends = 0, set()
    calls = [(os, "replace"), (os, "unlink"), (folders.shutil, "rmtree"), (os, "mkdir")]
    originals = {name: getattr(module, name) for module, name in calls}
    for last in range(100):
        take = tmp_path / f"take{last}"
        fill(take, old)
        for name, text in user.items():
            (take / name).write_text(text)
        steps = 0

        def counted(name, most=last):
            def call(*args, **kwargs):
                nonlocal steps
                if steps >= most:
                    raise Killed
                steps += 1
                return originals[name](*args, **kwargs)

            return call

        with monkeypatch.context() as patch:
            for module, name in calls:
                patch.setattr(module, name, counted(name))
            try:
                fill(take, new, force=True)
                is_done = True
            except Killed:
                is_done = False
        recover(take)
        found = content(take)
        assert {name: found.pop(name) for name in user} == user
        visible = {name: text for name, text in found.items() if not name.startswith(".deitalk")}
        assert visible in (old, new)
        ends.add("new" if visible == new else "old")
        fill(take, new, force=True)  # the same command again
        assert content(take) == new | user
        assert remove_leftovers(take) == 0
        if is_done:
            break
    assert is_done and last > 8 and ends == {"old", "new"}


def test_recover_keeps_file_edited_after_the_kill(tmp_path, monkeypatch):
    take = tmp_path / "take"
    fill(take, {"a": "1", "b": "2"})
    monkeypatch.setattr(folders, "_exchange", lambda *_: os.kill(os.getpid(), 0) or 1 / 0)
    rmtree = folders.shutil.rmtree
    monkeypatch.setattr(folders.shutil, "rmtree", lambda *_, **__: None)
    with pytest.raises(ZeroDivisionError):
        fill(take, {"a": "new", "b": "new"}, force=True)
    monkeypatch.undo()
    assert rmtree is folders.shutil.rmtree
    (take / "b").write_text("edited by the user")
    assert recover(take)
    assert content(take) == {"a": "new", "b": "edited by the user"}


@pytest.mark.parametrize(
    "journal",
    [
        "",
        "[" * 3000,
        {"stage": "..", "moves": {}, "removes": {}},
        {"stage": "/", "moves": {"x": None}, "removes": {}},
        {"stage": ".deitalk-1/../..", "moves": {"secret": None}, "removes": {}},
        {"stage": ".deitalk-1", "moves": {"../secret": None}, "removes": {}},
        {"stage": ".deitalk-1", "moves": {}, "removes": {"../secret": "00"}},
        {"stage": ".deitalk-link", "moves": {"secret": None}, "removes": {}},
    ],
)
def test_recover_rejects_journal_that_leaves_its_folder(tmp_path, journal):
    take = tmp_path / "take"
    fill(take, {"a": "1"})
    (tmp_path / "secret").write_text("mine")
    (take / ".deitalk-link").symlink_to(tmp_path)
    text = journal if isinstance(journal, str) else json.dumps(journal)
    (take / folders.JOURNAL).write_text(text)
    assert not recover(take)
    assert (tmp_path / "secret").read_text() == "mine"
    assert (take / "a").read_text() == "1"
    assert not (take / "secret").exists()


@pytest.mark.parametrize("side", ["staged", "target", "removed"])
def test_recover_follows_no_linked_subfolder(tmp_path, side):
    take, outside = tmp_path / "take", tmp_path / "outside"
    fill(take, {"a": "1"})
    outside.mkdir()
    stage = take / ".deitalk-1"
    stage.mkdir()
    moves, removes = {"sub/secret": None}, {}
    if side == "staged":  # a file from outside would be moved in
        (outside / "secret").write_text("mine")
        (stage / "sub").symlink_to(outside)
    else:
        (take / "sub").symlink_to(outside)
        (stage / "sub").mkdir()
        (stage / "sub" / "secret").write_text("hostile")
    if side == "removed":
        (outside / "secret").write_text("mine")
        moves, removes = {}, {"sub/secret": hashlib.sha256(b"mine").hexdigest()}
    journal = {"stage": ".deitalk-1", "moves": moves, "removes": removes}
    (take / folders.JOURNAL).write_text(json.dumps(journal))
    recover(take)
    expected = {} if side == "target" else {"secret": "mine"}
    assert {path.name: path.read_text() for path in outside.iterdir()} == expected
    assert (take / "a").read_text() == "1"


# several processes

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
