"""Each kind of order as one call of a door of `deitalk` or `rig`; runs in a worker process.

The working folder is the order's: all paths are relative and fixed (`api.compute.order`).
"""

import json
import shutil
import zipfile
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from api.compute.models import model_of, placed
from api.compute.order import (
    ACTING,
    LISTEN_TO,
    OUT,
    RECORDING,
    SOUND,
    Answer,
    Limits,
    Order,
    TooLarge,
)
from api.compute.voices import perform_voices
from deitalk.acting import Acting
from deitalk.acting_fields import AUTO
from deitalk.audio.choice import AudioChoice
from deitalk.audio.decoding import open_sound
from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import Recording, read_sound
from deitalk.audio.original import ZERO, start_of, start_seconds
from deitalk.errors import CheckpointError
from deitalk.models.folder import describe_model
from deitalk.models.load import load_network
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import Extra, Performance, write_take
from rig.controls import DEFAULT_ID
from rig.conversion.convert import convert
from rig.curves import RigCurves
from rig.curves.edit import clamp, gain
from rig.curves.layers import SUFFIX
from rig.curves.shift import shift
from rig.formats import read_curves, write_curves
from rig.limits import STREAM_BYTES
from rig.retarget.retarget_files import retarget_curves
from rig.validation.files import validate

Progress = Callable[[float], None]
VIDEO_PIXELS = 960 * 720
"""Pixels of a frame of the review video."""
NAME = "recording"
NETWORK_SHARE = 0.1
"""Share of the network in the progress of a video; the rest is its pictures."""


class TooLong(Exception):
    """A recording too long to be answered at once; its argument is the length in seconds."""


def perform(order: Order, limits: Limits, progress: Progress) -> Answer:
    """Carry out one order in the working folder."""
    shutil.rmtree(OUT, ignore_errors=True)  # of a process that ended in the order
    Path(OUT).mkdir()
    try:
        return TASKS[order["kind"]](order, limits, progress)
    except TooLong as error:
        return {"long": error.args[0]}


def _animation(order: Order, limits: Limits, progress: Progress) -> Answer:
    of_network, of_pictures = _parts(order, progress)
    return _answered(order, limits, _performed(order, limits, of_network), of_pictures)


def _dub(order: Order, limits: Limits, progress: Progress) -> Answer:
    """A performance with another recording's mouth."""
    from deitalk.data.captures.columns import read_mapping
    from deitalk.data.dub import dub

    options = order["options"]
    of_network, of_pictures = _parts(order, progress)
    recording, mapping = _recording(order, limits), options.get("mapping")
    found = dub(
        options["performance"],
        recording,
        sound=_sound(SOUND, order, limits) if SOUND in options else None,
        acting=_acting(order, limits),
        mapping=None if mapping is None else read_mapping(Path(mapping)),
        stretch=options["stretch"],
        fps=options.get("curves_fps"),
        model=placed(model_of(options.get("model", "default"), limits), limits),
        progress=of_network,
    )
    extras, notes = (found.write_report,), (*found.notes, found.line)
    return _answered(order, limits, found.performance, of_pictures, notes, extras)


def _parts(order: Order, progress: Progress) -> tuple[Progress, Progress]:
    """Progress of the network's work, and of what comes after it: the pictures of a video."""
    share = NETWORK_SHARE if order["options"]["format"] == "mp4" else 1.0
    return (
        lambda done: progress(share * done),
        lambda done: progress(share + (1 - share) * done),
    )


def _out(options: dict[str, Any]) -> Path:
    """The file that an order wants."""
    return Path(OUT) / f"{options.get('name') or NAME}{options['suffix']}"


def _answered(
    order: Order,
    limits: Limits,
    performance: Performance,
    progress: Progress,
    notes: tuple[str, ...] = (),
    extras: tuple[Extra, ...] = (),
) -> Answer:
    """A performance as the file that an order wants."""
    options = order["options"]
    out = _out(options)
    said = [*performance.recording.warnings, *notes]
    if performance.words is not None and performance.words.fits:
        said.append(performance.words.line)
    if options["format"] in ("mp4", "page", "packed"):
        _preview(out, performance, order, limits, progress)
    else:
        name, fps = options["format"], options.get("fps")
        start, note = start_of(options.get("timecode", ZERO), fps, performance.recording.start)
        form: dict[str, Any] = {"fps": fps, "start": start} | _shift(options)
        said.append(note)
        if name == "take":
            model = options.get("model", "default")
            about = describe_model(limits["models"][model]) | {"name": model}
            folder = out.with_suffix("")
            _zip(write_take(folder, performance, model=about, extras=extras, **form), out)
        else:
            seconds = performance.recording.duration
            curves, _ = performance.at(fps)
            report = write_curves(out, curves, format=name, seconds=seconds, **form)
            said.append(report.note)
    facts = {
        "frames": len(performance.curves),
        "seconds": performance.recording.duration,
        "mean_intensity": performance.mean_intensity,
        "mean_applied_intensity": performance.mean_applied_intensity,
        "clipped_values": performance.clipped,
    }
    return {"file": str(out), "notes": [*filter(None, said)], "facts": facts}


