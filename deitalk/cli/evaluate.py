"""`deitalk evaluate`: score a model on a dataset folder."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.words import bar, words
from deitalk.errors import DataError


def evaluate(
    model: Annotated[str, typer.Argument(help="default, compact, or a model folder.")] = "default",
    data: Annotated[Path, typer.Option(help="Dataset folder.")] = Path("corpus"),
    split: Annotated[str, typer.Option(help="validation for choices, test once.")] = "validation",
    most: Annotated[
        int | None, typer.Option(min=1, help="At most so many recordings of every source.")
    ] = None,
    probes: Annotated[
        int,
        typer.Option(min=0, help="Recordings of every source acted in all emotions and modified."),
    ] = 6,
    noise: Annotated[
        str | None, typer.Option(help="Also in noise: a folder of recordings, or pink.")
    ] = None,
    captured: Annotated[
        Path | None, typer.Option(help="Captured curves, to set our smoothness beside theirs.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write a report: .md or .json.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the report: .png, .svg or .pdf.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the report.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Score lips, errors, emotions and silence, beside the loudness baseline.

    Examples
    --------
    deitalk evaluate default --data corpus/ --split test

    deitalk evaluate runs/mel/best --data corpus/ --most 100 --noise pink -o report.md
    """
    _check_outputs(out, picture, force=force)
    with words().status("loading"):
        from deitalk.checkpoint import load_model
        from deitalk.evaluate import evaluate as score
        from deitalk.evaluation.report import as_json as to_json
        from deitalk.evaluation.report import as_markdown
        from rig.files import atomic_write

        network = load_model(model)
    with bar("evaluating") as progress:
        report = score(
            network,
            data,
            split=split,
            most=most,
            probes=probes,
            noise=noise,
            captured=captured,
            progress=progress,
        )
    typer.echo(to_json(report) if as_json else as_markdown(report), nl=False)
    if out is not None:
        with atomic_write(out) as beside:
            written = to_json(report) if out.suffix == ".json" else as_markdown(report)
            beside.write_text(written, encoding="utf-8")
    if picture is not None:
        from deitalk.evaluation.picture import draw

        draw(report, picture)


def _check_outputs(out: Path | None, picture: Path | None, *, force: bool) -> None:
    """Refuse files that exist or cannot be written, before the work begins."""
    for path in (out, picture):
        if path is not None and path.exists() and not force:
            raise DataError(f"{path} exists; add --force to replace it, or name another file")
    if picture is not None and picture.suffix not in (".png", ".svg", ".pdf"):
        raise DataError(f"{picture}: a picture is .png, .svg or .pdf")
