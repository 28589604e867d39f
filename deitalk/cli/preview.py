"""`deitalk preview`: page or review video of a take."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.options import Force, Identity
from deitalk.cli.targets import curves_of, note_reading, reserve_file
from deitalk.errors import DeitalkError


def preview(
    source: Annotated[Path, typer.Argument(help="Take folder, or curves (.csv .json .npz …).")],
    audio: Annotated[
        Path | None, typer.Option(help="Recording; by default that of the take folder.")
    ] = None,
    phones: Annotated[
        Path | None,
        typer.Option(help="CSV start,end,phone for warnings of m, b, p that stay open."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help=".html, or .mp4 for a video; preview.html in the take."),
    ] = None,
    identity: Identity = "0",
    view: Annotated[
        str, typer.Option(help="Second view of the video: mouth, three_quarter, side, eyes.")
    ] = "mouth",
    versus: Annotated[
        list[Path] | None,
        typer.Option(help="Another take beside the first in the page; repeatable."),
    ] = None,
    force: Force = False,
) -> None:
    """Write an interactive page of a take, or a review video.

    Examples
    --------
    deitalk preview take/

    deitalk preview curves.csv --audio speech.wav -o review.mp4

    deitalk preview take/ --versus other/ -o compare.html
    """
    from deitalk.preview.needs import PAGES, check_needs
    from deitalk.preview.page import render_page
    from deitalk.preview.source import load_source
    from deitalk.preview.speech_warnings import find_warnings
    from deitalk.preview.video import render_video
    from rig.face.identity import identity_of

    others, head = versus or [], identity_of(identity)
    beside = source / "preview.html" if source.is_dir() else source.with_suffix(".html")
    target = out or beside
    is_page = target.suffix.lower() in PAGES
    if (others and not is_page) or (view != "mouth" and is_page):
        raise DeitalkError("--versus is of a page (.html), --view of a video (.mp4); leave it out")
    for path in (source, *others):
        curves_of(path)  # or an error for a recording
    shown = [load_source(path) for path in others]
    shown = [load_source(source, audio, phones), *shown]
    for each in shown:
        note_reading(each.curves)
    if shown[0].is_board:
        console().note(*check_needs([target]))
    reserve_file(target, force=force, inputs=(source, audio, phones, *others))
    for time, text in find_warnings(shown[0]):
        console().print(f"{time:6.2f} s  {text}")
    if is_page:
        render_page(shown, target, identity=head, force=force)
    else:
        with bar("drawing") as progress:
            render_video(
                shown[0], target, identity=head, second_view=view, force=force,
                progress=progress,
            )  # fmt: skip
    # Add a preview to the take's manifest, so that a new take removes it.
    from deitalk.pipeline.performance import KIND, PREVIEW_FILES
    from rig.files import kind_of, record

    is_own = target.parent == source and target.name in PREVIEW_FILES
    if is_own and kind_of(source) == KIND:
        record(source, [target.name], kind=KIND)
    console().print(str(target))
