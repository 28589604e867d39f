"""`python -m deitalk.research evaluate`: score a model on a dataset folder."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.options import MAX_COUNT, Force, Json, Threads
from deitalk.errors import DataError
from deitalk.research.cli.options import Most, Picture, Report, Split
from deitalk.research.cli.reports import reserve_report, write_report

if TYPE_CHECKING:
    from deitalk.models.curve_model import DEITalk

SPEED = "Speed"
"""Panel of the help."""
MAX_SECONDS = 3 * 3600.0
"""Longest clip, seconds."""


def evaluate(
    model: Annotated[str, typer.Argument(help="an embedded model, or a model folder.")] = "default",
    data: Annotated[Path, typer.Option(help="Dataset folder.")] = Path("corpus"),
    split: Split = "validation",
    most: Most = None,
    probes: Annotated[
        int,
        typer.Option(
            min=0,
            max=MAX_COUNT,
            help="Recordings of every source animated in all emotions and with modified prosody.",
        ),
    ] = 6,
    noise: Annotated[
        str | None, typer.Option(help="Also in noise: a folder of recordings, or pink.")
    ] = None,
    captured: Annotated[
        Path | None, typer.Option(help="Captured curves to compare the smoothness with.")
    ] = None,
    transitions: Annotated[
        bool,
        typer.Option("--transitions", help="Mesh models: only recordings where s meets m, b, p."),
    ] = False,
    lips: Annotated[
        Path | None,
        typer.Option(help="Folder of measured lips to score on, instead of a dataset folder."),
    ] = None,
    speaker: Annotated[
        list[str] | None,
        typer.Option(help="Speaker of measured lips to score; repeatable."),
    ] = None,
    acted: Annotated[
        Path | None,
        typer.Option(help="Table of actors at two or three strengths, instead of a dataset."),
    ] = None,
    contacts: Annotated[
        Path | None,
        typer.Option(help="Table of phones to score contacts on; DATA teaches the ridge."),
    ] = None,
    encoder: Annotated[
        Path | None,
        typer.Option(help="Folder of a published Whisper encoder, for more ridge regressions."),
    ] = None,
    out: Report = None,
    picture: Picture = None,
    speed: Annotated[
        bool,
        typer.Option("--speed", rich_help_panel=SPEED, help="Instead: time of the stages here."),
    ] = False,
    seconds: Annotated[
        float,
        typer.Option(min=0.1, max=MAX_SECONDS, rich_help_panel=SPEED, help="Length of the clip."),
    ] = 30.0,
    threads: Threads = 1,
    repeats: Annotated[
        int,
        typer.Option(min=1, max=1000, rich_help_panel=SPEED, help="Runs; the best is reported."),
    ] = 3,
    memory: Annotated[
        bool,
        typer.Option(
            "--memory",
            rich_help_panel=SPEED,
            help="Also peak memory at 1, 10 and 60 minutes (slow).",
        ),
    ] = False,
    mesh: Annotated[
        bool,
        typer.Option(
            "--mesh", rich_help_panel=SPEED, help="SDFA's Table 4, three mesh models by stages."
        ),
    ] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Score lips, errors, emotions and silence beside baselines; or measure speed.

    Beside scores of lips and contacts stand those of a ridge regression on the model's own speech
    features: what curves should reach at least.

    Examples
    --------
    python -m deitalk.research evaluate default --data corpus/ --split test

    evaluate runs/mel/best --data corpus/ --most 100 --noise pink -o report.md

    python -m deitalk.research evaluate runs/sdfa_small/best --data corpus/ --split test

    python -m deitalk.research evaluate default --lips grid_lips/

    evaluate default --contacts phones.csv --data corpus/ --encoder whisper-base/

    python -m deitalk.research evaluate default --acted crema/clips.csv --split test

    python -m deitalk.research evaluate default --speed --memory
    """
    if speed:
        scores = {"out": out, "picture": picture, "noise": noise, "captured": captured}
        scores |= {"lips": lips, "acted": acted, "contacts": contacts, "encoder": encoder}
        _refuse("not with --speed, which prints (--json)", **scores)
        from deitalk.research.cli.speed import measure

        measure(model, seconds, threads, repeats, memory=memory, mesh=mesh, as_json=as_json)
        return
    _refuse("with --speed", memory=memory or None, mesh=mesh or None)
    reserve_report(out, picture, force=force)
    from deitalk.models.folder import describe_model, product_of

    if product_of(model) == "mesh":
        _refuse("not for mesh models", noise=noise, captured=captured, picture=picture)
        _refuse("not for mesh models", lips=lips, acted=acted, contacts=contacts, encoder=encoder)
        report, markdown = _score_mesh(model, data, split=split, most=most, transitions=transitions)
    elif acted is not None:
        _refuse("not with acted strengths", noise=noise, captured=captured, picture=picture)
        _refuse("not with acted strengths", lips=lips, speaker=speaker, most=most)
        _refuse("not with acted strengths", contacts=contacts, encoder=encoder)
        report, markdown = _score_people(model, "acted", acted, split=split)
    elif lips is not None:
        _refuse("not with measured lips", noise=noise, captured=captured, picture=picture)
        _refuse("not with measured lips", contacts=contacts)
        report, markdown = _score_people(
            model, "lips", lips, speakers=speaker or (), most=most, encoder=encoder
        )
    elif contacts is not None:
        _refuse("not with contacts", noise=noise, captured=captured, picture=picture)
        _refuse("for measured lips", speaker=speaker)
        report, markdown = _score_people(
            model, "contacts", contacts, data=data, most=most, encoder=encoder
        )
    else:
        _refuse("for measured lips", speaker=speaker)
        _refuse("for mesh models", transitions=transitions or None)
        report, markdown = _score_curves(
            model,
            data,
            split=split,
            most=most,
            probes=probes,
            noise=noise,
            captured=captured,
            encoder=encoder,
        )
    known = {"model": model, "sha256": describe_model(model)["sha256"]}
    write_report(known | report, markdown, out, as_json=as_json)
    if picture is not None:
        from deitalk.research.evaluation.curves_figure import draw_evaluation

        draw_evaluation(report, picture)


