"""Output of the commands.

Messages go to stderr, data to stdout, both as plain text.

Nothing is read as markup: a file may be called ``[red]``. Names that are no UTF-8 and control
characters are printed escaped.
"""

import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache, cached_property
from time import monotonic
from typing import IO, TYPE_CHECKING, Any, Protocol

from rig.errors import UserError, as_line, decodable, decodable_values

if TYPE_CHECKING:
    from rich.console import Console as RichConsole


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
"""Time between two lines of progress after an hour."""


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
        """The console of the package rich, which is imported for a terminal only."""
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

    def note(self, *texts: str) -> None:
        """Print notes about the result."""
        for text in texts:
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


def emit_outcome(line: str, summary: Any, notes: Iterable[str] = (), *, as_json: bool) -> None:
    """Print notes, then what was made: as a line of stderr, or a summary on stdout as JSON."""
    console().note(*notes)
    if as_json:
        emit_json(summary)
    else:
        console().print(line)


def prepare_streams() -> None:
    """Open the null device for closed standard streams; escape what an encoding cannot represent.

    A service or a program with windows may start Python without standard streams.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))
        reconfigure = getattr(getattr(sys, name), "reconfigure", None)
        if reconfigure and mode == "w":
            reconfigure(errors="backslashreplace")


def sound_of(speech: str) -> str | IO[bytes]:
    """The recording of an argument: ``-`` is standard input."""
    if speech == "-" and getattr(sys.stdin, "name", "") == os.devnull:  # see `prepare_streams`
        raise UserError("standard input is closed; pipe a recording into it, or name a file")
    return sys.stdin.buffer if speech == "-" else speech


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
