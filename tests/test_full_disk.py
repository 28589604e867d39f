"""A full disk at any point of a command: one line, old files intact, no other file left.

Each command writes to a tmpfs with space for a share of its files.
"""

import hashlib
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile

from deitalk.cli import main
from deitalk.config.curves import Config
from deitalk.models.checkpoint import save_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.evaluation.benchmark_curves import speechlike
from rig import default_controls, write_curves
from rig.curves import RigCurves
from rig.mesh import TriMesh
from tests.command import commands_of
from tests.deitalk.pipeline.test_curves import SMALL
from tests.meshes import write_obj

PAGE = 4096  # bytes; the block of a tmpfs
SHARES = {True: (0.0, 0.9), False: (0.3,)}
"""Space for parts of the files, over those that exist (`--force`), then without them."""


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Inputs on another disk: speech, a model, a take and a mesh."""
    folder = tmp_path_factory.mktemp("sources")
    soundfile.write(folder / "speech.wav", speechlike(0.4), 16_000)
    save_model(folder / "model", DEITalk(SMALL), Config(name="small", model=SMALL), {"steps": 0})
    controls = default_controls()
    rng = np.random.default_rng(0)
    low, high = controls.minimum, controls.maximum
    values = low + (high - low) * rng.random((30, len(controls.names)))
    write_curves(folder / "curves.csv", RigCurves(values, controls.names))
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    write_obj(folder / "square.obj", TriMesh(square, np.array([[0, 1, 2], [0, 2, 3]])))
    return folder


def commands(sources, out):
    """Command lines that write to the folder `out`, by name."""
    speech, curves, model = sources / "speech.wav", sources / "curves.csv", sources / "model"
    line = {
        "take": ["animate", speech, "-e", "happy", "--model", model, "-o", out / "take"],
        "animate-file": ["animate", speech, "--model", model, "-o", out / "a.json"],
        "face-export": ["face", "export", "-o", out / "head.glb"],
        "face-sheet": ["sheet", "ear", "--tile", "64", "-o", out / "s.png"],
        "mesh-glb": ["animate", speech, "--vertices", "--model", model, "-o", out / "m.glb"],
        "mesh-ply": ["animate", speech, "--vertices", "--model", model, "-o", out / "frames"],
        "model-export": ["model", "export", model, "-o", out / "exported"],
        "corpus-sheet": ["corpus", "sheet", "-o", out / "sheet"],
    }
    for name in ("c.csv", "c.json", "c.npz", "c.glb", "c.unreal.json", "c.txt"):
        line[f"convert-{name}"] = ["convert", curves, out / name]
    line["convert-livelink"] = ["convert", curves, out / "S_1_a.csv", "--to", "livelink"]
    return {name: [str(word) for word in words] for name, words in line.items()}


SLOW = ("convert-c.glb", "corpus-sheet", "face-export")
NAMES = [
    pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name
    for name in sorted(commands(Path("s"), Path("o")))
]


def run(arguments, monkeypatch, capfd):
    """Exit code and lines on stderr."""
    monkeypatch.setattr(sys, "argv", ["deitalk", *arguments])
    with pytest.raises(SystemExit) as ended:
        main(commands_of(arguments[0]))
    return ended.value.code or 0, capfd.readouterr().err.splitlines()


def state(folder):
    """Hash of every file, hidden ones too."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def leave_free(disk, n_bytes):
    """Fill the disk except for some bytes; return the file that fills it."""
    ballast = disk / "ballast"
    n_fill = shutil.disk_usage(disk).free - max(n_bytes // PAGE * PAGE, 0)
    with ballast.open("wb") as file:
        if n_fill:
            os.posix_fallocate(file.fileno(), 0, n_fill)
    return ballast


@pytest.mark.parametrize("name", NAMES)
def test_full_disk_leaves_old_files_and_no_others(
    disk, sources, name, monkeypatch, capfd, tmp_path
):
    out = disk / name
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    arguments = commands(sources, out)[name]
    free = shutil.disk_usage(disk).free
    code, lines = run(arguments, monkeypatch, capfd)
    assert code == 0, lines
    needed = free - shutil.disk_usage(disk).free
    written = state(out)
    for force, shares in SHARES.items():
        if not force:
            shutil.rmtree(out)
            out.mkdir()
            (out / "notes.txt").write_text("mine")
        before = state(out)
        for share in shares:
            ballast = leave_free(disk, int(needed * share))
            code, lines = run(arguments + ["--force"] * force, monkeypatch, capfd)
            ballast.unlink()
            after = state(out)
            if code == 0:  # fewer pages than the first time: sparse or equal pages
                assert share >= 0.9
                break
            messages = [line for line in lines if line.startswith("deitalk: ")]
            assert len(messages) == 1 and "space" in messages[0].lower(), lines
            assert str(out) in messages[0] and "/.deitalk" not in messages[0], messages
            assert not any("Traceback" in line for line in lines)
            assert after == before, (share, set(after) ^ set(before))
    if name != "take":  # its take.json has the time of writing
        code, lines = run([*arguments, "--force"], monkeypatch, capfd)
        assert code == 0 and state(out) == written
    shutil.rmtree(out)
