"""`deitalk plot`: curves against the waveform."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.acting import Given, acting_options
from deitalk.cli.console import bar, console
from deitalk.cli.options import Force, Model, Picture
from deitalk.cli.paths import reserve_picture


@acting_options
def plot(
    speech: Annotated[Path, typer.Argument(help="Recording.")],
    out: Picture,
    given: Given,
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
    reserve_picture(out, force=force, inputs=(speech, *given.texts))
    with bar("animating") as progress:
        from deitalk.figures.performance import plot as draw
        from deitalk.pipeline.curves import animate

        performance = animate(speech, acting=given.acting, model=model, progress=progress)
    title = f"{speech.name}, {performance.emotion}"
    draw(performance.curves, performance.recording.waveform, out, title)
    console().print(f"{out}")
