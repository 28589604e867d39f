"""`python -m deitalk.research sheet`: contact sheets of the embedded head."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import console
from deitalk.cli.options import Force, Identity
from deitalk.cli.targets import reserve_file
from deitalk.errors import DeitalkError


def sheet(
    name: Annotated[
        str,
        typer.Argument(
            help="people, mouth, mouth-side, emotions, views, or a region: brow, eye, nose, "
            "cheek, lips, jaw, tongue, teeth, neck, ear."
        ),
    ] = "mouth",
    out: Annotated[Path, typer.Option("--out", "-o", help="PNG file to write.")] = Path(
        "sheet.png"
    ),
    identity: Identity = "0",
    columns: Annotated[int, typer.Option(min=1, max=12, help="Tiles in a row.")] = 4,
    tile: Annotated[int, typer.Option(min=64, max=2048, help="Height of a tile, pixels.")] = 340,
    force: Force = False,
) -> None:
    """Draw a contact sheet of the head.

    Examples
    --------
    python -m deitalk.research sheet mouth -o mouth.png

    python -m deitalk.research sheet emotions --identity child --columns 5 -o child.png
    """
    from deitalk.research.contact_sheet import draw_people, draw_sheet, sheet_tiles, write_png
    from rig.face import build_head

    if out.suffix.lower() != ".png":
        raise DeitalkError(f"{out} has suffix {out.suffix or 'none'!r}; a sheet is a .png file")
    reserve_file(out, force=force)
    if name == "people":
        write_png(out, draw_people())
        console().print(f"{out}: all heads")
        return
    tiles = sheet_tiles(name)
    head = build_head(identity)
    picture = draw_sheet(
        head, tiles, columns=min(columns, len(tiles)), size=(round(tile * 1.12), tile)
    )
    write_png(out, picture)
    console().print(f"{out}: {len(tiles)} pictures of {head.identity.name}")
