"""`deitalk preview`, and `deitalk face`: the embedded head in pictures, its rig's controls."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import console, emit, emit_json
from deitalk.cli.options import CheckedCommands, Force, Identity
from deitalk.cli.targets import reserve_file
from deitalk.errors import DeitalkError

app = CheckedCommands(
    help="The embedded head: sheets, identities, export; its controls.",
    no_args_is_help=True,
)


@app.command()
def identities() -> None:
    """List the identities of the embedded head."""
    from rig.face import IDENTITIES
    from rig.face.identity import ROLES

    roles = {name: role for role, name in ROLES.items()}
    for number, person in enumerate(IDENTITIES):
        emit("\t".join([str(number), person.name, *filter(None, [roles.get(person.name)])]))


@app.command()
def export(
    out: Annotated[Path, typer.Option("--out", "-o", help="GLB file to write.")] = Path("head.glb"),
    identity: Identity = "0",
    force: Force = False,
) -> None:
    """Write the head with ARKit's 52 shapes and correctives, as sparse morph targets.

    Examples
    --------
    deitalk face export -o head.glb

    deitalk face export --identity Bruno -o bruno.glb
    """
    from rig.face import build_head
    from rig.face.identity import identity_of
    from rig.retarget.head_glb import CORRECTIVES, write_head

    if out.suffix.lower() != ".glb":
        raise DeitalkError(f"{out} has suffix {out.suffix or 'none'!r}; a head is a .glb file")
    reserve_file(out, force=force)
    head = build_head(identity_of(identity))
    names = write_head(out, head).names
    console().print(
        f"{out}: {head.identity.name}, {len(names) - len(CORRECTIVES)} shapes "
        f"and {len(CORRECTIVES)} correctives"
    )


@app.command("import")
def import_(
    source: Annotated[Path, typer.Argument(help="GLB with morph targets of ARKit's names.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Head file (.npz); beside the GLB.")
    ] = None,
    force: Force = False,
) -> None:
    """Make a head of your own for --identity, from a GLB with ARKit's blendshapes.

    Examples
    --------
    deitalk face import mine.glb

    deitalk preview take/ --identity mine.npz
    """
    from rig.face.identity import HEAD_FILE
    from rig.retarget.head_import import import_head

    target = source.with_suffix(HEAD_FILE) if out is None else out
    if target.suffix.lower() != HEAD_FILE:
        raise DeitalkError(
            f"{target} has suffix {target.suffix or 'none'!r}; a head is a {HEAD_FILE} file"
        )
    reserve_file(target, force=force, inputs=(source,))
    with console().status("importing"):
        made = import_head(source, target)
    console().note(*made.notes)
    console().print(f"{target}: {made.shapes} shapes, {made.vertices} vertices")


@app.command()
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
    deitalk face controls jaw

    deitalk face controls --set lip --json
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
        raise DeitalkError(f"no control matches {match!r}; `deitalk face controls` lists all")
    if as_json:
        emit_json(rows)
        return
    for row in rows:
        emit("\t".join(str(value) for value in row.values()))
    console().print(f"{everything.id}: {len(rows)} " + ("sets" if sets else "controls"))
