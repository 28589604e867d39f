"""`tuned`: what a tuning left of its base."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.options import Force, Json
from deitalk.errors import DataError
from deitalk.research.cli.options import Most, Report
from deitalk.research.cli.reports import reserve_report, write_report


def tuned(
    model: Annotated[str, typer.Argument(help="Tuned model, such as runs/anna/best.")],
    base: Annotated[str, typer.Option("--from", help="Model that it was tuned from.")] = "default",
    speech: Annotated[
        Path | None, typer.Option(help="Folder of calm speech: change by emotions, jaw range.")
    ] = None,
    most: Most = None,
    data: Annotated[
        Path | None, typer.Option(help="Dataset folder of other captures: errors by emotion.")
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option("--map", help="Of finetune: carries the base's emotions.")
    ] = None,
    contacts: Annotated[Path | None, typer.Option(help="Table of phones: contacts.")] = None,
    acted: Annotated[
        Path | None, typer.Option(help="Table of actors at two strengths: their order.")
    ] = None,
    out: Report = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Score a tuned model beside its base: emotions, contacts, acted strengths.

    Examples
    --------
    python -m deitalk.research tuned runs/anna/best --speech readers/ --most 12 -o tuned.md
    """
    if not any((speech, data, contacts, acted)):
        raise DataError("nothing to score on; give --speech, --data, --contacts or --acted")
    reserve_report(out, None, force=force)
    with console().status("loading"):
        from deitalk.data.captures.columns import read_mapping
        from deitalk.data.clips import read_clips
        from deitalk.models.checkpoint import require_model
        from deitalk.models.curve_model import DEITalk
        from deitalk.models.folder import describe_model
        from deitalk.research.evaluation.tuned import as_markdown, evaluate
        from deitalk.research.lips.measured import SOUNDS

    sounds = sorted(p for p in (speech.rglob("*") if speech else ()) if p.suffix in SOUNDS)
    if speech is not None and not sounds:
        raise DataError(f"{speech}: no recordings ({', '.join(SOUNDS)})")
    step = max(len(sounds) // most, 1) if most else 1
    models = {"after": require_model(model, DEITalk), "before": require_model(base, DEITalk)}
    with bar("evaluating") as progress:
        report = evaluate(
            models,
            sounds=sounds[::step][:most],
            clips=() if data is None else read_clips(data),
            contacts=contacts,
            strengths=acted,
            mapping=None if mapping is None else read_mapping(mapping),
            progress=progress,
        )
    known = {"model": model, "sha256": describe_model(model)["sha256"]}
    write_report(known | report, as_markdown(report), out, as_json=as_json)
