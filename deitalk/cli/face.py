"""`deitalk face`: the embedded head in pictures, and the controls of its rig."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import console, emit, emit_json
from deitalk.cli.options import CheckedCommands, Force, Identity
from deitalk.cli.paths import reserve_file
from deitalk.errors import DeitalkError
from deitalk.installed import research

app = CheckedCommands(
    help="The embedded head: sheets, identities, export; its controls.",
    no_args_is_help=True,
)


@app.command()
def sheet(
    name: Annotated[
        str,
        typer.Argument(
            help="mouth, mouth-side, emotions, views, or a region: brow, eye, nose, "
            "cheek, lips, jaw, tongue, teeth, neck, ear."
        ),
    ] = "mouth",
    out: Annotated[Path, typer.Option("--out", "-o", help="PNG file to write.")] = Path(
        "sheet.png"
    ),
    identity: Identity = "0",
    columns: Annotated[int, typer.Option(min=1, max=12, help="Tiles in a row.")] = 4,
    tile: Annotated[int, typer.Option(min=64, max=2048, help="Height of a tile, pixels.")] = 340,
    backend: Annotated[str, typer.Option(help="auto, opengl or software.")] = "auto",
    force: Force = False,
) -> None:
    """Draw a contact sheet of the head.

    Examples
    --------
    deitalk face sheet mouth -o mouth.png

    deitalk face sheet emotions --identity child --columns 5 -o child.png
    """
    from rig.face import build_head
    from rig.face.render.shading import write_png

    if out.suffix.lower() != ".png":
        raise DeitalkError(f"{out} has suffix {out.suffix or 'none'!r}; a sheet is a .png file")
    reserve_file(out, force=force)
    sheets = research("contact_sheet", "face sheet")
    tiles = sheets.sheet_tiles(name)
    head = build_head(identity)
    picture = sheets.draw_sheet(
        head, tiles, columns=min(columns, len(tiles)), size=(round(tile * 1.12), tile),
        backend=backend,
    )  # fmt: skip
    write_png(out, picture)
    console().print(f"{out}: {len(tiles)} pictures of {head.identity.name}")


@app.command()
def identities(
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Also draw all heads into this PNG file.")
    ] = None,
    force: Force = False,
) -> None:
    """List the identities of the embedded head, and draw them.

    Examples
    --------
    deitalk face identities -o people.png
    """
    from rig.face import IDENTITIES
    from rig.face.identity import ROLES
    from rig.face.render.shading import write_png

    roles = {name: role for role, name in ROLES.items()}
    for number, person in enumerate(IDENTITIES):
        emit("\t".join([str(number), person.name, *filter(None, [roles.get(person.name)])]))
    if out is not None:
        reserve_file(out, force=force)
        write_png(out, research("contact_sheet", "face identities --out").draw_people())
        console().print(f"{out}: {len(IDENTITIES)} heads")


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

    deitalk face export --identity Dana -o dana.glb
    """
    from rig.face import build_head
    from rig.retarget.arkit_head import CORRECTIVES, write_head

    if out.suffix.lower() != ".glb":
        raise DeitalkError(f"{out} has suffix {out.suffix or 'none'!r}; a head is a .glb file")
    reserve_file(out, force=force)
    head = build_head(identity)
    names = write_head(out, head).names
    console().print(
        f"{out}: {head.identity.name}, {len(names) - len(CORRECTIVES)} shapes "
        f"and {len(CORRECTIVES)} correctives"
    )


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
