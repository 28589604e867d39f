"""Output of the commands, checks of the files that they read and write, signals.

Messages go to stderr, data to stdout, both as plain text.

Nothing is read as markup: a file may be called ``[red]``. Names that are no UTF-8 and control
characters are printed escaped.
"""

import json
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache, cached_property
from pathlib import Path
from time import monotonic
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol

import typer

from deitalk.errors import DeitalkError
from rig.errors import UserError, as_line, decodable, decodable_values

if TYPE_CHECKING:
    from rich.console import Console as RichConsole

    from rig import RigCurves

_ASSIGNED = r"`{}(?:=(?P<value>[^`]*))?`"
"""A parameter in an error message, alone or with its value."""
OPTIONS = {"mapping": "--map"}
"""Options of `deitalk data` that are called otherwise than their parameter."""
VISIBLE_SECONDS = 1.0
"""Least duration of work with a bar, seconds."""
FIRST_LINE_SECONDS = 3.0
"""Least duration of work with lines of progress, seconds."""
LINE_SECONDS = 10.0
"""Time between two lines of progress at the start of long work."""
SLOWEST_LINE_SECONDS = 60.0
"""The same after an hour."""


class Advance(Protocol):
    """Callback for the share of work done."""

    def __call__(self, share: float, text: str = "", *, always: bool = False) -> None:
        """Report the share done (0 to 1) and a text to print beside it.

        `always` prints a line off a terminal however recent the last one is.
        """


class Console:
    """The console of stderr: plain lines, a line of status, a bar."""

    @cached_property
    def rich(self) -> "RichConsole":
        """Of the package rich, which is imported for a terminal only."""
        from rich.console import Console as RichConsole

        return RichConsole(stderr=True, emoji=False, highlight=False, soft_wrap=True)

    @property
    def is_terminal(self) -> bool:
        """Whether stderr is a terminal, or the environment says so (see the page of rich)."""
        asked = ("FORCE_COLOR", "TTY_COMPATIBLE")
        is_asked = any(os.environ.get(name) for name in asked)
        return (sys.stderr.isatty() or is_asked) and self.rich.is_terminal

    def print(self, text: str, *, style: str = "") -> None:
        """Print one line without markup."""
        if not self.is_terminal:
            sys.stderr.write(as_line(text) + "\n")
            return
        from rich.text import Text

        self.rich.print(Text(as_line(text)), style=style or None)

    def note(self, text: str) -> None:
        """Print a note about the result."""
        self.print(f"note: {text}", style="yellow")

    def status(self, title: str) -> AbstractContextManager[object]:
        """Show a title during the block; nothing off a terminal."""
        return self.rich.status(title) if self.is_terminal else nullcontext()


@cache
def console() -> Console:
    """The console of stderr."""
    return Console()


def emit(text: str) -> None:
    """Print data to stdout and end the line."""
    import typer

    typer.echo(decodable(text).removesuffix("\n"))


def emit_json(value: Any, *, indent: int | None = None) -> None:
    """Print data to stdout as JSON."""
    emit(json.dumps(decodable_values(value), indent=indent))


def escape_what_cannot_be_encoded() -> None:
    """Escape characters that the encoding of stdout or stderr cannot represent."""
    for stream in (sys.stdout, sys.stderr):
        if reconfigure := getattr(stream, "reconfigure", None):
            reconfigure(errors="backslashreplace")


@contextmanager
def bar(title: str) -> Iterator[Advance]:
    """Yield a function to call with the share done, 0 to 1.

    On a terminal a bar shows up after a second. Elsewhere a line is printed at every tenth of the
    work, or every 10 seconds (every minute after an hour); work of a few seconds prints nothing.
    """
    if not console().is_terminal:
        yield _Lines(title, console().print, monotonic)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    began = monotonic()
    title_column = TextColumn("{task.description}")
    text_column = TextColumn("{task.fields[text]}")
    columns = (title_column, BarColumn(), TimeRemainingColumn(), text_column)
    with Progress(*columns, console=console().rich, transient=True) as progress:
        task = progress.add_task(title, total=1.0, visible=False, text="")

        def advance(share: float, text: str = "", *, always: bool = False) -> None:
            late = monotonic() - began > VISIBLE_SECONDS
            progress.update(task, completed=share, visible=late, text=as_line(text))

        yield advance


