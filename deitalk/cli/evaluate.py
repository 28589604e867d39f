"""`deitalk evaluate`: score a model on a dataset folder."""

import json
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
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write a report: .md or .json.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the report.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Score lips, errors, emotions and silence, beside the loudness baseline.

    Examples
    --------
    deitalk evaluate default --data corpus/ --split test

    deitalk evaluate runs/mel/best --data corpus/ --most 100 -o report.md
    """
    if out is not None and out.exists() and not force:
        raise DataError(f"{out} exists; add --force to replace it, or name another file")
    with words().status("loading"):
        from deitalk.checkpoint import load_model
        from deitalk.evaluate import as_markdown
        from deitalk.evaluate import evaluate as score
        from rig.files import atomic_write

        network = load_model(model)
    with bar("evaluating") as progress:
        report = score(network, data, split=split, most=most, progress=progress)
    text = json.dumps(report, indent=1) + "\n" if as_json else as_markdown(report)
    typer.echo(text, nl=False)
    if out is not None:
        with atomic_write(out) as beside:
            written = json.dumps(report, indent=1) if out.suffix == ".json" else as_markdown(report)
            beside.write_text(written, encoding="utf-8")
