"""`deitalk blender`: the Blender add-on."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import console
from deitalk.cli.options import Force
from deitalk.cli.paths import reserve_file
from deitalk.errors import DeitalkError


def blender(
    out: Annotated[Path, typer.Argument(help="File to write, .py.")] = Path("deitalk_blender.py"),
    force: Force = False,
) -> None:
    """Write the Blender add-on: takes on the shape keys of a face.

    Install it in Blender: Edit > Preferences > Add-ons > Install from Disk.

    Examples
    --------
    deitalk blender deitalk_blender.py
    """
    from rig.files import atomic_write
    from rig.formats.blender import addon_text

    if out.suffix.lower() != ".py":
        raise DeitalkError(f"{out} has suffix {out.suffix or 'none'!r}; an add-on is a .py file")
    reserve_file(out, force=force)
    with atomic_write(out) as beside:
        beside.write_text(addon_text(), encoding="utf-8")
    console().print(f"{out}: Blender > Edit > Preferences > Add-ons > Install from Disk")
