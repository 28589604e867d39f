"""`deitalk batch`: all lines of a manifest or a folder."""

from typing import Annotated

import typer

from deitalk.cli.acting_options import Given, acting_options
from deitalk.cli.console import bar, emit_outcome
from deitalk.cli.options import (
    MAX_PROCESSES,
    AnyModel,
    Backend,
    Delay,
    Device,
    Digits,
    Handles,
    Json,
    Rate,
    Timecode,
)


@acting_options
def batch(
    source: Annotated[str, typer.Argument(help="Folder of recordings, or a manifest; or a URL.")],
    out: Annotated[str, typer.Option("--out", "-o", help="Folder of the results, or a URL.")],
    given: Given,
    actor: Annotated[
        str, typer.Option(help="Who speaks; intensity counts from the actor's usual voice.")
    ] = "",
    formats: Annotated[
        str, typer.Option("--format", help="csv, json, npz, livelink, take … or several: csv;take")
    ] = "csv",
    model: AnyModel = "default",
    backend: Backend = "auto",
    fps: Rate = None,
    digits: Digits = None,
    timecode: Timecode = "zero",
    delay: Delay = 0,
    handles: Handles = 0,
    device: Device = "cpu",
    workers: Annotated[
        int | None,
        typer.Option(min=1, max=MAX_PROCESSES, help="Processes; one for each processor."),
    ] = None,
    ray: Annotated[
        str | None, typer.Option(help="Address of a Ray cluster, such as host:6379 or auto.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Go on in a folder begun from another source.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Animate many recordings; the same command again goes on where it was.

    The options hold for lines whose manifest does not say otherwise. Its columns: audio, output,
    formats, actor, fps, digits, timecode, delay, handles, track, channel, raw, and the options of
    the acting (docs/batch.md).

    Examples
    --------
    deitalk batch lines/ -e happy -o curves/

    deitalk batch lines.csv --format take -o takes/
    """
    from deitalk.batch.run import animate_batch
    from deitalk.batch.source import FAILED, SUMMARY
    from deitalk.errors import DeitalkError

    with bar("animating") as progress:
        report = animate_batch(
            source, out, acting=given.acting, actor=actor, formats=formats, fps=fps, digits=digits,
            timecode=timecode, delay=delay, handles=handles, model=model, device=device,
            backend=backend,  # type: ignore[arg-type]
            workers=workers, ray=ray, force=force, progress=progress, **given.choice.settings,
        )  # fmt: skip
    counts, n_lines = report.counts, len(report.rows)
    told = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    rate = report.seconds / report.wall_seconds
    line = (
        f"{out}: {told} of {n_lines} lines in {report.wall_seconds:.0f} s "
        f"({rate:.0f} x real time); {SUMMARY} has a row for each"
    )
    summary = {
        "out": report.out, "lines": n_lines, **counts,
        "with_warnings": sum(bool(row.warnings) for row in report.rows),
        "seconds": report.seconds, "wall_seconds": report.wall_seconds,
    }  # fmt: skip
    emit_outcome(line, summary, report.notes, as_json=as_json)
    if report.failed:
        first = report.failed[0]
        raise DeitalkError(
            f"{len(report.failed)} of {n_lines} lines failed, see {FAILED} there; "
            f"the first is {first.audio}: {first.error}"
        )
