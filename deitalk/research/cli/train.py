"""`python -m deitalk.research train`: a model of a configuration."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.finetune import shown_on
from deitalk.cli.options import Overrides, Resume, Track

if TYPE_CHECKING:
    from deitalk.config.load import AnyConfig


def train(
    config: Annotated[Path, typer.Argument(help="YAML configuration, such as configs/mel.yaml.")],
    data: Annotated[Path, typer.Option(help="Dataset folder; SDFA also takes meshes.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Run folder.")],
    overrides: Overrides = None,
    resume: Resume = False,
    start_from: Annotated[
        str | None, typer.Option("--from", help="Model whose weights are the start (fine-tuning).")
    ] = None,
    track: Track = None,
) -> None:
    """Train a model; the best weights by development score are in OUT/best.

    Examples
    --------
    python -m deitalk.research train configs/mel.yaml --data corpus/ -o runs/mel

    train configs/mel.yaml --data my_rig/ --from default --set train.steps=500 -o runs/mine

    python -m deitalk.research train configs/sdfa.yaml --data corpus/ -o runs/sdfa
    """
    from deitalk.research.config import read_training

    settings = read_training(config, overrides or ())
    with console().status("loading"):
        from deitalk.evaluation.figures import can_draw

        fit = _training(settings, start_from)
        if not can_draw():
            console().print("without pictures in OUT/curves: pip install matplotlib")
    with bar("training") as advance:
        best = fit(data, out, resume=resume, track=track or (), progress=shown_on(advance))
    _report(out, best)


def _training(settings: "AnyConfig", start_from: str | None) -> "Callable[..., dict[str, Any]]":
    """The training of the configuration's kind of model."""
    from deitalk.errors import ConfigError
    from deitalk.models.folder import model_folder
    from deitalk.research.config import MeshTrainingConfig, TrainingConfig

    if isinstance(settings, MeshTrainingConfig):
        if start_from is not None:
            raise ConfigError("--from: not for mesh models; leave it out, or use --resume")
        from deitalk.research.meshes.training import train_mesh

        return partial(train_mesh, settings)
    from deitalk.research.training.curves import train_curves

    assert isinstance(settings, TrainingConfig)
    start = None if start_from is None else model_folder(start_from)
    return partial(train_curves, settings, start_from=start)


def _report(out: Path, best: dict[str, Any]) -> None:
    """Print the kept step and its scores, in the first of several processes."""
    if os.environ.get("RANK", "0") != "0":
        return
    scores = ", ".join(f"{k} {v:.4g}" for k, v in best.get("development", {}).items())
    console().print(f"{out / 'best'}: step {best.get('step')}, {scores}")
