"""The folder of a training run, and how an interrupted run is resumed.

::

    config.yaml          every setting of the run
    data.sha256          hash of the dataset's clips.csv
    metrics.csv          losses, gradient norm and learning rate, a row every 25 steps
    development.csv      development scores, a row an evaluation
    tensorboard/         both tables as TensorBoard's events, optional
    trackers.json        what other trackers call the run
    features/            of a frontend that does not learn, memory-mapped; may be removed
    best/, last/         model folders
    state.pt             everything that an exact continuation needs

A kill at any moment leaves whole files; ``state.pt`` is the last that an evaluation writes, and
what is beyond it is made again by a resumed run.
"""

import errno
import hashlib
import math
import os
import pickle
from collections.abc import Callable, Iterator, Mapping, Set
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import torch
import yaml
from torch import Tensor, nn

from deitalk.config.load import load_config
from deitalk.config.section import RunConfig
from deitalk.errors import ConfigError, DataError
from deitalk.models.folder import ENCODER
from deitalk.training.journal import truncate_log
from rig.files import (
    atomic_write,
    begin_folder,
    check_folder,
    claim,
    kind_of,
    recover,
    replace_recorded,
)

MAY_CHANGE = ("name", "train.workers", "train.evaluate_every")
"""Settings that a resumed run may have changed."""
KIND = "run"
"""Kind of the folder in its manifest."""
_BEGUN = ("metrics.csv", "development.csv", "state.pt", "best", "last", "meshes")
"""Files of a run that has done something."""


@contextmanager
def open_folder(
    out: Path, config: RunConfig, *, resume: bool, writes: bool = True
) -> Iterator[None]:
    """Hold a run folder until the block ends, and write the configuration there.

    Parameters
    ----------
    out : Path
        Run folder.
    config : RunConfig
        Settings of the run.
    resume : bool
        Continue the run that is there; where there is none, begin it.
    writes : bool
        Whether this is the process that writes; for others nothing is done.

    Raises
    ------
    DataError
        If a run is there and `resume` is not set.
    ConfigError
        If the run that is resumed was begun with other settings.
    rig.errors.TargetError
        If the folder holds what no run wrote, files of the run were edited, or another process
        trains there.
    """
    if not writes:
        yield
        return
    with claim(out):
        is_ours = kind_of(out) == KIND
        if is_ours and not resume and any((out / name).exists() for name in _BEGUN):
            raise DataError(
                f"{out}: holds a run already; set `resume=True` to continue it, or name another "
                "folder",
                parameter="resume",
            )
        begin_folder(out, kind=KIND)
        for folder in (out / "best", out / "last"):
            recover(folder)
            check_folder(folder, kind="model", force=True)
        if resume and (out / "config.yaml").is_file():
            before = load_config(out / "config.yaml").model_dump(mode="json")
            settings = config.model_dump(mode="json")
            changed = [key for key in _differences(before, settings) if key not in MAY_CHANGE]
            if changed:
                raise ConfigError(
                    f"{out}: the run was begun with another {', '.join(changed)}; resume with its "
                    "own config.yaml"
                )
        settings = config.model_dump(mode="json")
        replace_recorded(out, "config.yaml", yaml.safe_dump(settings, sort_keys=False))
        yield


def record_data(out: Path, data: Path) -> None:
    """Keep the hash of a dataset folder's ``clips.csv`` with a run.

    Raises
    ------
    DataError
        If the run was begun with another table.
    """
    digest = hashlib.sha256((data / "clips.csv").read_bytes()).hexdigest()
    record = out / "data.sha256"
    before = record.read_text(encoding="utf-8") if record.is_file() else None
    if before not in (None, digest) and (out / "state.pt").is_file():
        raise DataError(f"{data}: not the clips that {out} was begun with; name another run folder")
    if before != digest:
        replace_recorded(out, record.name, digest)


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


class Learnt:
    """State of a module without what never changes, and is built again.

    Parameters
    ----------
    module : Module
    frozen : set of str
        Names in its state dict.
    """

    def __init__(self, module: nn.Module, frozen: Set[str]) -> None:
        self.module, self.frozen = module, frozen

    def state_dict(self) -> dict[str, Tensor]:
        """The module's state but for what never changes."""
        return {k: v for k, v in self.module.state_dict().items() if k not in self.frozen}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Set the module's state; what never changes stays."""
        fixed = {k: v for k, v in self.module.state_dict().items() if k in self.frozen}
        self.module.load_state_dict({**fixed, **state})


def save_state(out: Path, parts: dict[str, Any], numbers: dict[str, float]) -> None:
    """Write ``state.pt``: the states of modules and optimisers, and numbers.

    Raises
    ------
    OSError
        If the file cannot be written.
    TargetError
        If the disk is full.
    """
    states = {name: part.state_dict() for name, part in parts.items()}
    try:
        with atomic_write(out / "state.pt") as beside, beside.open("wb") as file:
            torch.save(states | numbers, file)
    except (OSError, RuntimeError) as error:
        # torch raises an error of its own over that of the file.
        reason = error if isinstance(error, OSError) else error.__context__
        if isinstance(reason, KeyboardInterrupt):
            raise reason from None
        code = getattr(reason, "errno", None) or errno.EIO
        raise OSError(code, os.strerror(code), str(out / "state.pt")) from None


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
        numbers = {name: state.pop(name) for name in ("step", "best_score")}
        for name, part in parts.items() if state else ():  # nothing else where the run is over
            part.load_state_dict(state[name])
        return numbers
    except (RuntimeError, KeyError, ValueError, TypeError, EOFError, pickle.UnpicklingError):
        raise DataError(
            f"{path}: damaged, or of another model; begin a run in another folder"
        ) from None


def resume_run(out: Path, parts: dict[str, Any], *, truncate_logs: bool) -> tuple[int, float]:
    """Bring the parts to where a run stopped; return its step and the best score so far.

    Without ``state.pt``, as after a kill before the first evaluation, the parts stay as they are
    and the run begins at step 0. Rows beyond the step are dropped by the process that
    `truncate_logs`: the run will make them again.

    Raises
    ------
    DataError
        If ``state.pt`` is damaged or of another model, or a log is not one of a run.
    """
    numbers: dict[str, float] = {"step": 0, "best_score": -math.inf}
    is_begun = (out / "state.pt").is_file()
    if is_begun:
        numbers = restore_state(out, parts)
    step = int(numbers["step"])
    if truncate_logs:
        for name in ("metrics.csv", "development.csv"):
            truncate_log(out / name, step if is_begun else -1)
    return step, float(numbers["best_score"])


def save_checkpoints(
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
        Writes the weights to a model folder, with a summary of the training.

    Returns
    -------
    float
        The highest score now.
    """
    known = {name: value for name, value in scores.items() if math.isfinite(value)}
    summary = {"step": step, "development": known}  # JSON has no NaN
    if scores["score"] >= best_score:
        best_score = scores["score"]
        save(out / "best", summary)
    save(out / "last", summary)
    # Keep the encoder that did not learn once on disk, where that can be.
    best = out / "best"
    last = out / "last"
    if (best / ENCODER).is_file() and (last / ENCODER).is_file():
        with suppress(OSError), atomic_write(last / ENCODER) as beside:
            beside.unlink(missing_ok=True)
            os.link(best / ENCODER, beside)
    save_state(out, parts, {"step": step, "best_score": best_score})
    return best_score