def _score_curves(model: str, data: Path, **options: Any) -> tuple[dict[str, Any], str]:
    """Report on a curve model, and its Markdown."""
    network = _curve_model(model)
    from deitalk.research.evaluation.curves import evaluate
    from deitalk.research.evaluation.report import as_markdown

    with bar("evaluating") as progress:
        report = evaluate(network, data, **options, progress=progress)
    return report, as_markdown(report)


def _score_people(model: str, kind: str, path: Path, **options: Any) -> tuple[dict[str, Any], str]:
    """Report on measured lips, contacts or acted strengths, and its Markdown."""
    scores = import_module(f"deitalk.research.evaluation.{kind}")
    network = _curve_model(model)
    with bar("evaluating") as progress:
        report = scores.evaluate(network, path, **options, progress=progress)
    return report, scores.as_markdown(report)


def _score_mesh(model: str, data: Path, **options: Any) -> tuple[dict[str, Any], str]:
    """Report on a mesh model, and its Markdown."""
    with console().status("loading"):
        from deitalk.models.checkpoint import require_model
        from deitalk.models.mesh_model import MeshModel
        from deitalk.research.meshes.scores import as_markdown, evaluate_mesh

        network = require_model(model, MeshModel)
    with bar("evaluating") as progress:
        report = evaluate_mesh(network, data, **options, progress=progress)
    return report, as_markdown(report)


def _curve_model(model: str) -> "DEITalk":
    """A model of curves."""
    with console().status("loading"):
        from deitalk.models.checkpoint import require_model
        from deitalk.models.curve_model import DEITalk

        return require_model(model, DEITalk)


def _refuse(reason: str, **options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise DataError(f"--{name}: {reason}; leave it out")
