"""`deitalk animate`: a take, curves, a mesh or a picture of speech."""

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deitalk.cli.acting_options import Given, acting_options
from deitalk.cli.console import bar, console, emit_outcome, sound_of
from deitalk.cli.mesh import animate_vertices
from deitalk.cli.options import (
    MESH,
    AnyModel,
    Backend,
    Delay,
    Device,
    Digits,
    Force,
    Handles,
    Json,
    Rate,
    Threads,
    Timecode,
    WrittenIdentity,
)
from deitalk.cli.targets import PICTURES, reserve_file, reserve_sound, reserve_take
from deitalk.errors import DeitalkError

if TYPE_CHECKING:
    from collections.abc import Callable

    from deitalk.models.protocol import CurveNetwork
    from deitalk.pipeline.performance import Extra, Performance


@acting_options
def animate(
    speech: Annotated[str, typer.Argument(help="Recording (wav flac ogg opus mp3 m4a …) or - .")],
    out: Annotated[
        str,
        typer.Option(
            "--out", "-o", help="Take folder/, or one file: .csv .json .npz …, or a plot, .png."
        ),
    ],
    given: Given,
    model: AnyModel = "default",
    fps: Rate = None,
    digits: Digits = None,
    backend: Backend = "auto",
    device: Device = "cpu",
    threads: Threads = 1,
    timecode: Timecode = "zero",
    delay: Delay = 0,
    handles: Handles = 0,
    preview: Annotated[
        bool, typer.Option("--preview", help="Add a page, preview.html, to the take.")
    ] = False,
    vertices: Annotated[
        bool,
        typer.Option(
            "--vertices",
            rich_help_panel=MESH,
            help="A moving mesh instead of curves: .glb, .npz, or a folder/ of .ply files.",
        ),
    ] = False,
    mesh: Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=MESH,
            help="The same of your own face, any topology: as `deitalk retarget --mesh`.",
        ),
    ] = None,
    landmarks: Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=MESH,
            help="JSON or CSV of points on that mesh (guessed if not given).",
        ),
    ] = None,
    identity: WrittenIdentity = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Animate a face from a recording.

    With --json: mean_intensity is predicted from the voice, mean_applied_intensity is that of the
    curves (0 if the emotion is neutral); suggestion has the probabilities of -e auto.

    Examples
    --------
    deitalk animate speech.wav --emotion happy -o take/

    deitalk animate speech.wav -e angry=0.6 --intensity 1.4 -o curves.csv

    deitalk animate speech.wav --words "My promise is big." -o take/

    deitalk animate speech.wav -e happy --vertices -o face.glb
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", str(threads))  # numpy's own would spin
    from deitalk.models.folder import describe_model, product_of

    form: dict[str, Any] = {
        "fps": fps, "digits": digits, "timecode": timecode, "delay": delay, "handles": handles
    }  # fmt: skip
    target, inputs = Path(out), (speech, *given.texts)
    if vertices or mesh is not None or landmarks is not None or product_of(model) == "mesh":
        _refuse("a mesh", form | {"fps": None, "preview": preview, "backend": backend})
        animate_vertices(
            speech, out, given, model=model, speaker=identity or "0", mesh=mesh,
            landmarks=landmarks, fps=fps, device=device, force=force, as_json=as_json,
        )  # fmt: skip
        return
    perform = partial(
        _perform, speech, given, model=model, backend=backend, device=device, threads=threads
    )
    if target.suffix.lower() in PICTURES:
        _refuse("a plot", form | {"preview": preview, "identity": identity})
        _draw(target, perform, force=force, inputs=inputs)
        return

    # Whatever cannot be written is refused before the recording is animated.
    from deitalk.audio.original import start_of
    from deitalk.batch.lines import TAKE, Written
    from deitalk.pipeline.performance import write_take
    from rig.files import is_folder_name
    from rig.formats import check_option, find_format
    from rig.formats.table import writable_suffixes

    head = None
    if identity is not None:
        from rig.face.identity import identity_of

        head = identity_of(identity)
    is_take = is_folder_name(out, (*writable_suffixes(), *PICTURES))
    file_format = None if is_take else find_format(target, writable=True)
    if identity is not None and file_format is not None:
        check_option("identity", repr(identity), file_format)
    elif identity is not None and not preview:
        raise DeitalkError(
            f"--identity {identity} is the head of --preview, or of a .glb or .usda file; the take "
            f"{out} shows none: add --preview, or leave it out"
        )
    Written((file_format.suffixes[0] if file_format else TAKE,), **form).checked()
    if preview and not is_take:
        raise DeitalkError(f"--preview goes with a take folder; {out} is one file")
    if is_take:
        reserve_take(target, speech, force=force, inputs=inputs)
    else:
        reserve_file(target, force=force, inputs=inputs)
        reserve_sound(target, force=force, inputs=inputs)
    extras: tuple[Extra, ...] = ()
    if preview:
        from deitalk.preview.page import add_preview, check_player

        check_player()
        extras = (partial(add_preview, identity=head or 0),)

    # The work.
    performance = perform()
    form["start"], note = start_of(form.pop("timecode"), fps, performance.recording.start)
    if is_take:
        about = describe_model(model)
        write_take(target, performance, model=about, force=force, extras=extras, **form)
        notes = []
    else:
        notes = _write_file(target, performance, form | {"identity": head})

    # What there is to say about it.
    words, seconds = performance.words, performance.recording.duration
    fit = words.line if words is not None and words.fits else ""
    frames = 2 * handles + len(performance.at(fps)[0])
    summary = {
        "out": str(target), "frames": frames, "seconds": seconds,
        "mean_intensity": performance.mean_intensity,
        "mean_applied_intensity": performance.mean_applied_intensity,
        "clipped_values": performance.clipped, "words": words and words.line,
        "suggestion": performance.suggestion, "settings": performance.acting.settings,
        "signal": performance.recording.choice.settings,
        "timings_seconds": performance.timings,
    }  # fmt: skip
    emit_outcome(
        f"{target}: {frames} frames, {seconds:.2f} s, {performance.summary}",
        summary,
        filter(None, (note, *notes, *performance.recording.warnings, fit)),
        as_json=as_json,
    )


