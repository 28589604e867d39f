"""`folds`: a tuning without each take or actor in turn, tested there."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.finetune import NOT_BETTER, print_scores, shown_on
from deitalk.cli.options import Base, LeaveOut, Overrides, Recipe, Resume, RigFile, RigMap, Strict


def folds(
    data: Annotated[Path, typer.Argument(help="Dataset folder of captures (docs/dataset.md).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Run folder.")],
    kind: Annotated[str, typer.Option("--of", help="What is left out: takes or actors.")] = "takes",
    base: Base = None,
    recipe: Recipe = None,
    rig: RigFile = None,
    mapping: RigMap = None,
    leave_out: LeaveOut = None,
    overrides: Overrides = None,
    strict: Strict = False,
    resume: Resume = False,
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
