"""One round: start, kill, look, start again, compare. Many rounds: their counts."""

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
    first_change: float
    """Seconds until something appeared or changed at the target."""


class Rounds:
    """Kill one command many times.

    Parameters
    ----------
    command : Command
        What to start.
    work : Path
        An empty folder for all that is made.
    seed : int
        Of the moments.
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
        """Run once and import here what that imported: later processes are forked with it."""
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
            If something is not as it must be; the folder stays for a look.
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
        changed = _changes(folder / self.command.target)
        process = Process(self.command.arguments, folder)
        self.command.feed(process)
        code = process.wait(changed)
        first = time.monotonic() - process.began
        if code is None:
            code = process.wait()
        seconds = time.monotonic() - process.began
        assert code == 0, process.said
        process.close()
        check_whole(folder)
        assert not hidden(folder), hidden(folder)
        return Reference(contents(folder), seconds, first)

    def _kill(self, folder: Path, number: int) -> None:
        """Start the command, end it at a random moment, and look."""
        reference, rng = self.reference, self.rng
        changed = _changes(folder / self.command.target)
        process = Process(self.command.arguments, folder)
        moment = rng.uniform(0, 1.05 * reference.seconds)
        code: int | None = None
        if rng.random() < 0.5:  # while it reads and computes, or at any time
            self._feed_unless(process, moment)
            code = process.wait(seconds=max(process.began + moment - time.monotonic(), 0))
        else:  # while it writes
            self.command.feed(process)
            tail = reference.seconds - reference.first_change
            code = process.wait(changed)
            if code is None:
                code = process.wait(seconds=rng.uniform(0, 1.1 * tail + 0.01))
        if code is None:
            code = process.signal(number)
        process.close()
        self._look(folder, number, code, process.said)

    def _feed_unless(self, process: Process, moment: float) -> None:
        """Feed the command unless it dies before it could be fed."""
        if moment > self.reference.seconds / 2:
            self.command.feed(process)

    def _look(self, folder: Path, number: int, code: int, said: str) -> None:
        self.counts["killed" if code == -number else "stopped" if code > 128 else "ended"] += 1
        stopped = 128 + signal.SIGTERM
        is_known = code in (0, -number, stopped) or (code == 1 and self._refuses(said))
        assert is_known, f"exit code {code}: {said}"
        check_whole(folder)
        for name in self.command.user_files:
            same = (folder / name).read_bytes() == (self.template / name).read_bytes()
            assert same, f"{name}, a file of the user, was changed"
        if code == stopped:
            assert not hidden(folder), f"left after SIGTERM: {hidden(folder)}"

    def _finish(self, folder: Path) -> None:
        """The same command again: it succeeds, and its outcome is the uninterrupted one's."""
        process = Process(self.command.arguments, folder)
        self.command.feed(process)
        code = process.wait()
        process.close()
        assert code == 0 or (code == 1 and self._refuses(process.said)), (
            f"the same command again: exit code {code}: {process.said}"
        )
        self._look(folder, signal.SIGKILL, code, process.said)
        assert not hidden(folder), f"left at the end: {hidden(folder)}"
        found, expected = contents(folder), self.reference.contents
        different = [n for n in found.keys() | expected.keys() if found.get(n) != expected.get(n)]
        assert not different, f"other than uninterrupted: {', '.join(sorted(different))}"
        self.counts["equal"] += 1

    def _refuses(self, said: str) -> bool:
        """Whether the command says why it has nothing to write."""
        return any(words in said for words in self.command.refusals)


def _changes(target: Path) -> Callable[[], bool]:
    """A function that tells whether something at or beside the target is another than now."""

    def state() -> list[tuple[str, int, int]]:
        found = []
        for folder in (target.parent, target):
            try:
                with os.scandir(folder) as entries:
                    found += [(e.path, e.inode(), e.stat().st_mtime_ns) for e in entries]
            except OSError:
                continue
        return sorted(found)

    before = state()
    return lambda: _safe(state, before) != before


def _safe(
    state: Callable[[], list[tuple[str, int, int]]], before: list[tuple[str, int, int]]
) -> list[tuple[str, int, int]]:
    try:
        return state()
    except OSError:  # a file was renamed while it was looked at: a change
        return [*before, ("", 0, 0)]
