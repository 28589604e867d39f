"""`folds`: a tuning without each take or actor in turn, tested there."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.finetune import NOT_BETTER, print_scores, shown_on


def folds(
    data: Annotated[Path, typer.Argument(help="Dataset folder of captures (docs/dataset.md).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Run folder.")],
    kind: Annotated[str, typer.Option("--of", help="What is left out: takes or actors.")] = "takes",
    base: Annotated[str | None, typer.Option("--from", help="Model to tune.")] = None,
    recipe: Annotated[Path | None, typer.Option("--recipe", help="YAML of a tuning.")] = None,
    rig: Annotated[str | None, typer.Option("--rig", help="YAML of another rig.")] = None,
    mapping: Annotated[
        Path | None, typer.Option("--map", help="Table of the rig's curves to the board.")
    ] = None,
    leave_out: Annotated[
        str | None, typer.Option("--leave-out", help="Take or actor to test on.")
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Override, such as train.steps=400.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit code 3 where loudness predicts as well.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the run folder; begin it if it is new.")
    ] = False,
) -> None:
    """Tune a model without each take or actor in turn, and test it there.

    Examples
    --------
    python -m deitalk.research folds my_captures/ -o runs/folds
    """
    from deitalk.evaluation.captures import beats_loudness, warnings_of
    from deitalk.research.training.folds import tune_folds
    from deitalk.training.tuning.public import settings_of

    settings = settings_of(
        data,
        base=base,
        rig=rig,
        mapping=mapping,
        leave_out=leave_out,
        recipe=recipe,
        settings={},
        overrides=overrides or (),
    )
    with bar("tuning") as advance:
        result = tune_folds(settings, data, out, kind, resume=resume, progress=shown_on(advance))
    print_scores(result["folds"])
    console().print("means over the folds:")
    print_scores(result["mean"])
    for line in warnings_of(result["mean"]):
        console().note(line)
    console().print(f"{out / 'folds.md'}: all scores, of each control too")
    if strict and not beats_loudness(result["mean"]):
        raise typer.Exit(NOT_BETTER)
