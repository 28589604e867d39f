"""`deitalk controls`: the 185 controls, their ranges and sets."""

from typing import Annotated

import typer

from deitalk.cli.console import console, emit, emit_json
from deitalk.errors import DeitalkError


def controls(
    match: Annotated[str, typer.Argument(help="Part of a name; all without it.")] = "",
    subset: Annotated[
        str | None, typer.Option("--set", help="A set or region: lip, upper_face, jaw, left …")
    ] = None,
    sets: Annotated[bool, typer.Option("--sets", help="List the sets and their sizes.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the controls of the rig.

    Examples
    --------
    deitalk controls jaw

    deitalk controls --set lip --json
    """
    from rig import default_controls

    everything = default_controls()
    if sets:
        rows = [
            {"set": name, "controls": len(everything.subset(name))}
            for name in everything.subset_names
        ]
    else:
        chosen = range(len(everything.names)) if subset is None else everything.subset(subset)
        table = everything.controls
        rows = [
            {
                "index": int(i),
                "control": table[i].name,
                "minimum": table[i].minimum,
                "maximum": table[i].maximum,
                "rest": table[i].rest,
                "region": table[i].region,
            }
            for i in chosen
            if match.lower() in table[i].name.lower()
        ]
    if not rows:
        raise DeitalkError(f"no control matches {match!r}; `deitalk controls` lists all")
    if as_json:
        emit_json(rows)
        return
    for row in rows:
        emit("\t".join(str(value) for value in row.values()))
    console().print(f"{everything.id}: {len(rows)} " + ("sets" if sets else "controls"))
