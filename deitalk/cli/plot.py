"""`deitalk plot`: curves against the waveform."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.options import Emotion, Force, Intensity, Model, Picture
from deitalk.cli.paths import reserve_picture


def plot(
    speech: Annotated[Path, typer.Argument(help="Recording.")],
    out: Picture,
    emotion: Emotion = "neutral",
    intensity: Intensity = 1.0,
    model: Model = "default",
    force: Force = False,
) -> None:
    """Draw key curves and the intensity against the waveform.

    Examples
    --------
    deitalk plot speech.wav --emotion happy -o curves.png
    """
    from deitalk.figures.canvas import check_drawing

    check_drawing()
    reserve_picture(out, force=force, inputs=(speech, emotion))
    with bar("animating") as progress:
        from deitalk.figures.performance import plot as draw
        from deitalk.pipeline.curves import animate

        performance = animate(speech, emotion, model=model, intensity=intensity, progress=progress)
    draw(performance.curves, performance.recording.waveform, out, f"{speech.name}, {emotion}")
    console().print(f"{out}")
