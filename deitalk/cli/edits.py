"""`deitalk diff`: edits by hand as a layer; `deitalk dub`: another voice for a performance."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.acting_options import Given, acting_options
from deitalk.cli.console import bar, emit_outcome
from deitalk.cli.options import Delay, Device, Force, Handles, Json, Model, Rate, Timecode
from deitalk.cli.targets import curves_of, reserve_file, reserve_take
from deitalk.errors import DeitalkError
from rig.limits import MOST_DELAY, MOST_HANDLES


def diff(
    edited: Annotated[
        Path,
        typer.Argument(
            help="Edited curves: csv, json, unreal.json, a Live Link CSV, or what Blender or Maya "
            "give back."
        ),
    ],
    take: Annotated[
        Path, typer.Argument(help="The take folder that was edited, or that folder zipped.")
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Layer to write: fixes.edit.json.")
    ] = Path("fixes.edit.json"),
    fps: Annotated[
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
    delay: Annotated[
        int,
        typer.Option(
            min=-MOST_DELAY,
            max=MOST_DELAY,
            help="Frames of --delay that the edited file alone was written with.",
        ),
    ] = 0,
    handles: Annotated[
        int,
        typer.Option(
            min=0,
            max=MOST_HANDLES,
            help="The same of --handles; those of the take are known.",
        ),
    ] = 0,
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
    edited = curves_of(edited)
    inputs = (edited, take if take.is_file() else take / "curves.json")
    reserve_file(out, force=force, inputs=inputs)
    name = out.name.removesuffix(SUFFIX).removesuffix(".json")
    found = changes_of_take(
        edited, take, fps=fps, tolerance=tolerance, delay=delay, handles=handles, name=name
    )
    layer = found.layer
    with atomic_write(out) as beside:
        beside.write_text(layer.text, encoding="utf-8")
    controls = len({edit.target for edit in layer.edits})
    size = len(layer.text.encode())
    line = (
        f"{out}: {len(layer.edits)} edits of {controls} controls, {layer.n_keys} keys "
        f"({found.share:.2%} of the take's values), {size / 1000:.1f} kB"
    )
    summary = {
        "out": str(out), "edits": len(layer.edits), "controls": controls,
        "keys": layer.n_keys, "share_of_values": found.share, "bytes": size,
        "owned": [edit.target for edit in layer.edits if edit.owns],
        "notes": list(found.notes),
    }  # fmt: skip
    emit_outcome(line, summary, found.notes, as_json=as_json)


@acting_options
def dub(
    performance: Annotated[
        Path,
        typer.Argument(
            help="Take folder or .zip, captured or keyed curves: Live Link CSV, unreal.json, csv …"
        ),
    ],
    speech: Annotated[Path, typer.Argument(help="The new recording.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Take folder/.")],
    given: Given,
    sound: Annotated[
        Path | None,
        typer.Option(
            help="Recording of the performance; else that of the take, or of the same name."
        ),
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option(help="Map of another rig's curves, as for `data import`.")
    ] = None,
    stretch: Annotated[
        float, typer.Option(min=1, max=3, help="Most by which phrases are played slower or faster.")
    ] = 1.5,
    source_fps: Annotated[
        float | None, typer.Option(help="Rate of the performance, Hz, if its file has none.")
    ] = None,
    model: Model = "default",
    device: Device = "cpu",
    fps: Rate = None,
    timecode: Timecode = "zero",
    delay: Delay = 0,
    handles: Handles = 0,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Keep a performance and replace its mouth by that of another recording.

    Examples
    --------
    deitalk dub MySlate_1_iPhone.csv german.wav -o take/

    deitalk dub take.zip retake.wav -o take2/ --words "My promise is big."
    """
    from deitalk.audio.original import start_of
    from deitalk.batch.lines import TAKE, Written
    from deitalk.data.captures.columns import read_mapping
    from deitalk.data.dub import dub as dubbed
    from deitalk.models.folder import describe_model
    from deitalk.pipeline.performance import write_take

    inputs = (str(speech), str(performance), *given.texts)
    reserve_take(out, str(speech), force=force, inputs=inputs)
    Written((TAKE,), fps, None, timecode, delay, handles).checked()
    table = None if mapping is None else read_mapping(mapping)
    with bar("animating") as progress:
        found = dubbed(
            performance, speech, sound=sound, acting=given.acting, mapping=table, stretch=stretch,
            fps=source_fps, model=model, device=device, progress=progress, **given.choice.settings,
        )  # fmt: skip
    start, note = start_of(timecode, fps, found.performance.recording.start)
    write_take(
        out, found.performance, model=describe_model(model), force=force,
        extras=(found.write_report,), fps=fps, start=start, delay=delay, handles=handles,
    )  # fmt: skip
    notes = filter(None, (note, *found.performance.recording.warnings, *found.notes))
    summary = {
        "out": str(out), "frames": len(found.exact), "unchanged": int(found.exact.sum()),
        "amplitude": found.amplitude, "kept": list(found.kept), "notes": list(found.notes),
    }  # fmt: skip
    emit_outcome(f"{out}: {found.line}", summary, notes, as_json=as_json)
