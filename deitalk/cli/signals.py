"""Signals that ask the program to stop, raised as exceptions so that ``finally`` blocks run.

Python turns SIGINT (Ctrl-C) into `KeyboardInterrupt`, but SIGTERM (``kill``, ``timeout``, a batch
system) and SIGHUP (the terminal was closed) end the process at once: temporary files and worker
processes stay. `install` gives them the same way out; `held` keeps a short write whole.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic
from types import FrameType

NAMES = ("SIGTERM", "SIGHUP", "SIGBREAK")
"""Of these a system has some: Windows has no SIGHUP, all others no SIGBREAK."""
CTRL_C_CODE = 130
"""Exit code of a command that Ctrl-C stopped; typer gives it for any `KeyboardInterrupt`."""
QUIET_SECONDS = 5.0
"""Signals so soon after the first one are dropped: they must not interrupt the cleaning up."""


class Terminated(KeyboardInterrupt):
    """A signal asked the program to stop.

    Parameters
    ----------
    number : int
        Of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number

    @property
    def name(self) -> str:
        """Of the signal, such as ``SIGTERM``."""
        return signal.Signals(self.number).name

    @property
    def exit_code(self) -> int:
        """What a shell reports of a program that a signal ended."""
        return 128 + self.number


class _Handler:
    """Raises `Terminated`, but not again while the program cleans up."""

    def __init__(self) -> None:
        self._last = -float("inf")
        self.raised: Terminated | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now = monotonic()
        if now - self._last < QUIET_SECONDS:
            return
        self._last = now
        self.raised = Terminated(number)
        raise self.raised


def install() -> None:
    """Raise `Terminated` on SIGTERM and SIGHUP.

    A signal that is ignored already (``nohup``) stays ignored. Outside of the main thread, where
    Python sets no handlers, nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    handler = _Handler()
    for number in _numbers():
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def received() -> Terminated | None:
    """The signal that was raised since `install`: typer turns it into an exit code of its own."""
    handlers = [signal.getsignal(number) for number in _numbers()]
    return next((h.raised for h in handlers if isinstance(h, _Handler)), None)


def uninstall() -> None:
    """Let SIGTERM and SIGHUP end the process at once again: there is nothing left to clean up."""
    if threading.current_thread() is threading.main_thread():
        for number in _numbers():
            if isinstance(signal.getsignal(number), _Handler):
                signal.signal(number, signal.SIG_DFL)


@contextmanager
def held() -> Iterator[list[int]]:
    """Delay SIGINT, SIGTERM and SIGHUP until the block has ended; then the first one acts.

    For what cannot be made again. Outside of the main thread nothing is held.

    Yields
    ------
    list of int
        Numbers of the signals that came; a block that has answered them empties it.
    """
    pending: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield pending
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *_numbers())}
    handlers = {number: handler for number, handler in before.items() if callable(handler)}
    for number in handlers:
        signal.signal(number, lambda number, frame: pending.append(number))
    try:
        yield pending
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if pending:
        handlers[signal.Signals(pending[0])](pending[0], None)


def _numbers() -> list[signal.Signals]:
    return [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
