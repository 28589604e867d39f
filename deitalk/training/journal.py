"""The numbers of a training run: rows of CSV files, and what trackers of accelerate are given.

A killed run leaves rows beyond its last state, and a full disk half of a row; `truncate_log`
drops them, so that a resumed run writes every row once.
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deitalk.errors import ConfigError, DataError, MissingError
from rig.errors import quoted
from rig.files import atomic_write, replace_recorded

PROJECT = "deitalk"
"""Name of the project, experiment or folder in a tracker."""
RUNS = "trackers.json"
"""File of a run folder: what trackers call the run, by their names."""


class Journal:
    """The numbers of a run: rows of CSV files, and trackers.

    Parameters
    ----------
    out : Path
        Run folder.
    step : int
        Steps done before; TensorBoard hides events beyond, as the run makes them again.
    accelerator : accelerate.Accelerator or None
        Begins and has the trackers, if it was made with any.
    """

    def __init__(self, out: Path, *, step: int = 0, accelerator: Any = None) -> None:
        self.out, self._accelerator = out, accelerator
        if accelerator is None or not accelerator.log_with:
            self._accelerator = None
            return
        known = json.loads((out / RUNS).read_text()) if (out / RUNS).is_file() else {}
        options: dict[str, dict[str, Any]] = {
            "tensorboard": {"purge_step": step + 1},
            "wandb": {"name": out.name, "dir": str(out)},
            "mlflow": {"run_name": out.name},
        }
        if "wandb" in known:
            options["wandb"] |= {"id": known["wandb"], "resume": "allow"}
        if "mlflow" in known:
            options["mlflow"] |= {"run_id": known["mlflow"]}
        accelerator.init_trackers(PROJECT, init_kwargs=options)
        for tracker in accelerator.trackers:
            if tracker.name == "wandb":
                known["wandb"] = tracker.tracker.id
            elif tracker.name == "mlflow":
                known["mlflow"] = tracker.tracker.info.run_id
        if known:
            replace_recorded(out, RUNS, json.dumps(known))

    def write(self, table: str, step: int, values: dict[str, float]) -> None:
        """Append a row to ``<table>.csv``; trackers get finite numbers as ``<table>/<name>``."""
        log(self.out / f"{table}.csv", step, values)
        if self._accelerator is None:
            return
        finite = {
            f"{table}/{name.removeprefix('dev_')}": value
            for name, value in values.items()
            if math.isfinite(value)
        }
        self._accelerator.log(finite, step=step)

    def close(self) -> None:
        """Finish the run of each tracker."""
        for tracker in [] if self._accelerator is None else self._accelerator.trackers:
            tracker.finish()


def check_trackers(names: Sequence[str]) -> None:
    """Check that trackers can be used, before anything is read.

    Raises
    ------
    ConfigError
        If accelerate has none of a name.
    MissingError
        If the package of one is not installed.
    """
    if not names:
        return
    from accelerate.tracking import LOGGER_TYPE_TO_CLASS, get_available_trackers

    usable = {str(name) for name in get_available_trackers()}
    for name in names:
        if name not in LOGGER_TYPE_TO_CLASS:
            every = ", ".join(sorted(LOGGER_TYPE_TO_CLASS))
            raise ConfigError(f"`track={quoted(name)}` must be one of {every}", parameter="track")
        if name not in usable:
            raise MissingError(
                f"`track={name}` needs its package; pip install {name}", parameter="track"
            )


def log(path: Path, step: int, values: dict[str, float]) -> None:
    """Append a row to a CSV file; the first one is written with the header, both or none."""
    row = ",".join([str(step), *(f"{value:.6g}" for value in values.values())]) + "\n"
    if path.exists():
        with path.open("ab", buffering=0) as file:  # one system call: a kill does not cut it
            file.write(row.encode())
        return
    with atomic_write(path) as beside:
        beside.write_text(",".join(["step", *values]) + "\n" + row, encoding="utf-8")


def read_log(path: Path) -> dict[str, list[float]]:
    """Columns of a log, by their names."""
    names, *rows = (line.split(",") for line in path.read_text(encoding="utf-8").splitlines())
    columns = zip(*rows, strict=True)
    return {name: [*map(float, column)] for name, column in zip(names, columns, strict=True)}


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
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        whole = [line for line in lines[1:] if line.endswith("\n")]
        kept = [row for row in whole if int(row.split(",", 1)[0]) <= step]
    except ValueError:  # the error of text that is no UTF-8 is one too
        raise DataError(f"{path}: not the log of a run; correct it, or move it away") from None
    if not kept:
        path.unlink()
    elif len(kept) < len(lines) - 1:
        with atomic_write(path) as beside:
            beside.write_text("".join([lines[0], *kept]), encoding="utf-8")
