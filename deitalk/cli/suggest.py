"""`deitalk suggest`: an emotion that a voice suggests."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deitalk.cli.console import console, emit_json
from deitalk.cli.options import Force, Json
from deitalk.cli.paths import reserve_file
from deitalk.errors import DeitalkError

if TYPE_CHECKING:
    from deitalk.pipeline.suggest import Suggestion


def suggest(
    speech: Annotated[Path, typer.Argument(help="Recording.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Keyframed track to edit and give to `animate -e`: .csv."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Suggest an emotion from the voice: neutral, angry, happy or sad, with its probability.

    Examples
    --------
    deitalk suggest speech.wav

    deitalk suggest speech.wav -o emotion.csv
    """
    if out is not None:
        if out.suffix != ".csv":
            raise DeitalkError(f"{out}: a track of emotions is a .csv")
        reserve_file(out, force=force, inputs=[speech])
    with console().status("measuring the voice"):
        from deitalk.pipeline.suggest import suggest_emotion

        found = suggest_emotion(speech)
    if out is not None:
        _write(found, out)
    if as_json:
        emit_json({"label": found.label, "probabilities": dict(found.probabilities)})
        return
    shown = ", ".join(f"{name} {p:.2f}" for name, p in found.probabilities.items())
    console().print(f"{found.label} ({shown})")
    if out is not None:
        console().print(str(out))


def _write(found: "Suggestion", out: Path) -> None:
    """Write the track as `deitalk animate -e` reads it."""
    from deitalk.emotions import EMOTIONS
    from rig.files import atomic_write

    rows = [",".join(("time", *EMOTIONS))]
    for time, weights in zip(found.track.times, found.track.weights, strict=True):
        rows.append(",".join((f"{time:.3f}", *(f"{w:.4f}" for w in weights))))
    with atomic_write(out) as beside:
        beside.write_text("\n".join(rows) + "\n", encoding="utf-8")
