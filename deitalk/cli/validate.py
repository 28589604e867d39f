"""`deitalk validate`: errors and warnings of importers for a file."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import emit, emit_json
from rig.errors import as_line


def validate(
    path: Annotated[Path, typer.Argument(help="A file of curves, or a take folder.")],
    strict: Annotated[bool, typer.Option("--strict", help="Exit code 1 on warnings too.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Check a file or a take by the rules of the importing programs; exit code 1 on errors.

    Cell counts, time codes, ranges, NaN, constant curves, jumps, open mouths at the end, and
    effects in Unreal.

    Examples
    --------
    deitalk validate take/

    deitalk validate MySlate_1_iPhone.csv --json
    """
    from rig.validation.curves import validate as check

    validation = check(path)
    if as_json:
        rows = [
            {"level": f.level, "path": str(f.path), "text": f.text} for f in validation.findings
        ]
        emit_json({"ok": validation.ok, "findings": rows}, indent=1)
    else:
        for finding in validation.findings:
            emit(as_line(f"{finding.level:8} {finding.path.name or finding.path}: {finding.text}"))
    is_warned = strict and any(f.level == "warning" for f in validation.findings)
    if not validation.ok or is_warned:
        raise typer.Exit(1)
