"""The numbers of a training run: rows of CSV files, and TensorBoard's events.

A killed run leaves rows beyond its last state, and a full disk half of a row; `truncate_log`
drops them, so that a resumed run writes every row once.
"""

import math
from pathlib import Path
from typing import Any

from deitalk.errors import DataError, MissingError
from rig.files import (
    atomic_write,
)


class Journal:
    """The numbers of a run: rows of CSV files, and TensorBoard's events if `tensorboard`.

    Parameters
    ----------
    out : Path
        Run folder.
    step : int
        Steps done before; events beyond are hidden, as the run makes them again.
    tensorboard : bool
        Write events too, to ``tensorboard/``.

    Raises
    ------
    MissingError
        If `tensorboard` is set and TensorBoard is not installed.
    """

    def __init__(self, out: Path, *, step: int = 0, tensorboard: bool = False) -> None:
        self.out = out
        self._events: Any = None
        if tensorboard:
            self._events = summary_writer()(out / "tensorboard", purge_step=step + 1)

    def write(self, table: str, step: int, values: dict[str, float]) -> None:
        """Append a row to ``<table>.csv``; finite numbers become scalars ``<table>/<name>``."""
        log(self.out / f"{table}.csv", step, values)
        if self._events is None:
            return
        for name, value in values.items():
            if math.isfinite(value):
                self._events.add_scalar(f"{table}/{name.removeprefix('dev_')}", value, step)
        self._events.flush()

    def close(self) -> None:
        """Finish the file of events."""
        if self._events is not None:
            self._events.close()


def summary_writer() -> Any:
    """TensorBoard's writer of events, a class.

    Raises
    ------
    MissingError
        If TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise MissingError(
            "`tensorboard=True` needs TensorBoard; pip install 'deitalk[tensorboard]'",
            parameter="tensorboard",
        ) from None
    return SummaryWriter


def log(path: Path, step: int, values: dict[str, float]) -> None:
    """Append a row to a CSV file; the first one is written with the header, both or none."""
    row = ",".join([str(step), *(f"{value:.6g}" for value in values.values())]) + "\n"
    if path.exists():
        with path.open("ab", buffering=0) as file:  # one system call: a kill does not cut it
            file.write(row.encode())
        return
    with atomic_write(path) as beside:
        beside.write_text(",".join(["step", *values]) + "\n" + row, encoding="utf-8")


def truncate_log(path: Path, step: int) -> None:
    """Drop a log's rows beyond a step; a resumed run writes them again.

    Half a row at the end is dropped too; a log that holds no row is removed.

    Raises
    ------
    DataError
        If a line is not one that `log` writes.
    """
    if not path.is_file():
        return
    header, *rows = _lines(path) or [""]
    if rows and not rows[-1].endswith("\n"):
        rows.pop()
    kept = [row for i, row in enumerate(rows) if _step_of(path, i + 2, row) <= step]
    if not kept:
        path.unlink()
    elif len(kept) < len(rows) or [header, *kept] != _lines(path):
        with atomic_write(path) as beside:
            beside.write_text("".join([header, *kept]), encoding="utf-8")


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines(keepends=True)
    except UnicodeDecodeError:
        raise DataError(f"{path}: no UTF-8 text, so no log of a run; move it away") from None


def _step_of(path: Path, number: int, row: str) -> int:
    try:
        return int(row.split(",", 1)[0])
    except ValueError:
        raise DataError(
            f"{path}: line {number} does not begin with a step; correct it, or move the file away"
        ) from None
