"""Tables of a run: a row for each line, and the lines that failed."""

import csv
import io
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rig.errors import as_line

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
    return _table(header, ((*_place(r), r.status, _seconds(r), _joined(r), r.error) for r in rows))


def failed_text(rows: Sequence[Row]) -> str:
    """The failed lines as CSV."""
    return _table(("number", "audio", "output", "error"), ((*_place(r), r.error) for r in rows))


def _place(row: Row) -> tuple[int, str, str]:
    return row.number, as_line(row.audio), as_line(row.output)


def _seconds(row: Row) -> str:
    return f"{row.seconds:.3f}" if row.seconds else ""


def _joined(row: Row) -> str:
    return "; ".join(row.warnings.splitlines())


def _table(header: Sequence[str], rows: Iterable[tuple[object, ...]]) -> str:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
