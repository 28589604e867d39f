"""A batch killed again and again: ``python -m tests.kill.batch --lines 300 --kills 50``.

Each round starts the command, ends it by signal 9 at a random moment and checks that every file
under a final name is complete and is the one that was there before. The last run ends by itself;
its outputs are those of a batch that was never killed, to rounding. Every tenth line is a take folder.
"""

import argparse
import random
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import soundfile

from deitalk.research.evaluation.benchmark_curves import speechlike
from rig import read_curves

from .contents import check_whole, contents, hidden

ROUNDING = 1e-5
"""Lines of one length are computed together, others in another run."""


def write_inputs(folder: Path, lines: int) -> None:
    """A tiny model, recordings of a third of a second, and a manifest."""
    from tests.deitalk.conftest import write_small_model

    write_small_model(folder / "model")
    (folder / "lines").mkdir()
    rows = ["audio,emotion,formats"]
    for number in range(lines):
        sound = speechlike(0.3 + number / (10 * lines))
        soundfile.write(folder / "lines" / f"{number:03d}.wav", sound, 16_000)
        kind = "take" if number % 10 == 0 else "csv"
        rows.append(f"lines/{number:03d}.wav,{('happy', 'sad')[number % 2]},{kind}")
    (folder / "lines.csv").write_text("\n".join(rows) + "\n")


def start(folder: Path, out: str) -> "subprocess.Popen[bytes]":
    """Start the command."""
    command = ("batch", "lines.csv", "-o", out, "--model", "model", "--workers", "2")
    return subprocess.Popen(
        [sys.executable, "-m", "deitalk", *command], cwd=folder, stderr=subprocess.PIPE
    )


def results(out: Path) -> dict[str, tuple[int, int]]:
    """Inode and time of every file of a line; an unchanged file keeps both."""
    found = {}
    for path in sorted((out / "lines").rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            status = path.stat()
            found[path.relative_to(out).as_posix()] = (status.st_ino, status.st_mtime_ns)
    return found


def kill_one(folder: Path, rng: random.Random) -> None:
    """Run the batch up to a random moment: a time, or a number of further files."""
    out = folder / "out"
    before, more = len(results(out)), rng.randint(0, 12)
    process = start(folder, "out")
    if rng.random() < 0.2:
        time.sleep(rng.uniform(0, 3))
    else:
        while process.poll() is None and len(results(out)) < before + more:
            time.sleep(0.005)
        time.sleep(rng.uniform(0, 0.05))
    process.kill()
    process.communicate()


def finish(folder: Path, out: str) -> None:
    """Run the batch to its end."""
    process = start(folder, out)
    printed = process.communicate()[1].decode()
    assert process.returncode == 0, printed


def check_same(folder: Path, seen: dict[str, tuple[int, int]], whole: dict[str, object]) -> None:
    """Files stay as they were placed, and are those of the uninterrupted batch."""
    now = results(folder / "out")
    for name, state in seen.items():
        assert now.get(name) == state, f"{name} was made again or lost"
    for name in now.keys() - seen.keys():
        if name.endswith(".csv") and name.count("/") == 1:
            found, wanted = (read_curves(folder / f / name).values for f in ("out", "whole"))
            assert abs(found - wanted).max() <= ROUNDING, name
    assert now.keys() <= {name for name in whole if name.startswith("lines/")}
    seen |= now


def run(folder: Path, lines: int, kills: int, seed: int) -> None:
    """All rounds.

    Raises
    ------
    AssertionError
        If a file is half-written, made twice, lost or different.
    """
    rng, seen = random.Random(seed), dict[str, tuple[int, int]]()
    write_inputs(folder, lines)
    finish(folder, "whole")
    whole = contents(folder / "whole")
    for number in range(kills):
        kill_one(folder, rng)
        check_same(folder, seen, whole)
        print(f"kill {number + 1}: {len(seen)} files", flush=True)  # noqa: T201
    finish(folder, "out")
    check_same(folder, seen, whole)
    assert contents(folder / "out").keys() == whole.keys()
    check_whole(folder / "out")
    assert all(".deitalk-batch" in name for name in hidden(folder / "out"))
    assert [path.name for path in (folder / "out" / ".deitalk-batch").iterdir()] == [
        "journal.sqlite"
    ]


def main() -> int:
    """Run with the arguments of the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.kill.batch", description=__doc__)
    parser.add_argument("--lines", type=int, default=300)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="kill-batch-"))
    began = time.monotonic()
    run(folder, given.lines, given.kills, given.seed)
    shutil.rmtree(folder)
    took = time.monotonic() - began
    print(f"{given.lines} lines, {given.kills} kills, {took:.0f} s: 0 failures")  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())
