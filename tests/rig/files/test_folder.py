"""Output folders: replaced whole, after errors and kills too, without the files of others."""

import hashlib
import json
import os

import pytest

from rig.errors import TargetError
from rig.files import folder as folders
from rig.files import output_folder, record, recover, remove_leftovers, remove_written
from rig.files.manifest import MANIFEST
from tests.rig.files.test_files import content, fill
from tests.written import changed_files


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
    full = pytest.raises(TargetError, match="take: no space left on the disk; free some")
    with full, output_folder(take, kind="take", force=True) as stage:
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
