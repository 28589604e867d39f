"""`deitalk preview`: watch a take."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.words import bar, words
from deitalk.errors import DeitalkError


def preview(
    source: Annotated[Path, typer.Argument(help="Take folder, or curves (.csv .json .npz …).")],
    audio: Annotated[
        Path | None, typer.Option(help="Recording; a take folder brings its own.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help=".mp4 or .html; both beside the source without it."),
    ] = None,
    identity: Annotated[str, typer.Option(help="Number or name; `deitalk face identities`.")] = "0",
    view: Annotated[
        str, typer.Option(help="Second view of the video: mouth, three_quarter, side, eyes.")
    ] = "mouth",
    backend: Annotated[str, typer.Option(help="auto, opengl or software.")] = "auto",
    force: Annotated[bool, typer.Option("--force", help="Replace what is there.")] = False,
) -> None:
    """Render a review video of a take, or a page to play with it.

    Examples
    --------
    deitalk preview take/

    deitalk preview curves.csv --audio speech.wav -o review.mp4
    """
    from deitalk.preview.source import load_source
    from deitalk.preview.video import render_video

    target = out or (source / "preview.mp4" if source.is_dir() else source.with_suffix(".mp4"))
    if target.suffix.lower() != ".mp4":
        raise DeitalkError(f"{target} has suffix {target.suffix!r}; a preview is a .mp4 file")
    shown = load_source(source, audio)
    with bar("drawing") as progress:
        render_video(
            shown, target, identity=int(identity) if identity.isdigit() else identity,
            second_view=view, backend=backend, force=force,  # type: ignore[arg-type]
            progress=progress,
        )  # fmt: skip
    words().print(str(target))
