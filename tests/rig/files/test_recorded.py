"""Recorded files of a folder in use: replaced only while unedited, also after a kill."""

from pathlib import Path

import pytest

from rig.errors import TargetError
from rig.files import begin_folder, kind_of, record, recover, replace_recorded
from tests.interrupt import count_writes, kill_at_write
from tests.written import changed_files


def write(folder: Path, text: str) -> None:
    begin_folder(folder, kind="dataset")
    replace_recorded(folder, "table.csv", text)


def test_recorded_file_is_replaced_and_edited_one_is_kept(tmp_path):
    folder = tmp_path / "data"
    write(folder, "one")
    assert kind_of(folder) == "dataset" and changed_files(folder) == []
    write(folder, "two")
    assert (folder / "table.csv").read_text() == "two" and changed_files(folder) == []
    (folder / "table.csv").write_text("mine")
    with pytest.raises(TargetError, match="was changed since deitalk wrote it"):
        write(folder, "three")
    assert (folder / "table.csv").read_text() == "mine"
    (folder / "table.csv").unlink()
    write(folder, "three")
    assert (folder / "table.csv").read_text() == "three" and changed_files(folder) == []


def test_foreign_file_is_kept_unless_it_is_equal(tmp_path):
    begin_folder(tmp_path, kind="dataset")
    (tmp_path / "table.csv").write_text("mine")
    with pytest.raises(TargetError, match="was not written by deitalk and would be replaced"):
        write(tmp_path, "ours")
    write(tmp_path, "mine")
    write(tmp_path, "ours")
    assert (tmp_path / "table.csv").read_text() == "ours"


def test_link_in_place_of_a_recorded_file_is_not_followed(tmp_path):
    folder = tmp_path / "data"
    write(folder, "one")
    (tmp_path / "elsewhere.csv").write_text("one")
    (folder / "table.csv").unlink()
    (folder / "table.csv").symlink_to(tmp_path / "elsewhere.csv")
    with pytest.raises(TargetError, match="was changed"):
        write(folder, "two")
    assert (tmp_path / "elsewhere.csv").read_text() == "one"


def test_kill_at_any_write_leaves_the_old_or_new_file_recorded(tmp_path):
    total = count_writes(tmp_path / "whole", lambda: write(tmp_path / "whole", "new"))
    for number in range(1, total + 5):
        folder = tmp_path / str(number)
        write(folder, "old")
        kill_at_write(number, folder, lambda folder=folder: write(folder, "new"))
        assert (folder / "table.csv").read_text() in ("old", "new")
        recover(folder)
        assert changed_files(folder) == []
        write(folder, "other")
        assert (folder / "table.csv").read_text() == "other"


def test_temporary_files_of_a_killed_process_are_removed(tmp_path):
    (tmp_path / "page.html").write_text("page")
    total = count_writes(tmp_path, lambda: record(tmp_path, ["page.html"], kind="take"))
    for number in range(1, total + 1):
        kill_at_write(number, tmp_path, lambda: record(tmp_path, ["page.html"], kind="take"))
        record(tmp_path, ["page.html"], kind="take")
        assert sorted(path.name for path in tmp_path.iterdir()) == [
            ".deitalk-manifest.json", "page.html"
        ]  # fmt: skip
