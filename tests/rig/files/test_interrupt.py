"""An interrupt (Ctrl-C, SIGTERM) at any rename of a folder's replacement: the old one or the new."""

import os
from pathlib import Path

import pytest

from rig.files import output_folder
from tests.written import changed_files

OLD = {"a.csv": "old", "b.csv": "old", "gone.csv": "old"}
NEW = {"a.csv": "new", "b.csv": "new", "added.csv": "new"}


def write(folder: Path, files: dict[str, str]) -> None:
    with output_folder(folder, kind="take", force=True) as stage:
        for name, text in files.items():
            (stage / name).write_text(text)


def visible(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.glob("[!.]*")}


@pytest.mark.parametrize("when", ["before", "after"])
def test_interrupted_replacement_leaves_the_old_or_new_folder_and_no_hidden_files(
    when, tmp_path, monkeypatch
):
    real, seen = os.replace, set()
    for number in range(1, 9):
        folder = tmp_path / str(number)
        write(folder, OLD)
        calls = 0

        def replace(source: object, target: object, number: int = number) -> None:
            nonlocal calls
            calls += 1
            if when == "after":
                real(source, target)
            if calls == number:
                raise KeyboardInterrupt
            if when == "before":
                real(source, target)

        monkeypatch.setattr(os, "replace", replace)
        try:
            write(folder, NEW)
        except KeyboardInterrupt:
            pass
        finally:
            monkeypatch.setattr(os, "replace", real)
        assert visible(folder) in (OLD, NEW), number
        seen.add(visible(folder)["a.csv"])
        assert [path.name for path in folder.glob(".*")] == [".deitalk-manifest.json"]
        assert changed_files(folder) == []
        write(folder, NEW)
    assert seen == {"old", "new"}
