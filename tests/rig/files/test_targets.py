"""Targets of a command that are refused before it works."""

import os
import tempfile
from pathlib import Path

import pytest

from rig.errors import ExistsError, TargetError
from rig.files import check_file, check_folder, kind_of, output_folder
from rig.files.manifest import MANIFEST
from tests.errors import one_line
from tests.rig.files.test_files import fill, run_unprivileged


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
