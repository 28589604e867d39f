"""`deitalk convert`: curves from any format to any other."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deitalk.cli.console import emit, emit_outcome
from deitalk.cli.options import (
    Delay,
    Digits,
    Force,
    Handles,
    Json,
    WrittenIdentity,
    control_set_of,
)
from deitalk.cli.targets import curves_of, reserve_file, reserve_sound, write_sound
from deitalk.errors import DeitalkError

if TYPE_CHECKING:
    from rig.formats.table import Format


def convert(
    source: Annotated[
        Path | None, typer.Argument(help="Take folder, or a file of curves of any format.")
    ] = None,
    target: Annotated[
        Path | None, typer.Argument(help="File to write; its suffix gives the format.")
    ] = None,
    to: Annotated[str | None, typer.Option("--format", "--to", help="Format to write.")] = None,
    from_: Annotated[str | None, typer.Option("--from", help="Format to read.")] = None,
    fps: Annotated[
        float | None, typer.Option(help="Rate to write, Hz: 24 25 29.97 30 50 60 …")
    ] = None,
    source_fps: Annotated[
        float | None, typer.Option(help="Rate of the source, Hz, if the file does not contain it.")
    ] = None,
    digits: Digits = None,
    delay: Delay = 0,
    handles: Handles = 0,
    start: Annotated[float, typer.Option(min=0, help="First second to take.")] = 0.0,
    end: Annotated[float | None, typer.Option(min=0, help="Second to stop before.")] = None,
    gain: Annotated[
        list[str] | None,
        typer.Option(help="NAME=FACTOR of a control or region, around rest: brow=0.5. Repeatable."),
    ] = None,
    offset: Annotated[
        list[str] | None, typer.Option(help="NAME=VALUE added to a control or region. Repeatable.")
    ] = None,
    smooth: Annotated[
        float, typer.Option(help="Smoothing, seconds (0.02 to 0.05 removes jitter).")
    ] = 0.0,
    mirror: Annotated[bool, typer.Option("--mirror", help="Swap left and right.")] = False,
    rig: Annotated[
        str,
        typer.Option(
            help="Controls of csv, json, npz: board, raw, arkit, as-is, or an avatar (oculus "
            "vrchat vrm0 vrm1 vroid mmd cc4 daz8 daz9); of glb: arkit."
        ),
    ] = "board",
    identity: WrittenIdentity = None,
    list_formats: Annotated[
        bool, typer.Option("--list-formats", help="Print the formats and exit.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Convert curves between formats, rates and rigs.

    Examples
    --------
    deitalk convert take/ speech.unreal.json

    deitalk convert take/curves.json speech_take_1_anna.csv --to livelink --fps 60

    deitalk convert MySlate_1_iPhone.csv curves.csv --gain brow=1.5 --smooth 0.03

    deitalk convert MySlate_1_iPhone.csv shapes.csv --rig arkit

    deitalk convert take/ face.glb --rig arkit --identity child
    """
    from rig import gain as scale
    from rig import read_curves, write_curves
    from rig import smooth as smoothed
    from rig.controls import DEFAULT_ID
    from rig.conversion.convert import convert as to_set
    from rig.conversion.convert import convert_and_note
    from rig.curves.edit import parse_gains
    from rig.face.identity import identity_of
    from rig.formats.table import FORMATS, find_format

    if list_formats:
        for known in FORMATS:
            ways = f"{'read' if known.read else ''} {'write' if known.write else ''}".strip()
            emit(f"{known.name:14} {known.suffixes[0]:18} {ways:10}  {known.description}")
        return
    if source is None or target is None:
        raise typer.BadParameter("give a source and a target (or --list-formats)")
    reserve_file(target, force=force, inputs=(source, curves_of(source)))
    audio = source / "audio.wav"
    sound = reserve_sound(target, force=force, inputs=(audio,)) if audio.is_file() else None
    chosen, head = find_format(target, to, writable=True), identity and identity_of(identity)
    wanted = _control_set(rig, chosen)
    curves = read_curves(curves_of(source), format=from_, fps=source_fps, control_set=None)
    if start or end is not None:
        whole, curves = curves.duration, curves.slice_seconds(start, end)
        if not len(curves):
            stop = "s on" if end is None else f"to {end:g} s"
            raise DeitalkError(
                f"no frame lies from {start:g} {stop}; the curves last {whole:.2f} s"
            )
    if gain or offset or mirror or smooth:
        gains = parse_gains(",".join(gain or []) or None)
        offsets = parse_gains(",".join(offset or []) or None, "offset")
        curves = scale(to_set(curves, DEFAULT_ID), gains, offsets)
        curves = smoothed(curves.mirror() if mirror else curves, smooth)
    curves, note = convert_and_note(curves, wanted or curves.control_set)
    # The take's recording for a format that has sound, and its length if it is whole.
    speech: dict[str, Any] = {}
    if "seconds" in chosen.options and audio.is_file():
        speech["sound"] = audio
        if not start and end is None:
            from deitalk.audio.decoding import open_sound

            with open_sound(str(audio), None) as opened:
                speech["seconds"] = opened.expected / opened.rate
    report = write_curves(
        target, curves, format=to, fps=fps, digits=digits, identity=head, delay=delay,
        handles=handles, **speech,
    )  # fmt: skip
    report = replace(report, note="; ".join(filter(None, (note, report.note))))
    line = f"{report.path}: {report.format}, {report.n_frames} frames at {report.fps:g} fps"
    summary = {
        "out": str(report.path), "format": report.format, "frames": report.n_frames,
        "fps": report.fps, "notes": report.notes,
    }  # fmt: skip
    emit_outcome(line, summary, report.notes, as_json=as_json)
    if sound is not None:
        write_sound(sound, audio, start, end, handles / report.fps)


def _control_set(rig: str, chosen: "Format") -> str | None:
    """Controls to convert to before writing; None where the format determines them."""
    wanted = None if rig == "as-is" else control_set_of(rig)
    if chosen.control_set is None or wanted in chosen.also:
        return wanted
    if rig not in ("board", "as-is") and chosen.control_set != wanted:
        raise DeitalkError(
            f"--rig {rig} does not apply to {chosen.name}, whose curves are "
            f"{chosen.control_set}; leave it out, or write csv, json, npz, or for arkit glb"
        )
    return None
