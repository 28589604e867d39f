"""`deitalk preview`, and `deitalk face`: the embedded head in pictures, its rig's controls."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import (
    bar,
    console,
    curves_of,
    emit,
    emit_json,
    note_reading,
    reserve_file,
)
from deitalk.cli.options import CheckedCommands, Force, Identity
from deitalk.errors import DeitalkError

app = CheckedCommands(
    help="The embedded head: sheets, identities, export; its controls.",
    no_args_is_help=True,
)


@app.command()
def identities() -> None:
    """List the identities of the embedded head."""
    from rig.face import IDENTITIES
    from rig.face.identity import ROLES

    roles = {name: role for role, name in ROLES.items()}
    for number, person in enumerate(IDENTITIES):
        emit("\t".join([str(number), person.name, *filter(None, [roles.get(person.name)])]))


@app.command()
def export(
    out: Annotated[Path, typer.Option("--out", "-o", help="GLB file to write.")] = Path("head.glb"),
    identity: Identity = "0",
    force: Force = False,
) -> None:
    """Write the head with ARKit's 52 shapes and correctives, as sparse morph targets.

    Examples
    --------
    deitalk face export -o head.glb

    deitalk face export --identity Bruno -o bruno.glb
    """
    from rig.face import build_head
    from rig.retarget.morph_head import CORRECTIVES, write_head

    if out.suffix.lower() != ".glb":
        raise DeitalkError(f"{out} has suffix {out.suffix or 'none'!r}; a head is a .glb file")
    reserve_file(out, force=force)
    head = build_head(identity)
    names = write_head(out, head).names
    console().print(
        f"{out}: {head.identity.name}, {len(names) - len(CORRECTIVES)} shapes "
        f"and {len(CORRECTIVES)} correctives"
    )


@app.command()
def controls(
    match: Annotated[str, typer.Argument(help="Part of a name; all without it.")] = "",
    subset: Annotated[
        str | None, typer.Option("--set", help="A set or region: lip, upper_face, jaw, left …")
    ] = None,
    sets: Annotated[bool, typer.Option("--sets", help="List the sets and their sizes.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the controls of the rig.

    Examples
    --------
    deitalk face controls jaw

    deitalk face controls --set lip --json
    """
    from rig import default_controls

    everything = default_controls()
    if sets:
        rows = [
            {"set": name, "controls": len(everything.subset(name))}
            for name in everything.subset_names
        ]
    else:
        chosen = range(len(everything.names)) if subset is None else everything.subset(subset)
        table = everything.controls
        rows = [
            {
                "index": int(i),
                "control": table[i].name,
                "minimum": table[i].minimum,
                "maximum": table[i].maximum,
                "rest": table[i].rest,
                "region": table[i].region,
            }
            for i in chosen
            if match.lower() in table[i].name.lower()
        ]
    if not rows:
        raise DeitalkError(f"no control matches {match!r}; `deitalk face controls` lists all")
    if as_json:
        emit_json(rows)
        return
    for row in rows:
        emit("\t".join(str(value) for value in row.values()))
    console().print(f"{everything.id}: {len(rows)} " + ("sets" if sets else "controls"))


# `deitalk preview`: page or review video of a take.


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
    from deitalk.preview.page import render_page
    from deitalk.preview.source import find_warnings, load_source
    from deitalk.preview.video import PAGES, check_needs, render_video

    others = versus or []
    target = out or _beside(source)
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
        for note in check_needs([target]):
            console().note(note)
    reserve_file(target, force=force, inputs=(source, audio, phones, *others))
    for time, text in find_warnings(shown[0]):
        console().print(f"{time:6.2f} s  {text}")
    if is_page:
        render_page(shown, target, identity=identity, force=force)
    else:
        with bar("drawing") as progress:
            render_video(
                shown[0], target, identity=identity, second_view=view, force=force,
                progress=progress,
            )  # fmt: skip
    # Add a preview to the take's manifest, so that a new take removes it.
    from deitalk.pipeline.performance import KIND, PREVIEW_FILES
    from rig.files import kind_of, record

    is_own = target.parent == source and target.name in PREVIEW_FILES
    if is_own and kind_of(source) == KIND:
        record(source, [target.name], kind=KIND)
    console().print(str(target))


def _beside(source: Path) -> Path:
    """Default page: in a take folder, or beside a file of curves."""
    return source / "preview.html" if source.is_dir() else source.with_name(source.stem + ".html")