class _Lines:
    """Progress as lines for a log."""

    def __init__(
        self, title: str, write: Callable[[str], None], clock: Callable[[], float]
    ) -> None:
        self.title, self.write, self.clock = title, write, clock
        self.began = self.printed = clock()
        self.tenth = 0

    def __call__(self, share: float, text: str = "", *, always: bool = False) -> None:
        now = self.clock()
        took, since = now - self.began, now - self.printed
        tenth = int(10 * share + 1e-9)
        due = since >= min(max(LINE_SECONDS, took / 60), SLOWEST_LINE_SECONDS)
        is_tenth = tenth > self.tenth and since >= FIRST_LINE_SECONDS
        if not (due or is_tenth or (always and took >= FIRST_LINE_SECONDS)):
            return
        self.tenth, self.printed = tenth, now
        details = f", {text}" if text else ""
        self.write(f"{self.title}: {share:.0%} after {took:.0f} s{details}")


def name_option(error: UserError) -> str:
    """Return an error's message with its parameter named as on the command line.

    ``set `force=True` `` becomes ``set --force``, ``give `fps` `` becomes ``give --fps``.
    """

    def option(found: re.Match[str]) -> str:
        value = found["value"]
        name = OPTIONS.get(error.parameter) or "--" + error.parameter.replace("_", "-")
        return name if value in (None, "True") else f"{name} {value}"

    pattern = _ASSIGNED.format(re.escape(error.parameter))
    return re.sub(pattern, option, str(error)) if error.parameter else str(error)


# Checks of the files that commands read and write.


PICTURES = (".png", ".svg", ".pdf")
Inputs = Iterable[Path | str | None]

_targets: ContextVar[ExitStack | None] = ContextVar("targets", default=None)


def hold_targets(context: typer.Context) -> None:
    """Keep reserved targets reserved until the command ends."""
    _targets.set(context.with_resource(ExitStack()))


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


def reserve_picture(path: Path, *, force: bool, inputs: Inputs = ()) -> None:
    """As `reserve_file`, for a picture that matplotlib writes."""
    if path.suffix.lower() not in PICTURES:
        raise DeitalkError(f"{path}: a picture is .png, .svg or .pdf")
    reserve_file(path, force=force, inputs=inputs)


def reserve_mesh(out: str, *, force: bool, inputs: Inputs = (), fbx: bool = False) -> None:
    """As `reserve_file` for .glb, .npz (and .fbx), else as `reserve_folder` of frames."""
    from rig.mesh.sequence import check_out

    is_fbx = fbx and out.lower().endswith(".fbx")
    if not is_fbx and check_out(out) == "folder":
        reserve_folder(Path(out), kind="frames", force=force, inputs=inputs)
    else:
        reserve_file(Path(out), force=force, inputs=inputs)


def reserve_sound(out: Path, sound: Path | None, *, force: bool) -> Path | None:
    """Reserve the ``.wav`` beside an FBX, which holds no sound; None for other files.

    `sound` is that of the take; without one there is nothing to write.
    """
    if out.suffix.lower() != ".fbx" or sound is None or not sound.is_file():
        return None
    beside = out.with_suffix(".wav")
    reserve_file(beside, force=force, inputs=(sound,))
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
    for note in curves.notes:
        console().note(note)


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


# Termination signals raised as exceptions, so that ``finally`` blocks run.
#
# Python turns SIGINT (Ctrl-C) into `KeyboardInterrupt`, but SIGTERM (``kill``, ``timeout``, a batch
# system) and SIGHUP (the terminal was closed) end the process at once: temporary files and worker
# processes stay. `catch_signals` raises exceptions for them too; `held` protects a short write.


NAMES = ("SIGTERM", "SIGHUP", "SIGBREAK")
"""Termination signals; Windows has no SIGHUP, other systems no SIGBREAK."""
CTRL_C_CODE = 130
"""Exit code of a command stopped by Ctrl-C; typer returns it for any `KeyboardInterrupt`."""
QUIET_SECONDS = 5.0
"""Time after the first signal in which others are dropped, so that clean-up is not interrupted."""


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
