"""Interruption of code at one of its writes, as by ``kill -9``: nothing is cleaned up.

Python reports every open, rename and removal to audit hooks. From the chosen write on every write
fails, so that the folder stays in the state of a killed process.
"""

import gc
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path

_ONE_PATH = ("os.remove", "os.mkdir", "os.rmdir", "os.truncate")


class Killed(BaseException):
    """Exception that no handler catches, like signal 9."""


class _Watch:
    """Counter of the one audit hook of this process, for one thread; hooks cannot be removed."""

    thread = 0
    root: str | None = None
    left = 0
    count = 0

    def __call__(self, event: str, args: tuple) -> None:
        is_other = self.root is None or threading.get_ident() != self.thread
        if is_other or not self._is_write(event, args):
            return
        self.count += 1
        if self.count > self.left:
            raise Killed

    def _is_write(self, event: str, args: tuple) -> bool:
        if event == "open":
            path, mode, flags = args
            writes = set(mode or "") & set("wax+") or flags & (os.O_WRONLY | os.O_RDWR)
            return bool(writes) and self._is_inside(path)
        if event == "os.rename":
            return self._is_inside(args[1])
        return event in _ONE_PATH and self._is_inside(args[0])

    def _is_inside(self, path: object) -> bool:
        if isinstance(path, bytes):
            path = os.fsdecode(path)
        if not isinstance(path, str | os.PathLike):
            return False
        # A bare name belongs to the removal of a whole folder.
        return os.fspath(path).startswith(str(self.root)) or os.sep not in os.fspath(path)


_watch = _Watch()
_is_installed = False


def kill_at_write(number: int, root: Path, run: Callable[[], object]) -> int:
    """Run up to write `number` (from 1) below `root`, which is prevented; return the writes.

    A run with fewer writes ends normally.
    """
    global _is_installed
    if not _is_installed:
        sys.addaudithook(_watch)
        _is_installed = True
    _watch.thread, _watch.left, _watch.count = threading.get_ident(), number - 1, 0
    gc.disable()  # what earlier tests left is not removed now
    _watch.root = str(root)
    try:
        run()
    except Killed:
        pass
    finally:
        _watch.root = None
        gc.enable()
    return _watch.count


def count_writes(root: Path, run: Callable[[], object]) -> int:
    """Run to the end and return how often it wrote below `root`."""
    return kill_at_write(1_000_000, root, run)
