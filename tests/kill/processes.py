"""One command line in a forked process, with imports done once."""

import importlib
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

MODULES = "KILL_MODULES"
"""Environment variable: file to which a command writes the names of the modules it imported."""
STUCK_SECONDS = 120.0


def prepare(modules: Path) -> None:
    """Import the modules listed in `modules`; one thread, because a fork copies no others."""
    for name in modules.read_text().split():
        with suppress(Exception):  # some are created by others, or for other systems
            importlib.import_module(name)
    import torch

    torch.set_num_threads(1)


class Process:
    """A running command.

    Parameters
    ----------
    arguments : sequence of str
        Arguments after ``deitalk``.
    folder : Path
        Working folder.
    """

    def __init__(self, arguments: Sequence[str], folder: Path) -> None:
        self._reading, writing = os.pipe()
        self.began = time.monotonic()
        self.printed = ""
        self.pid = os.fork()
        if self.pid == 0:
            _run(arguments, folder, writing)
        os.close(writing)

    def wait(self, until: Callable[[], bool] = lambda: False, seconds: float = 1e9) -> int | None:
        """Wait for the end; return the exit code, minus the signal, or None if `until` is true first.

        `until` is called about every millisecond.
        """
        end = min(time.monotonic() + seconds, self.began + STUCK_SECONDS)
        while time.monotonic() < end:
            self.read()
            done, status = os.waitpid(self.pid, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            if until():
                return None
            time.sleep(0.0005)
        if time.monotonic() >= self.began + STUCK_SECONDS:
            os.kill(self.pid, signal.SIGKILL)
            raise AssertionError(f"did not end within {STUCK_SECONDS:g} s: {self.printed}")
        return None

    def signal(self, number: int) -> int:
        """Send a signal; return the exit code."""
        os.kill(self.pid, number)
        code = self.wait()
        assert code is not None
        return code

    def read(self) -> None:
        """Read the output so far."""
        while select.select([self._reading], [], [], 0)[0]:
            data = os.read(self._reading, 65536)
            if not data:
                break
            self.printed += data.decode(errors="replace")

    def close(self, seconds: float = 10.0) -> None:
        """Wait until all processes that share the command's output have ended.

        Raises
        ------
        AssertionError
            If one is left.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if select.select([self._reading], [], [], 0.05)[0]:
                data = os.read(self._reading, 65536)
                if not data:
                    os.close(self._reading)
                    return
                self.printed += data.decode(errors="replace")
        os.close(self._reading)
        raise AssertionError(f"a process of the command is left after {seconds:g} s")


def _run(arguments: Sequence[str], folder: Path, output: int) -> None:
    """Run the command in this process; does not return."""
    code = 1
    try:
        os.setpgid(0, 0)
        os.chdir(folder)
        for number in (1, 2):
            os.dup2(output, number)
        sys.argv = ["deitalk", *arguments]
        sys.stdout = os.fdopen(1, "w", buffering=1)
        sys.stderr = os.fdopen(2, "w", buffering=1)
        from deitalk.cli import main
        from tests.command import commands_of

        main(commands_of(arguments[0]))
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        os._exit(_finish(code))


def _finish(code: int) -> int:
    """Run the interpreter's clean-up, which `os._exit` leaves out."""
    import atexit
    import gc

    gc.collect()  # finalises objects held by an exception's frames
    if MODULES in os.environ:
        Path(os.environ[MODULES]).write_text("\n".join(list(sys.modules)))
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return code