def _refuse(what: str, options: dict[str, Any]) -> None:
    """Raise for options that are given and that only written curves have."""
    usual = {"timecode": "zero", "backend": "auto", "preview": False, "delay": 0, "handles": 0}
    for name, value in options.items():
        if value != usual.get(name):
            raise DeitalkError(f"--{name} does not apply to {what}; leave it out")


def _perform(
    speech: str, given: Given, *, model: str, backend: str, device: str, threads: int
) -> "Performance":
    """Animate a recording, with a bar; the network is loaded after the recording was read."""
    from deitalk.pipeline.curves import finish, prepare

    def load() -> "CurveNetwork":
        from deitalk.models.load import chosen_backend, load_network

        most = min(threads, os.cpu_count() or 1)
        chosen = chosen_backend(model, backend, device)
        if chosen == "torch":
            import torch

            torch.set_num_threads(most)
        return load_network(model, backend=chosen, device=device, threads=most, once=True)

    sound = sound_of(speech)
    with console().status("loading the recording and the network"):
        prepared = prepare(sound, given.acting, load, choice=given.choice)
    with bar("animating") as progress:
        return finish(prepared, prepared.read(progress))


def _draw(
    target: Path, perform: "Callable[[], Performance]", *, force: bool, inputs: tuple[str, ...]
) -> None:
    """Draw curves and intensity against the waveform."""
    from deitalk.evaluation.figures import check_drawing

    check_drawing()
    reserve_file(target, force=force, inputs=inputs)
    performance = perform()
    from deitalk.evaluation.curves_figure import draw_curves

    title = f"{Path(inputs[0]).name}, {performance.emotion}"
    draw_curves(performance.curves, performance.recording.waveform, target, title)
    console().print(str(target))


def _write_file(out: Path, performance: "Performance", form: dict[str, Any]) -> list[str]:
    """Write one file of curves, and the sound beside an FBX; return notes on what it lacks."""
    import numpy as np

    from deitalk.audio.load import write_wav
    from rig import write_curves
    from rig.curves.shift import start_with_handles

    source, seconds = performance.sound_file, performance.recording.duration
    curves, _ = performance.at(form["fps"])
    report = write_curves(out, curves, sound=source, seconds=seconds, **form)
    if out.suffix.lower() == ".fbx":
        pad = round(form["handles"] / report.fps * performance.recording.sample_rate)
        sound = np.pad(performance.recording.waveform, pad)
        start = start_with_handles(form["start"], form["handles"], report.fps)
        write_wav(out.with_suffix(".wav"), sound, start=start)
        console().print(f"{out.with_suffix('.wav')}: its sound, from the first frame on")
    return report.notes
