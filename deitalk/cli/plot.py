"""`deitalk plot`: curves against the waveform."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.words import bar, words
from deitalk.errors import DataError


def plot(
    speech: Annotated[Path, typer.Argument(help="Recording.")],
    out: Annotated[Path, typer.Option("--out", "-o", help=".png, .svg or .pdf.")],
    emotion: Annotated[str, typer.Option("--emotion", "-e", help="As for animate.")] = "neutral",
    intensity: Annotated[float, typer.Option(help="Factor on the intensity heard.")] = 1.0,
    model: Annotated[str, typer.Option(help="default, or a model folder.")] = "default",
    force: Annotated[bool, typer.Option("--force", help="Replace the picture.")] = False,
) -> None:
    """Draw key curves and the intensity against the waveform.

    Examples
    --------
    deitalk plot speech.wav --emotion happy -o curves.png
    """
    if out.suffix not in (".png", ".svg", ".pdf"):
        raise DataError(f"{out}: a picture is .png, .svg or .pdf")
    if out.exists() and not force:
        raise DataError(f"{out} exists; add --force to replace it, or name another file")
    with bar("animating") as progress:
        from deitalk.pipeline import animate
        from deitalk.plot import plot as draw

        performance = animate(speech, emotion, model=model, intensity=intensity, progress=progress)
    draw(performance, out, f"{speech.name}, {emotion}")
    words().print(f"{out}")
