"""One command line in a forked process: the imports, which take seconds, are done once."""

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
    """Import what a run wrote to `modules`; one thread, for a fork copies no others."""
    for name in modules.read_text().split():
        with suppress(Exception):  # some are made by others, or are for other systems
            importlib.import_module(name)
    import torch

    torch.set_num_threads(1)


class Process:
    """A running command.

    Parameters
    ----------
    arguments : sequence of str
        After ``deitalk``.
    folder : Path
        Where it runs.
    """

    def __init__(self, arguments: Sequence[str], folder: Path) -> None:
        self._reading, writing = os.pipe()
        self.began = time.monotonic()
        self.said = ""
        self.pid = os.fork()
        if self.pid == 0:
            _run(arguments, folder, writing)
        os.close(writing)

    def wait(self, until: Callable[[], bool] = lambda: False, seconds: float = 1e9) -> int | None:
        """Wait for the end; return the exit code, minus the signal, or None if `until` came first.

        `until` is asked about every millisecond.
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
            raise AssertionError(f"did not end within {STUCK_SECONDS:g} s: {self.said}")
        return None

    def signal(self, number: int) -> int:
        """Send a signal; return the exit code."""
        os.kill(self.pid, number)
        code = self.wait()
        assert code is not None
        return code

    def read(self) -> None:
        """Take what was printed so far."""
        while select.select([self._reading], [], [], 0)[0]:
            data = os.read(self._reading, 65536)
            if not data:
                break
            self.said += data.decode(errors="replace")

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
                self.said += data.decode(errors="replace")
        os.close(self._reading)
        raise AssertionError(f"a process of the command is left after {seconds:g} s")


def _run(arguments: Sequence[str], folder: Path, output: int) -> None:
    """Become the command; never returns."""
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

        main()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        os._exit(_finish(code))


def _finish(code: int) -> int:
    """Do what the interpreter does at its end, which `os._exit` leaves out."""
    import atexit
    import gc

    gc.collect()  # what an exception's frames hold is finished, as when an interpreter ends
    if MODULES in os.environ:
        Path(os.environ[MODULES]).write_text("\n".join(list(sys.modules)))
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return code
