"""Options that several verbs of a checkout share."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.options import MAX_COUNT

MAX_SEED = 2**32 - 1
"""Largest seed of every generator."""
Most = Annotated[
    int | None,
    typer.Option(min=1, max=MAX_COUNT, help="Most recordings of every source."),
]
Split = Annotated[str, typer.Option(help="validation for choices, test for final scores.")]
Report = Annotated[Path | None, typer.Option("--out", "-o", help="Write a report: .md or .json.")]
Picture = Annotated[Path | None, typer.Option(help="Draw the report: .png, .svg or .pdf.")]
