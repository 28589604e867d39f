"""`deitalk animate`: speech and an emotion in, a take out."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deitalk.cli.words import bar, words

if TYPE_CHECKING:
    from deitalk.pipeline import Performance
    from deitalk.take import Extra


def animate(
    speech: Annotated[str, typer.Argument(help="Recording (wav flac ogg opus mp3 m4a …) or - .")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Take folder, or one file: .csv .json .npz …"),
    ],
    emotion: Annotated[
        str,
        typer.Option(
            "--emotion",
            "-e",
            help="neutral, angry, happy, sad, surprised; weights such as happy=0.7,surprised=0.3; "
            "or a keyframed track (.csv .json .yaml).",
        ),
    ] = "neutral",
    intensity: Annotated[
        float, typer.Option(help="Factor on the intensity heard in the voice, 0 to 4.")
    ] = 1.0,
    intensity_curve: Annotated[
        Path | None, typer.Option(help="Edited intensity.csv of a take, used instead.")
    ] = None,
    model: Annotated[str, typer.Option(help="default, or a model folder.")] = "default",
    fps: Annotated[
        float | None, typer.Option(help="Rate of the written curves: 24 25 29.97 30 50 60.")
    ] = None,
    idle: Annotated[bool, typer.Option(help="Blinks and small motions of the gaze.")] = True,
    seed: Annotated[int, typer.Option(help="Of the blinks.")] = 0,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    threads: Annotated[
        int, typer.Option(min=1, help="CPU threads; more than one seldom helps so small a network.")
    ] = 1,
    preview: Annotated[
        bool, typer.Option("--preview", help="Add a page and a review video to the take.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace what is there.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print a summary for machines.")] = False,
) -> None:
    """Animate a face from a recording.

    Examples
    --------
    deitalk animate speech.wav --emotion happy -o take/

    deitalk animate speech.wav -e angry=0.6 --intensity 1.4 -o curves.csv
    """
    from deitalk.errors import DeitalkError
    from deitalk.take import check_target, write_take

    check_target(out, force=force)
    if preview and out.suffix:
        raise DeitalkError(f"--preview goes with a take folder; {out} is one file")
    with words().status("loading the network"):
        import torch

        from deitalk.checkpoint import describe_model, load_model
        from deitalk.pipeline import animate as perform

        torch.set_num_threads(threads)
        network = load_model(model, device=device)
    with bar("animating") as progress:
        performance = perform(
            sys.stdin.buffer.read() if speech == "-" else speech,
            emotion,
            model=network,
            intensity=intensity,
            intensity_curve=intensity_curve,
            idle=idle,
            seed=seed,
            progress=progress,
        )
    settings = {
        "emotion": emotion,
        "intensity": intensity,
        "intensity_curve": None if intensity_curve is None else intensity_curve.name,
        "idle": idle,
        "seed": seed,
    }
    if out.suffix:
        _write_file(out, performance, fps)
    else:
        write_take(
            out,
            performance,
            settings=settings,
            model=describe_model(model),
            fps=fps,
            force=force,
            extras=_extras(preview),
        )
    for warning in performance.recording.warnings:
        words().print(f"note: {warning}")
    if as_json:
        typer.echo(json.dumps(_summary(out, performance, settings)))
    else:
        words().print(
            f"{out}: {len(performance.curves)} frames, {performance.recording.duration:.2f} s, "
            f"emotion {emotion}, intensity {performance.predicted.mean():.2f} on average"
        )


def _extras(preview: bool) -> "tuple[Extra, ...]":
    if not preview:
        return ()
    from deitalk.preview.take import add_preview

    return (add_preview,)


def _write_file(out: Path, performance: "Performance", fps: float | None) -> None:
    from rig import write_curves

    report = write_curves(out, performance.curves, fps=fps)
    if report.note:
        words().print(f"note: {report.note}")
    for track in report.dropped:
        words().print(f"note: {out.name} cannot hold the {track} track; a take folder does")


def _summary(out: Path, performance: "Performance", settings: dict[str, Any]) -> dict[str, Any]:
    return {
        "out": str(out),
        "frames": len(performance.curves),
        "seconds": performance.recording.duration,
        "mean_intensity": float(performance.predicted.mean()) if len(performance.curves) else 0.0,
        "clipped_values": performance.clipped,
        "settings": settings,
        "timings_seconds": performance.timings,
    }
