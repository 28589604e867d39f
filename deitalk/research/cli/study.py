"""`python -m deitalk.research study`: blind comparisons by people."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.options import MAX_COUNT, CheckedCommands, Force, Identity, Json
from deitalk.cli.targets import reserve_folder
from deitalk.errors import DataError
from deitalk.research.cli.options import Picture, Report
from deitalk.research.cli.reports import reserve_report, write_report

app = CheckedCommands(
    no_args_is_help=True, help="Let people compare takes of several systems, blind."
)


@app.command()
def build(
    systems: Annotated[
        list[Path],
        typer.Argument(help="A folder a system: takes, curves or .mp4 videos of the same names."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the study.")],
    task: Annotated[
        list[str] | None,
        typer.Option(help="realism, lips, emotion or intensity; repeatable; by default all."),
    ] = None,
    at_once: Annotated[
        int, typer.Option(min=2, max=3, help="Systems side by side: pairs, or triples.")
    ] = 2,
    most: Annotated[
        int | None, typer.Option(min=1, max=MAX_COUNT, help="Trials of one rater.")
    ] = None,
    raters: Annotated[int, typer.Option(min=1, max=2000, help="Sequences in the page.")] = 60,
    with_loudness: Annotated[
        bool,
        typer.Option("--with-loudness", help="Add a system whose jaw follows the level alone."),
    ] = False,
    identity: Identity = "0",
    post: Annotated[
        str | None, typer.Option(help="http(s) address to which the page sends answers.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1)] = 0,
    force: Force = False,
) -> None:
    """Write a page of blind comparisons: publish index.html and clips/, keep key.json.

    Examples
    --------
    python -m deitalk.research study build takes_a/ takes_b/ -o study/

    study build ours/ theirs/ --with-loudness --task lips --most 40 -o study/
    """
    if post is not None and not post.startswith(("https://", "http://")):
        raise DataError(f"--post {post!r} must begin with https:// or http://")
    reserve_folder(out, kind="study", force=force, inputs=systems)
    from deitalk.preview.needs import check_needs
    from deitalk.research.study.build import build_study
    from deitalk.research.study.design import TASKS

    for note in check_needs([Path("clip.mp4")]):
        console().note(note)
    with bar("drawing") as progress:
        key = build_study(
            systems, out, tasks=tuple(task or TASKS), size=at_once, most=most, raters=raters,
            with_loudness=with_loudness, identity=identity, post=post, seed=seed,
            force=force, progress=progress,
        )  # fmt: skip
    items = {clip["item"] for clip in key["clips"].values()}
    console().print(f"{out}: {', '.join(key['systems'])} on {len(items)} recordings")
    if not any(clip["system"] is None for clip in key["clips"].values()):
        console().note("videos give no still faces: raters get no practice and no checks")
    console().print("publish index.html and clips/; key.json tells which is which: keep it")


@app.command()
def report(
    answers: Annotated[Path, typer.Argument(help="Folder of the raters' .json files.")],
    key: Annotated[Path, typer.Option(help="key.json of the study.")],
    failed_checks: Annotated[
        int, typer.Option(min=0, max=3, help="Checks a rater may fail and still count.")
    ] = 0,
    out: Report = None,
    picture: Picture = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Evaluate the answers: preferences with intervals, strengths, agreement.

    Examples
    --------
    python -m deitalk.research study report answers/ --key study/key.json

    study report answers/ --key study/key.json -o report.md --picture report.png
    """
    reserve_report(out, picture, force=force)
    from deitalk.research.study.answers import read_answers, read_key
    from deitalk.research.study.report import as_markdown, report_study

    known = read_key(key)
    found = report_study(known, read_answers(answers, known, failed_checks=failed_checks))
    write_report(found, as_markdown(found), out, as_json=as_json)
    if picture is not None:
        from deitalk.research.study.figure import draw

        draw(found, picture)