def _performed(order: Order, limits: Limits, progress: Progress) -> Performance:
    network = load_network(model_of(order["options"].get("model", "default"), limits))
    return animate(
        _recording(order, limits),
        acting=_acting(order, limits),
        model=placed(network, limits),
        progress=progress,
    )


def _acting(order: Order, limits: Limits) -> Acting:
    """The order's acting; only files that the request sent are read."""
    fields = json.loads(Path(ACTING).read_text(encoding="utf-8"))
    files = {name: Path(name) for name in order["options"].get("sent", ())}
    if LISTEN_TO in files:
        fields[LISTEN_TO] = _sound(LISTEN_TO, order, limits)
    acting = Acting.of(files=files, **fields)
    if limits["backend"] == "onnx" and (acting.words or acting.script or acting.emotion == AUTO):
        raise CheckpointError(
            "words and emotion auto need torch; this service has the backend onnx"
        )
    return acting


def _recording(order: Order, limits: Limits) -> Recording:
    """The order's recording, of at most its longest length."""
    options = order["options"]
    choice = AudioChoice.of(options.get("track"), options.get("channel"), options.get("raw"))
    name, now = options.get("name") or NAME, order["at_once_seconds"]
    return _sound(RECORDING, order, limits, choice, name, now)


def _sound(
    file: str,
    order: Order,
    limits: Limits,
    choice: AudioChoice = AudioChoice(),
    name: str = "",
    now: float = inf,
) -> Recording:
    """A recording in the working folder, checked before all of it is read.

    Parameters
    ----------
    file : str
        Its fixed name.
    order, limits
        The longest length and the most channels that are read.
    choice : AudioChoice
        Which signal of it.
    name : str
        For messages; by default that of the file.
    now : float
        Longest length, seconds, that is answered at once.

    Raises
    ------
    TooLarge, TooLong, AudioError
    """
    most = order["most_seconds"]
    data, name = Path(file).read_bytes()[: STREAM_BYTES + 1], name or file
    with open_sound(name, data, choice) as sound:
        if sound.channels > limits["max_channels"]:
            raise TooLarge(
                f"the recording has {sound.channels} channels; at most {limits['max_channels']} "
                "are read"
            )
        stated = sound.expected / max(sound.rate, 1)
        if stated > most:
            raise TooLarge(f"the recording lasts {stated:.0f} s; at most {most:.0f} s are read")
        if stated > now:
            raise TooLong(stated)
        recording = read_sound(name, sound, most, start_seconds(data), choice)
    if recording.duration > now:
        raise TooLong(recording.duration)
    return recording


def _shift(options: dict[str, Any]) -> dict[str, Any]:
    return {name: options.get(name, 0) for name in ("delay", "handles")}


