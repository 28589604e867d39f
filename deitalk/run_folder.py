"""The folder of a training run, and how an interrupted one goes on.

::

    config.yaml          every setting of the run
    metrics.csv          losses, gradient norm and learning rate, a row every 25 steps
    development.csv      development scores, a row an evaluation
    curves/<step>.png    fixed clips, targets and predictions, a picture an evaluation
    tensorboard/         both tables as TensorBoard's events, where they are asked for
    best/, last/         model folders
    state.pt             everything a killed run needs to go on exactly
"""

import csv
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import yaml

from deitalk.config import AnyConfig, load_config
from deitalk.errors import ConfigError, DataError, MissingError
from rig.files import atomic_write

MAY_CHANGE = ("name", "train.workers", "train.evaluate_every")
"""Settings that a resumed run may have changed."""


def open_folder(out: Path, config: AnyConfig, *, resume: bool, write: bool) -> None:
    """Refuse to mix two runs in one folder; else write the configuration there.

    Parameters
    ----------
    out : Path
        Run folder.
    config : Config or SDFAConfig
        Settings of the run that begins or goes on.
    resume : bool
        Whether it goes on.
    write : bool
        Whether this is the process that writes.

    Raises
    ------
    DataError
        If a run is there and `resume` is not asked for, or the other way round.
    ConfigError
        If the run that goes on was begun with other settings.
    """
    if resume and not (out / "state.pt").is_file():
        raise DataError(f"{out}: no state.pt to go on from; leave out --resume to begin")
    if not resume and (out / "metrics.csv").exists():
        raise DataError(f"{out}: holds a run already; use --resume, or name another folder")
    settings = config.model_dump(mode="json")
    if resume and (out / "config.yaml").is_file():
        before = load_config(out / "config.yaml").model_dump(mode="json")
        changed = [key for key in _differences(before, settings) if key not in MAY_CHANGE]
        if changed:
            raise ConfigError(
                f"{out}: the run was begun with another {', '.join(changed)}; resume with its "
                "own config.yaml"
            )
    if write:
        out.mkdir(parents=True, exist_ok=True)
        with atomic_write(out / "config.yaml") as beside:
            beside.write_text(yaml.safe_dump(settings, sort_keys=False))


def _differences(a: dict[str, Any], b: dict[str, Any], prefix: str = "") -> list[str]:
    """Dotted keys whose values differ between two trees."""
    out = []
    for key in sorted(a.keys() | b.keys()):
        first, second = a.get(key), b.get(key)
        if isinstance(first, dict) and isinstance(second, dict):
            out += _differences(first, second, f"{prefix}{key}.")
        elif first != second:
            out.append(prefix + key)
    return out


def save_state(out: Path, parts: dict[str, Any], numbers: dict[str, float]) -> None:
    """Write ``state.pt``: the states of modules and optimisers, and numbers."""
    states = {name: part.state_dict() for name, part in parts.items()}
    with atomic_write(out / "state.pt") as beside:
        torch.save(states | numbers, beside)


def restore_state(out: Path, parts: dict[str, Any]) -> dict[str, float]:
    """Read ``state.pt`` into the parts that `save_state` was given; return the numbers.

    Raises
    ------
    DataError
        If the file is damaged or of another model.
    """
    path = out / "state.pt"
    try:
        state = torch.load(path, weights_only=True, map_location="cpu")
        for name, part in parts.items():
            part.load_state_dict(state[name])
        return {name: state[name] for name in ("step", "best_score")}
    except (RuntimeError, KeyError, ValueError, TypeError, EOFError, pickle.UnpicklingError):
        raise DataError(
            f"{path}: damaged, or of another model; begin a run in another folder"
        ) from None


def go_on(out: Path, parts: dict[str, Any], *, forgets: bool) -> tuple[int, float]:
    """Bring the parts to where a run stopped; return its step and the best score so far.

    Rows and pictures beyond that step are dropped by the process that `forgets`: the run will
    make them again.

    Raises
    ------
    DataError
        If ``state.pt`` is damaged or of another model.
    """
    numbers = restore_state(out, parts)
    step = int(numbers["step"])
    if forgets:
        for name in ("metrics.csv", "development.csv"):
            forget(out / name, step)
        for picture in (out / "curves").glob("*.png"):
            if picture.stem.isdecimal() and int(picture.stem) > step:
                picture.unlink()
    return step, float(numbers["best_score"])


def keep(
    out: Path,
    parts: dict[str, Any],
    step: int,
    scores: dict[str, float],
    best_score: float,
    save: Callable[[Path, dict[str, Any]], None],
) -> float:
    """Write ``last/``, ``best/`` if no score was higher, and ``state.pt``.

    Parameters
    ----------
    out : Path
        Run folder.
    parts : dict
        Modules and optimisers, for `save_state`.
    step : int
        Steps done.
    scores : dict
        Of the development set, with ``score``.
    best_score : float
        The highest before.
    save : callable
        Writes the weights to a model folder, with what is said of the training.

    Returns
    -------
    float
        The highest score now.
    """
    summary = {"step": step, "development": scores}
    if scores["score"] >= best_score:
        best_score = scores["score"]
        save(out / "best", summary)
    save(out / "last", summary)
    save_state(out, parts, {"step": step, "best_score": best_score})
    return best_score


def picture_path(out: Path, step: int) -> Path:
    """Where an evaluation's curves are drawn; names sort by step."""
    (out / "curves").mkdir(exist_ok=True)
    return out / "curves" / f"{step:06d}.png"


class Journal:
    """The numbers of a run: rows of CSV files, and TensorBoard's events where asked for.

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
        If TensorBoard is asked for and not installed.
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
            "--tensorboard needs tensorboard; pip install 'deitalk[tensorboard]'"
        ) from None
    return SummaryWriter


def log(path: Path, step: int, values: dict[str, float]) -> None:
    """Append a row to a CSV file; the first one writes the header."""
    is_new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if is_new:
            writer.writerow(["step", *values])
        writer.writerow([step, *(f"{value:.6g}" for value in values.values())])


def forget(path: Path, step: int) -> None:
    """Drop a log's rows beyond a step: the run that goes on writes them again."""
    if not path.is_file():
        return
    header, *rows = path.read_text().splitlines(keepends=True)
    kept = [row for row in rows if row.endswith("\n") and int(row.split(",", 1)[0]) <= step]
    with atomic_write(path) as beside:
        beside.write_text("".join([header, *kept]))
