"""Rounds of start, kill, check, restart and comparison, and their counts."""

import os
import shutil
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .commands import Command
from .contents import check_whole, contents, hidden
from .processes import MODULES, Process, prepare

TERM_EVERY = 4
AGAIN = 0.3
"""Chance that the second start is killed as well."""


@dataclass
class Reference:
    """An uninterrupted run."""

    contents: dict[str, object]
    seconds: float
    changes: list[float]
    """Seconds at which the target changed."""


class Rounds:
    """Kill one command many times.

    Parameters
    ----------
    command : Command
        Command to start.
    work : Path
        An empty folder for all files.
    seed : int
        Seed of the moments.
    """

    def __init__(self, command: Command, work: Path, seed: int) -> None:
        self.command = command
        self.template = work / "template"
        self.work = work
        self.rng = np.random.default_rng(seed)
        self.counts: Counter[str] = Counter()
        self.template.mkdir(parents=True)
        command.prepare(self.template)
        self._import()
        self.reference = self._measure("reference")
        again = self._measure("again")
        assert again.contents == self.reference.contents, "two uninterrupted runs differ"

    def _import(self) -> None:
        """Run once and import its modules here, so that later processes are forked with them."""
        modules = self.work / "modules"
        os.environ[MODULES] = str(modules)
        self._measure("first")
        del os.environ[MODULES]
        prepare(modules)

    def run(self, number: int) -> None:
        """Do one round in a fresh copy of the inputs.

        Raises
        ------
        AssertionError
            If a check fails; the folder is kept.
        """
        folder = self.work / f"round-{number}"
        shutil.copytree(self.template, folder)
        kind = signal.SIGTERM if number % TERM_EVERY == TERM_EVERY - 1 else signal.SIGKILL
        try:
            self._kill(folder, kind)
            if self.rng.random() < AGAIN:
                self._kill(folder, signal.SIGKILL)
            self._finish(folder)
        except AssertionError as error:
            raise AssertionError(f"{folder}: {error}") from error
        shutil.rmtree(folder)

    def _measure(self, name: str) -> Reference:
        """Run the command to its end in a copy of the inputs."""
        folder = self.work / name
        shutil.copytree(self.template, folder)
        changed, changes = _changes(folder / self.command.target), []
        process = Process(self.command.arguments, folder)
        self.command.feed(process)
        while (code := process.wait(changed)) is None:
            changes.append(time.monotonic() - process.began)
        seconds = time.monotonic() - process.began
        assert code == 0, process.printed
        process.close()
        check_whole(folder)
        assert not hidden(folder), hidden(folder)
        return Reference(contents(folder), seconds, changes)

    def _kill(self, folder: Path, number: int) -> None:
        """Start the command, end it at a random moment, and check the files."""
        reference, rng = self.reference, self.rng
        changed = _changes(folder / self.command.target)
        process = Process(self.command.arguments, folder)
        moment = rng.uniform(0, 1.05 * reference.seconds)
        code: int | None = None
        kind = rng.integers(3)
        if kind == 0:  # at any moment
            self._feed_unless(process, moment)
            code = process.wait(seconds=max(process.began + moment - time.monotonic(), 0))
        else:  # as it writes: at one of the changes, or from the first one on
            self.command.feed(process)
            number_of_changes = len(reference.changes) if kind == 1 else 1
            for _ in range(rng.integers(number_of_changes) + 1 if number_of_changes else 1):
                code = process.wait(changed) if code is None else code
            if code is None and kind == 2:
                tail = reference.seconds - (reference.changes or [0.0])[0]
                code = process.wait(seconds=rng.uniform(0, 1.1 * tail + 0.01))
        if code is None:
            code = process.signal(number)
        process.close()
        self._look(folder, number, code, process.printed)

    def _feed_unless(self, process: Process, moment: float) -> None:
        """Send input to the command unless it ends first."""
        if moment > self.reference.seconds / 2:
            self.command.feed(process)

    def _look(self, folder: Path, number: int, code: int, output: str) -> None:
        self.counts["killed" if code == -number else "stopped" if code > 128 else "ended"] += 1
        stopped = 128 + signal.SIGTERM
        is_known = code in (0, -number, stopped) or (code == 1 and self._refuses(output))
        assert is_known, f"exit code {code}: {output}"
        check_whole(folder)
        for name in self.command.user_files:
            same = (folder / name).read_bytes() == (self.template / name).read_bytes()
            assert same, f"{name}, a file of the user, was changed"
        if code == stopped:
            assert not hidden(folder), f"left after SIGTERM: {hidden(folder)}"

    def _finish(self, folder: Path) -> None:
        """Run the command again: it succeeds with the result of the uninterrupted run."""
        process = Process(self.command.arguments, folder)
        self.command.feed(process)
        code = process.wait()
        process.close()
        assert code == 0 or (code == 1 and self._refuses(process.printed)), (
            f"the same command again: exit code {code}: {process.printed}"
        )
        self._look(folder, signal.SIGKILL, code, process.printed)
        assert not hidden(folder), f"left at the end: {hidden(folder)}"
        found, expected = contents(folder), self.reference.contents
        different = [n for n in found.keys() | expected.keys() if found.get(n) != expected.get(n)]
        assert not different, f"other than uninterrupted: {', '.join(sorted(different))}"
        self.counts["equal"] += 1

    def _refuses(self, output: str) -> bool:
        """Whether the output has an accepted error."""
        return any(words in output for words in self.command.refusals)


def _changes(target: Path) -> Callable[[], bool]:
    """A function that returns whether the target or its folder changed since the last call."""
    last = _state(target)

    def changed() -> bool:
        nonlocal last
        before, last = last, _state(target)
        return last != before

    return changed


def _state(target: Path) -> list[tuple[str, int, int]]:
    """Names, sizes and times in the target and its folder."""
    found = []
    for folder in (target.parent, target):
        try:
            with os.scandir(folder) as entries:
                stats = [(entry.path, entry.stat()) for entry in entries]
        except OSError:  # missing, or renamed in the meantime
            continue
        found += [(path, stat.st_size, stat.st_mtime_ns) for path, stat in stats]
    return sorted(found)
