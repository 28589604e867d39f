"""The commands that are killed: their inputs, their lines, the user's files around them."""

import re
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import soundfile

from deitalk.research.evaluation.benchmark_curves import speechlike
from rig import RigCurves, default_controls, write_curves

from .processes import Process

TINY = Path(__file__).resolve().parents[2] / "configs" / "tiny.yaml"
NOTES = "the user's own\n"


@dataclass(frozen=True)
class Command:
    """A command line, its inputs and expectations."""

    arguments: tuple[str, ...]
    prepare: Callable[[Path], None]
    """Fills a folder with the inputs."""
    target: str
    """File or folder that is written, below that folder."""
    user_files: tuple[str, ...]
    """Files of the user, written before the command runs."""
    refusals: tuple[str, ...] = ()
    """Words of accepted errors: the target is complete already, or nothing was received."""
    feed: Callable[[Process], None] = lambda process: None
    """Sends input to the running command."""


def all_commands() -> dict[str, Command]:
    """Every command by name."""
    speech = ("speech.wav", "notes.txt")
    training = ("--set", "train.steps=4", "--set", "train.evaluate_every=2",
                "--set", "train.batch_size=2", "--set", "train.workers=1")  # fmt: skip
    return {
        "animate-new": Command(
            ("animate", "speech.wav", "-e", "happy", "-o", "take"),
            _speech, "take", speech, refusals=(" exists",),
        ),
        "animate-replace": Command(
            ("animate", "speech.wav", "-e", "happy", "-o", "take", "--force"),
            _old_take, "take", (*speech, "take/mine.txt", "take/sub/mine.txt"),
        ),
        "train": Command(
            ("train", str(TINY), "--data", "data", "-o", "run", "--resume", *training),
            _dataset, "run", ("data/clips.csv", "data/audio/0.flac", "notes.txt"),
        ),
        "import": Command(
            ("data", "import", "takes", "--actor", "anna", "-o", "data"),
            _takes, "data", ("takes/joy_0.csv", "takes/joy_0.wav", "notes.txt"),
            refusals=(" exists",),
        ),
        "fix": Command(
            ("data", "check", "data", "--fix"),
            _imported, "data", ("takes/joy_0.csv", "data/mine.txt", "notes.txt"),
        ),
        "corpus": Command(
            ("corpus", "build", "--hours", "0.003", "--seed", "1", "-o", "corpus"),
            _notes, "corpus", ("notes.txt",),
        ),
        "convert": Command(
            ("convert", "curves.npz", "out.csv", "--force", "--fps", "60"),
            _curves, "out.csv", ("curves.npz", "notes.txt"),
        ),
        "preview": Command(
            ("preview", "take", "--force"),
            partial(_old_take, seconds=0.2), "take", (*speech, "take/mine.txt", "take/sub/mine.txt"),
        ),
        "receive": Command(
            ("live", "--record", "rec.csv", "--port", "0", "--timeout", "0.2", "--force"),
            _notes, "rec.csv", ("notes.txt",), feed=_packets,
            refusals=("no packet was received",),
        ),
    }  # fmt: skip


def _notes(folder: Path) -> None:
    (folder / "notes.txt").write_text(NOTES)


def _speech(folder: Path, seconds: float = 0.8) -> None:
    _notes(folder)
    soundfile.write(folder / "speech.wav", speechlike(seconds), 16_000)


def _old_take(folder: Path, seconds: float = 0.8) -> None:
    """A take of another emotion, with files of the user in it."""
    _speech(folder, seconds)
    process = Process(("animate", "speech.wav", "-e", "sad", "-o", "take"), folder)
    assert process.wait() == 0, process.printed
    process.close()
    (folder / "take" / "sub").mkdir()
    for name in ("take/mine.txt", "take/sub/mine.txt"):
        (folder / name).write_text(NOTES)


def _dataset(folder: Path) -> None:
    from tests.dataset import write_dataset

    _notes(folder)
    write_dataset(folder / "data", n_train=2, n_validation=1)


def _takes(folder: Path) -> None:
    from tests.takes import write_live_link

    _notes(folder)
    for number in range(2):
        write_live_link(folder / "takes" / f"joy_{number}.csv", 6 + number / 10)


def _imported(folder: Path) -> None:
    _takes(folder)
    arguments = ("data", "import", "takes", "--actor", "anna", "-o", "data")
    process = Process(arguments, folder)
    assert process.wait() == 0, process.printed
    process.close()
    (folder / "data" / "mine.txt").write_text(NOTES)


def _curves(folder: Path) -> None:
    _notes(folder)
    controls = default_controls()
    rng = np.random.default_rng(0)
    span = controls.maximum - controls.minimum
    values = controls.minimum + span * rng.random((3000, len(controls)))
    write_curves(folder / "curves.npz", RigCurves(values, controls.names))
    write_curves(folder / "out.csv", RigCurves(values[:20], controls.names))


def _packets(process: Process) -> None:
    """Send a second of a face once the command is ready."""
    from rig.conversion.arkit import arkit_controls
    from rig.livelink import Packet, encode

    process.wait(partial(_listens, process), seconds=20)
    found = re.search(r"listening on 127\.0\.0\.1:(\d+)", process.printed)
    if not found:
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for i in range(30):
            values = np.full(len(arkit_controls()), i / 30, np.float32)
            packet = Packet("KILL", "anna", 1000 + i, 0.0, (30, 1), values)
            link.sendto(encode(packet), ("127.0.0.1", int(found[1])))
            time.sleep(0.001)


def _listens(process: Process) -> bool:
    return "listening on" in process.printed
