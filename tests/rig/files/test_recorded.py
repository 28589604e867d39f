"""Files of a folder that stays in use: replaced where they are deitalk's, whatever was killed."""

from pathlib import Path

import pytest

from rig.errors import TargetError
from rig.files import begin_folder, changed_files, kind_of, record, replace_recorded
from rig.files.recorded import settle
from tests.interrupt import count_writes, kill_at_write


def write(folder: Path, text: str) -> None:
    begin_folder(folder, kind="dataset")
    replace_recorded(folder, "table.csv", text)


def test_a_recorded_file_is_replaced_and_an_edited_one_stays(tmp_path):
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


def test_a_file_that_deitalk_did_not_write_stays_unless_it_is_equal(tmp_path):
    begin_folder(tmp_path, kind="dataset")
    (tmp_path / "table.csv").write_text("mine")
    with pytest.raises(TargetError, match="was not written by deitalk and would be replaced"):
        write(tmp_path, "ours")
    write(tmp_path, "mine")
    write(tmp_path, "ours")
    assert (tmp_path / "table.csv").read_text() == "ours"


def test_a_link_in_place_of_a_recorded_file_is_not_followed(tmp_path):
    folder = tmp_path / "data"
    write(folder, "one")
    (tmp_path / "elsewhere.csv").write_text("one")
    (folder / "table.csv").unlink()
    (folder / "table.csv").symlink_to(tmp_path / "elsewhere.csv")
    with pytest.raises(TargetError, match="was changed"):
        write(folder, "two")
    assert (tmp_path / "elsewhere.csv").read_text() == "one"


def test_a_kill_at_any_write_leaves_the_old_file_or_the_new_one_and_either_is_known(tmp_path):
    total = count_writes(tmp_path / "whole", lambda: write(tmp_path / "whole", "new"))
    for number in range(1, total + 5):
        folder = tmp_path / str(number)
        write(folder, "old")
        kill_at_write(number, folder, lambda folder=folder: write(folder, "new"))
        assert (folder / "table.csv").read_text() in ("old", "new")
        settle(folder)
        assert changed_files(folder) == []
        write(folder, "other")
        assert (folder / "table.csv").read_text() == "other"


def test_a_kill_while_files_are_listed_leaves_nothing_after_the_next(tmp_path):
    (tmp_path / "page.html").write_text("page")
    total = count_writes(tmp_path, lambda: record(tmp_path, ["page.html"], kind="take"))
    for number in range(1, total + 1):
        kill_at_write(number, tmp_path, lambda: record(tmp_path, ["page.html"], kind="take"))
        record(tmp_path, ["page.html"], kind="take")
        assert sorted(path.name for path in tmp_path.iterdir()) == [
            ".deitalk-manifest.json", "page.html"
        ]  # fmt: skip
