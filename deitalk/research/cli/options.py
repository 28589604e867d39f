"""Options that several verbs of a checkout share."""

from typing import Annotated

import typer

from deitalk.cli.options import MAX_COUNT

MAX_SEED = 2**32 - 1
"""Largest seed of every generator."""
Most = Annotated[
    int | None,
    typer.Option(min=1, max=MAX_COUNT, help="Most recordings of every source."),
]
