"""`deitalk data`: check a dataset folder."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.arguments import MAX_COUNT, CheckedCommands
from deitalk.cli.console import bar, emit, emit_json
from rig.errors import as_line

app = CheckedCommands(help="Check a dataset folder.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Check a dataset folder."""


@app.command()
def check(
    folder: Annotated[Path, typer.Argument(help="Dataset folder with clips.csv.")],
    most: Annotated[
        int | None,
        typer.Option(min=1, max=MAX_COUNT, help="Most clips to read, evenly spread."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Check a dataset folder for training; exit code 1 on errors.

    Names, rates, lengths, offset of curves and sound, silence, ranges, controls that never move,
    balance of the emotions, speakers in several splits.

    Examples
    --------
    deitalk data check my_capture/
    """
    from deitalk.data.checks import check_dataset

    with bar("reading") as progress:
        checks = check_dataset(folder, most=most, progress=progress)
    if as_json:
        rows = [{"check": c.name, "level": c.level, "text": c.text} for c in checks]
        emit_json(rows, indent=1)
    else:
        for c in checks:
            emit(as_line(f"{c.level:8} {c.name:13} {c.text}"))
    if any(c.level == "error" for c in checks):
        raise typer.Exit(1)
