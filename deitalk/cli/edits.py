"""`deitalk diff`: edits by hand as a layer that survives the next run."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import console, emit_json, reserve_file
from deitalk.cli.options import Force, Json
from deitalk.errors import DeitalkError


def diff(
    edited: Annotated[
        Path,
        typer.Argument(
            help="Edited curves: csv, json, unreal.json, a Live Link CSV, or what Blender or Maya "
            "give back."
        ),
    ],
    take: Annotated[Path, typer.Argument(help="The take folder that was edited.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Layer to write: fixes.edit.json.")
    ] = Path("fixes.edit.json"),
    source_fps: Annotated[
        float | None, typer.Option(help="Rate of the edited file, Hz, if it does not contain it.")
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            min=0.001,
            max=0.2,
            help="How far curves with the layer may be from the edited ones; half of it is noise.",
        ),
    ] = 0.01,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write what somebody changed in a take by hand as a layer, for `animate --edit`.

    Examples
    --------
    deitalk diff edited.csv take/ -o fixes.edit.json

    deitalk diff from_unreal.unreal.json take/ -o fixes.edit.json

    deitalk animate speech.wav --edit fixes.edit.json -o again/
    """
    from deitalk.data.edited import changes_of_take
    from rig.curves.layers import SUFFIX
    from rig.files import atomic_write

    if not out.name.lower().endswith(".json"):
        raise DeitalkError(f"{out} must be a .json file, such as fixes{SUFFIX}")
    inputs = (edited, take if take.is_file() else take / "curves.json")
    reserve_file(out, force=force, inputs=inputs)
    name = out.name.removesuffix(SUFFIX).removesuffix(".json")
    found = changes_of_take(edited, take, fps=source_fps, tolerance=tolerance, name=name)
    layer = found.layer
    if not layer.edits:
        raise DeitalkError(
            f"{edited} differs from {take} by no more than noise ({tolerance / 2:g}); nothing is "
            "written"
        )
    with atomic_write(out) as beside:
        beside.write_text(layer.text, encoding="utf-8")
    controls = len({edit.target for edit in layer.edits})
    size = len(layer.text.encode())
    if as_json:
        emit_json({
            "out": str(out), "edits": len(layer.edits), "controls": controls,
            "keys": layer.n_keys, "share_of_values": found.share, "bytes": size,
            "owned": [edit.target for edit in layer.edits if edit.owns],
            "notes": list(found.notes),
        })  # fmt: skip
        return
    for note in found.notes:
        console().note(note)
    console().print(
        f"{out}: {len(layer.edits)} edits of {controls} controls, {layer.n_keys} keys "
        f"({found.share:.2%} of the take's values), {size / 1000:.1f} kB"
    )
