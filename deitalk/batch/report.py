"""Progress of a run, and its tables: a row for each line, and the lines that failed."""

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from time import monotonic

from rig.errors import as_line

LEAST_SECONDS = 1.0
"""Time after the first result from which a rate is shown."""
Progress = Callable[[float, str], None]
"""Called with the share of the work that is done, 0 to 1, and a text on rate and time left."""

DONE, UNCHANGED, EDITED, FAILED = "done", "unchanged", "edited", "failed"
"""Made in this run; made before, from the same; the same, and changed by hand since; not made."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the summary."""

    number: int
    audio: str
    output: str
    status: str
    seconds: float = 0.0
    warnings: str = ""
    """One a line."""
    error: str = ""


@dataclass(frozen=True)
class BatchReport:
    """Result of `deitalk.animate_batch`.

    Attributes
    ----------
    rows : list of Row
        One for each line, in the order of the source.
    out : str
        Folder or URL of the results, with ``batch-summary.csv`` and, if lines failed,
        ``batch-failed.csv``.
    wall_seconds : float
        Duration of the run.
    notes : tuple of str
        What applies to the batch as a whole, such as columns that are not used.
    """

    rows: list[Row]
    out: str
    wall_seconds: float
    notes: tuple[str, ...] = ()

    @property
    def counts(self) -> dict[str, int]:
        """Number of rows of each status: done, unchanged, edited, failed."""
        found = Counter(row.status for row in self.rows)
        return {status: found[status] for status in (DONE, UNCHANGED, EDITED, FAILED)}

    @property
    def failed(self) -> list[Row]:
        """Rows that were not made."""
        return [row for row in self.rows if row.status == FAILED]

    @property
    def seconds(self) -> float:
        """Length of the recordings that were animated in this run."""
        return sum(row.seconds for row in self.rows if row.status == DONE)


def summary_text(rows: Sequence[Row]) -> str:
    """The summary as CSV."""
    header = ("number", "audio", "output", "status", "seconds", "warnings", "error")
    return _table(header, (
        (*_place(r), r.status, f"{r.seconds:.3f}" if r.seconds else "",
         "; ".join(r.warnings.splitlines()), r.error) for r in rows
    ))  # fmt: skip


def failed_text(rows: Sequence[Row]) -> str:
    """The failed lines as CSV."""
    return _table(("number", "audio", "output", "error"), ((*_place(r), r.error) for r in rows))


def _place(row: Row) -> tuple[int, str, str]:
    return row.number, as_line(row.audio), as_line(row.output)


def _table(header: Sequence[str], rows: Iterable[tuple[object, ...]]) -> str:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


class Pace:
    """Rate since the first result, so that the loading of models does not count.

    Parameters
    ----------
    lines : int
        Lines to animate.
    weight : float
        Their work in any unit, such as the bytes of the recordings.
    clock : callable
        Seconds.
    """

    def __init__(self, lines: int, weight: float, clock: Callable[[], float] = monotonic) -> None:
        self.lines, self.weight = lines, max(weight, 1.0)
        self.done = self.failed = 0
        self._clock, self._done_weight, self._seconds = clock, 0.0, 0.0
        self._first: tuple[float, int, float, float] | None = None

    def add(self, weight: float, seconds: float, *, failed: bool) -> None:
        """Count a result: its work, and the seconds of sound in it."""
        self.done += 1
        self.failed += failed
        self._done_weight += weight
        self._seconds += seconds
        if self._first is None:
            self._first = (self._clock(), self.done, self._done_weight, self._seconds)

    @property
    def share(self) -> float:
        """Share of the work that is done."""
        return min(self._done_weight / self.weight, 1.0)

    def text(self) -> str:
        """Counts, rate and time left, as one line."""
        parts = [f"{self.done} of {self.lines} lines"]
        if self.failed:
            parts.append(f"{self.failed} failed")
        if self._first is not None:
            began, done, weight, seconds = self._first
            took, advance = self._clock() - began, self._done_weight - weight
            if took >= LEAST_SECONDS and advance > 0:
                parts.append(f"{(self.done - done) / took:.1f} lines/s")
                parts.append(f"{(self._seconds - seconds) / took:.0f} x real time")
                parts.append(
                    f"{clock_text((self.weight - self._done_weight) / advance * took)} left"
                )
        return ", ".join(parts)


def clock_text(seconds: float) -> str:
    """Format seconds as ``m:ss`` or ``h:mm:ss``."""
    whole = max(round(seconds), 0)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"
