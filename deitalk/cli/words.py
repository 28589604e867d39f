"""Words go to stderr, data to stdout; a bar appears on anything longer than a second."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from time import monotonic
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

PATIENCE_SECONDS = 1.0


@cache
def words() -> "Console":
    """The console of stderr."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, soft_wrap=True)


@contextmanager
def bar(title: str) -> Iterator[Callable[[float], None]]:
    """Yield a function that is told the share done, 0 to 1; the bar shows up after a second.

    Where stderr is no terminal nothing is drawn.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    began = monotonic()
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    hidden = not words().is_terminal
    with Progress(*columns, console=words(), transient=True, disable=hidden) as progress:
        task = progress.add_task(title, total=1.0, visible=False)

        def show(share: float) -> None:
            late = monotonic() - began > PATIENCE_SECONDS
            progress.update(task, completed=share, visible=late)

        yield show
