"""`deitalk model`: what a model is."""

import json
from typing import Annotated

import typer

from deitalk.cli.words import words

app = typer.Typer(help="What a model is.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """What a model is."""


@app.command()
def info(
    model: Annotated[str, typer.Argument(help="default, compact, or a model folder.")] = "default",
    as_json: Annotated[bool, typer.Option("--json", help="For machines.")] = False,
) -> None:
    """Show control set, size, hash and training of a model."""
    from deitalk.checkpoint import describe_model, embedded_models

    about = describe_model(model)
    if as_json:
        typer.echo(json.dumps(about))
        return
    for key, value in about.items():
        typer.echo(f"{key}\t{json.dumps(value) if isinstance(value, dict) else value}")
    words().print(f"embedded models: {', '.join(embedded_models()) or 'none'}")