def _preview(
    out: Path, performance: Performance, order: Order, limits: Limits, progress: Progress
) -> None:
    """Write a video, a page, or what a page shows."""
    from deitalk.preview.page import pack_source, render_page
    from deitalk.preview.source import PreviewSource
    from deitalk.preview.video import render_video

    fps, title = order["options"].get("fps"), order["options"].get("name") or NAME
    moved = _shift(order["options"])
    curves, neutral = (shift(own, **moved) for own in performance.at(fps))
    if out.suffix == ".mp4" and len(curves) * VIDEO_PIXELS > limits["max_pixels"]:
        most = int(limits["max_pixels"] // VIDEO_PIXELS)
        raise TooLarge(f"the video has {len(curves)} frames; at most {most} are drawn")
    waveform = performance.recording.waveform
    waveform = np.pad(waveform, round(moved["handles"] / curves.fps * SAMPLE_RATE))
    source = PreviewSource(title, curves, waveform, SAMPLE_RATE, neutral.values)
    if out.suffix == ".mp4":
        render_video(source, out, progress=progress)
    elif out.suffix == ".html":
        render_page(source, out)
    else:
        out.write_bytes(pack_source(source))


def _zip(folder: Path, out: Path) -> None:
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for path in sorted(p for p in folder.iterdir() if not p.name.startswith(".")):
            archive.write(path, path.name)


def _mesh(order: Order, limits: Limits, progress: Progress) -> Answer:
    options = order["options"]
    if limits["backend"] == "onnx":
        raise CheckpointError("meshes need torch; this service has the backend onnx")
    from deitalk.pipeline.mesh import animate_mesh

    network = placed(model_of(options.get("model", "default"), limits), limits)
    performance = animate_mesh(
        _recording(order, limits),
        acting=_acting(order, limits),
        model=network,
        speaker=options.get("speaker", 0),
        fps=options.get("fps"),
        progress=progress,
    )
    out = _out(options)
    if options["format"] == "ply":
        _zip(performance.save(f"{OUT}/frames/"), out)
    else:
        performance.save(out)
    frames, vertices, _ = performance.vertices.shape
    facts = {"frames": frames, "vertices": vertices, "fps": performance.fps}
    return {"file": str(out), "notes": list(performance.recording.warnings), "facts": facts}


def _retarget(order: Order, limits: Limits, progress: Progress) -> Answer:
    options = order["options"]
    notes: list[str] = []
    fps = options.get("fps")
    if "curves" in options:
        curves: RigCurves = read_curves(options["curves"], fps=options.get("curves_fps"))
        curves = curves if fps is None else curves.resample(fps)
    else:
        performance = _performed(order, limits, progress)
        (curves, _), notes = performance.at(fps), list(performance.recording.warnings)
    out = _out(options)
    is_ply = options["format"] == "ply"
    report = retarget_curves(
        curves,
        Path(options["mesh"]),
        f"{OUT}/frames/" if is_ply else out,
        landmarks=options.get("landmarks"),
        mapping=options.get("mapping"),
        method=options.get("method", "displacements"),
        as_neutral=options.get("as_neutral", False),
    )
    if is_ply:
        _zip(Path(OUT) / "frames", out)
    facts = {
        "frames": report.frames, "shapes": report.shapes, "way": report.way, "lost": report.lost
    }  # fmt: skip
    return {"file": str(out), "notes": [*notes, *report.notes], "facts": facts}


def _conversion(order: Order, limits: Limits, progress: Progress) -> Answer:
    options = order["options"]
    curves = read_curves(options["curves"], fps=options.get("curves_fps"), control_set=None)
    curves = convert(curves, DEFAULT_ID)
    if "gain" in options:
        curves, _ = clamp(gain(curves, options["gain"]))
    out = _out(options)
    form = {"format": options["format"], "fps": options.get("fps")} | _shift(options)
    report = write_curves(out, curves, **form)
    return {"file": str(out), "notes": report.notes}


def _diff(order: Order, limits: Limits, progress: Progress) -> Answer:
    from deitalk.data.edited import changes_of_take

    options = order["options"]
    found = changes_of_take(
        options["edited"],
        options["take"],
        fps=options.get("fps"),
        tolerance=options["tolerance"],
        name=options["name"],
        **_shift(options),
    )
    out = Path(OUT) / f"{options['name']}{SUFFIX}"
    out.write_text(found.layer.text, encoding="utf-8")
    return {"file": str(out), "notes": list(found.notes)}


def _validation(order: Order, limits: Limits, progress: Progress) -> Answer:
    validation = validate(Path(order["options"]["curves"]))
    findings = [{"level": f.level, "text": f.text} for f in validation.findings]
    return {"facts": {"ok": validation.ok, "findings": findings}}


def _studio(order: Order, limits: Limits, progress: Progress) -> Answer:
    """The page of the studio with a head."""
    from deitalk.preview.page import render_studio

    out = Path(OUT) / "studio.html"
    out.write_text(render_studio(order["options"]["head"]), encoding="utf-8")
    return {"file": str(out)}


TASKS: dict[str, Callable[[Order, Limits, Progress], Answer]] = {
    "animation": _animation,
    "dub": _dub,
    "diff": _diff,
    "mesh": _mesh,
    "retarget": _retarget,
    "conversion": _conversion,
    "validation": _validation,
    "voices": perform_voices,
    "studio": _studio,
}
