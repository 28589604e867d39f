"""Checks of the files that commands read and write."""

import os
from collections.abc import Iterable
from contextlib import ExitStack
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from deitalk.cli.console import console
from deitalk.errors import DeitalkError

if TYPE_CHECKING:
    from rig import RigCurves

PICTURES = (".png", ".svg", ".pdf")
Inputs = Iterable[Path | str | None]

_targets: ContextVar[ExitStack | None] = ContextVar("targets", default=None)


def hold_targets(context: typer.Context) -> None:
    """Keep reserved targets reserved until the command ends."""
    _targets.set(context.with_resource(ExitStack()))


def check_working_folder() -> None:
    """Raise DeitalkError where the working folder was removed: torch ends a process there."""
    try:
        os.getcwd()
    except FileNotFoundError as error:
        message = "the working folder was removed; change to one that exists"
        raise DeitalkError(message) from error


def reserve_file(path: Path, *, force: bool, inputs: Inputs = ()) -> None:
    """Check a file to write before the work begins, and lock it against other processes.

    Raises
    ------
    rig.errors.TargetError
        As `rig.files.check_file` and `rig.files.claim`.
    """
    from rig.files import check_file, remove_leftovers

    _refuse_stdout(path)
    check_file(path, force=force, inputs=inputs)
    _claim(path)
    remove_leftovers(Path(os.path.realpath(path)).parent, Path(os.path.realpath(path)).name)


def reserve_folder(path: Path, *, kind: str, force: bool, inputs: Inputs = ()) -> None:
    """Check a folder to write before the work begins, and lock it against other processes.

    Raises
    ------
    rig.errors.TargetError
        As `rig.files.check_folder` and `rig.files.claim`.
    """
    from rig.files import check_folder, recover

    _refuse_stdout(path)
    _claim(path)
    recover(path)
    check_folder(path, kind=kind, force=force, inputs=inputs)


def reserve_take(path: Path, speech: str, *, force: bool, inputs: Inputs) -> None:
    """Reserve a take folder of a recording, as `reserve_folder` does."""
    from deitalk.pipeline.performance import KIND, check_take

    reserve_folder(path, kind=KIND, force=force, inputs=inputs)
    check_take(path, source=speech, force=force, inputs=inputs)


def reserve_mesh(out: str, *, force: bool, inputs: Inputs = (), fbx: bool = False) -> None:
    """Reserve a .glb, .npz (or .fbx) as `reserve_file` does, else a folder of frames."""
    from rig.mesh.sequence import check_out

    is_fbx = fbx and out.lower().endswith(".fbx")
    if not is_fbx and check_out(out) == "folder":
        reserve_folder(Path(out), kind="frames", force=force, inputs=inputs)
    else:
        reserve_file(Path(out), force=force, inputs=inputs)


def reserve_sound(out: Path, *, force: bool, inputs: Inputs) -> Path | None:
    """Reserve the ``.wav`` beside an FBX, which holds no sound; None for other files."""
    if out.suffix.lower() != ".fbx":
        return None
    beside = out.with_suffix(".wav")
    reserve_file(beside, force=force, inputs=inputs)
    return beside


def write_sound(
    beside: Path, sound: Path, start: float = 0.0, end: float | None = None, lead: float = 0.0
) -> None:
    """Write the sound of a take from one second to another, silence around it, and say so."""
    import numpy as np
    import soundfile

    from rig.files import atomic_write

    with soundfile.SoundFile(sound) as opened:
        total, rate = opened.frames, opened.samplerate
        first = min(round(start * rate), total)
        last = total if end is None else min(round(end * rate), total)
        opened.seek(first)
        rows = opened.read(max(last - first, 0), dtype="int16")
        rows = np.pad(rows, [(round(lead * rate),) * 2, (0, 0)][: rows.ndim])
        with atomic_write(beside) as path:
            soundfile.write(path, rows, opened.samplerate)
    console().print(f"{beside}: its sound, from the first frame on")


def _refuse_stdout(path: Path) -> None:
    if str(path) == "-":
        raise DeitalkError("-o -: nothing is written to stdout; name a file or a folder")


def _claim(path: Path) -> None:
    from rig.files import claim

    targets = _targets.get()
    if targets is not None:
        targets.enter_context(claim(path))


def note_reading(curves: "RigCurves") -> None:
    """Print what the reader of a file corrected, filled in or left out."""
    console().note(*curves.notes)


def curves_of(source: Path) -> Path:
    """Return the file of curves of a take folder, or the file itself."""
    from rig.files import recover

    if not source.is_dir():
        from deitalk.audio.decoding import RECORDINGS

        if source.suffix.lower() in RECORDINGS:
            raise DeitalkError(
                f"{source} is a recording: make a take with deitalk animate {source}"
            )
        return source
    recover(source)  # where a replacement of the take was interrupted
    for name in ("curves.json", "curves.npz", "curves.csv"):
        if (source / name).is_file():
            return source / name
    raise DeitalkError(f"{source} has no curves; give a take folder or a file of curves")
