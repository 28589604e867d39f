"""`deitalk finetune`: a model tuned on captures."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deitalk.cli.console import bar, console, emit
from deitalk.cli.options import (
    Base,
    LeaveOut,
    Overrides,
    Recipe,
    Resume,
    RigFile,
    RigMap,
    Strict,
    Track,
)

if TYPE_CHECKING:
    from deitalk.cli.console import Advance
    from deitalk.training.trainer import Progress


def shown_on(advance: "Advance") -> "Progress":
    """Return a callback that shows step, loss, and the scores of every evaluation."""

    def progress(step: int, total: int, values: dict[str, float]) -> None:
        scores = [f"{name[4:]} {v:.4g}" for name, v in values.items() if name.startswith("dev_")]
        loss = [f"loss {values['total']:.4g}"] if "total" in values else []
        rate = [f"{values['rate']:.3g} samples/s"] if "rate" in values else []
        steps = [f"step {step} of {total}"] if total else ["the regression"]
        text = ", ".join([*steps, *loss, *rate, *scores])
        for phase in {"read", "encoded", "fitted"} & values.keys():
            text = f"{values[phase]:.0%} of the captures {phase}"
        advance(step / max(total, 1), text, always=bool(scores))

    return progress


def finetune(
    data: Annotated[Path, typer.Argument(help="Dataset folder of captures (docs/dataset.md).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Run folder.")],
    base: Base = None,
    recipe: Recipe = None,
    rig: RigFile = None,
    mapping: RigMap = None,
    part: Annotated[
        str | None, typer.Option("--tune", help="What train.steps change: head, decoder or all.")
    ] = None,
    rehearse: Annotated[
        str | None, typer.Option("--rehearse", help="Dataset folder whose speech holds the base.")
    ] = None,
    leave_out: LeaveOut = None,
    overrides: Overrides = None,
    strict: Strict = False,
    resume: Resume = False,
    track: Track = None,
) -> None:
    """Tune a model on captures of an actor or of another rig; the result is OUT/best.

    OUT/report.md compares it with the model before, the mean pose and loudness on held-out clips.

    Examples
    --------
    deitalk finetune my_captures/ -o runs/anna

    deitalk finetune my_captures/ --rig my_rig.yaml -o runs/my_rig
    """
    changes = {"tune.part": part, "tune.corpus": rehearse}
    with console().status("loading"):
        from deitalk.training.tuning.public import run_tuning, settings_of
        from rig.files import remove_written

        settings = settings_of(
            data,
            base=base,
            rig=rig,
            mapping=mapping,
            leave_out=leave_out,
            recipe=recipe,
            settings=changes,
            overrides=overrides or (),
        )
    options: dict[str, Any] = {"resume": resume, "track": track or ()}
    with bar("tuning") as advance:
        tuned = run_tuning(settings, data, out, progress=shown_on(advance), **options)
    remove_written(out / "last")  # only the best is used
    print_scores(tuned.scores)
    console().print(f"{tuned.model}: the tuned model; {out / 'report.md'}: before and after")
    console().print(f"the result is {tuned.delivered}")
    for name, takes in tuned.conventions.items():
        console().note(f"style {name}: {', '.join(takes)}, which share a convention")
    console().note(*tuned.warnings)
    _write_page(out)
    if strict and not tuned.beats_loudness:
        raise typer.Exit(NOT_BETTER)


NOT_BETTER = 3
"""Exit code with --strict where a tuned model is no better than a line over loudness."""


def print_scores(scores: dict[str, dict[str, float]]) -> None:
    """Print the scores of systems, one a line."""
    for name, values in scores.items():
        text = ", ".join(
            f"{key} {values[key]:.3g}"
            for key in ("error_of_mean_pose", "mean_r", "range")
            if values.get(key) is not None
        )
        emit(f"{name}\t{text}")


def _write_page(out: Path) -> None:
    """Play a held-out clip: captured, before and after, side by side or as lines."""
    from deitalk.errors import MissingError
    from deitalk.evaluation.captures import COMPARED
    from deitalk.preview.page import render_page
    from deitalk.preview.source import load_source

    folder, page = out / COMPARED, out / f"{COMPARED}.html"
    names = ("capture", "before", "after")
    paths = [folder / f"{name}.npz" for name in names if (folder / f"{name}.npz").is_file()]
    try:
        sounds = (folder / "audio.wav", None, None)
        takes = [load_source(*each) for each in zip(paths, sounds, strict=False)]
        render_page(takes, page, force=True)
    except MissingError as error:
        console().note(str(error))
    else:
        console().print(f"{page}: capture, before and after, side by side")
