"""Termination signals raised as exceptions, so that ``finally`` blocks run.

Python turns SIGINT (Ctrl-C) into `KeyboardInterrupt`, but SIGTERM (``kill``, ``timeout``, a batch
system) and SIGHUP (the terminal was closed) end the process at once: temporary files and worker
processes stay. `catch_signals` raises exceptions for them too; `held` protects a short write.
"""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic
from types import FrameType

NAMES = ("SIGTERM", "SIGHUP", "SIGBREAK")
"""Termination signals; Windows has no SIGHUP, other systems no SIGBREAK."""
CTRL_C_CODE = 130
"""Exit code of a command stopped by Ctrl-C; typer returns it for any `KeyboardInterrupt`."""
QUIET_SECONDS = 5.0
"""Time after the first signal in which others are dropped, so that clean-up is not interrupted."""


def leave_on_ctrl_c() -> None:
    """End this process with one line on Ctrl-C, until `catch_signals`; where nothing ignores it.

    For a time without anything to clean up, such as imports, in which libraries of C lose or
    print a `KeyboardInterrupt`.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, b"deitalk: interrupted\n")
    os._exit(CTRL_C_CODE)


class Terminated(KeyboardInterrupt):
    """A termination signal.

    Parameters
    ----------
    number : int
        Number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number

    @property
    def name(self) -> str:
        """Name of the signal, such as ``SIGTERM``."""
        return signal.Signals(self.number).name

    @property
    def exit_code(self) -> int:
        """Exit code of a shell for a program ended by the signal."""
        return 128 + self.number


class _Handler:
    """Handler that raises `Terminated` once and is silent during clean-up."""

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


def catch_signals() -> None:
    """Raise `Terminated` on SIGTERM and SIGHUP; `KeyboardInterrupt` on Ctrl-C, as Python does.

    A signal that is ignored already (``nohup``) stays ignored. Outside of the main thread, where
    Python sets no handlers, nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    handler = _Handler()
    for number in _numbers():
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def received() -> Terminated | None:
    """The signal raised since `catch_signals`, if any; typer replaces it by its own exit code."""
    handlers = [signal.getsignal(number) for number in _numbers()]
    return next((h.raised for h in handlers if isinstance(h, _Handler)), None)


def release_signals() -> None:
    """Restore the default action of SIGTERM and SIGHUP after clean-up."""
    if threading.current_thread() is threading.main_thread():
        for number in _numbers():
            if isinstance(signal.getsignal(number), _Handler):
                signal.signal(number, signal.SIG_DFL)


@contextmanager
def held() -> Iterator[list[int]]:
    """Delay SIGINT, SIGTERM and SIGHUP to the end of the block; then raise the first one.

    For writes that cannot be repeated. Outside of the main thread no signal is delayed.

    Yields
    ------
    list of int
        Numbers of the received signals; a block that has handled them clears the list.
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
