"""`python -m deitalk.research attention`: temporal attention of a model."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deitalk.cli.console import console, emit_json
from deitalk.cli.options import MAX_COUNT, Device, Force, Json
from deitalk.errors import DataError
from deitalk.research.cli.reports import reserve_picture

if TYPE_CHECKING:
    from deitalk.research.evaluation.attention_figure import AttentionMap


def attention(
    source: Annotated[
        Path, typer.Argument(help="Recording, or a dataset folder whose clips have phones.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help=".png, .svg or .pdf.")],
    phones: Annotated[
        Path | None, typer.Option(help="CSV start,end,phone of the recording: adds the means.")
    ] = None,
    model: Annotated[
        str, typer.Option(help="default, or a model folder with SDFA's attention.")
    ] = "default",
    split: Annotated[str, typer.Option(help="Split of a dataset folder.")] = "validation",
    clips: Annotated[
        int, typer.Option(min=1, max=MAX_COUNT, help="Recordings of a dataset folder.")
    ] = 20,
    device: Device = "cpu",
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Draw the temporal attention of a model over a recording, or over vowels and plosives.

    Evenness is the entropy of a frame's weights over that of equal weights: 1 is flat over the
    window, 0 is one spectrum. SDFA reports even weights at vowels, a peak at plosives.

    Examples
    --------
    python -m deitalk.research attention speech.wav --phones speech.csv -o attention.png

    python -m deitalk.research attention DATA --clips 20 -o attention.png
    """
    from deitalk.evaluation.figures import check_drawing

    check_drawing()
    reserve_picture(out, force=force, inputs=(source, phones))
    if source.is_dir() and phones is not None:
        raise DataError("--phones goes with one recording; a dataset folder has its own")
    with console().status("computing the attention"):
        pooled = _measure(source, out, phones, model, split, clips, device)
    summary = {
        name: {"phones": len(kind.phones), "evenness": kind.evenness, "peak": kind.peak}
        for name, kind in zip(("vowels", "plosives"), pooled, strict=False)
    }
    if as_json:
        from deitalk.research.evaluation.report import identified

        emit_json({"out": str(out), **identified(model), **summary})
        return
    console().print(str(out))
    for name, numbers in summary.items():
        console().print(
            f"{name}: {numbers['phones']}, evenness {numbers['evenness']:.3f}, "
            f"largest weight {numbers['peak']:.3f} on average"
        )


def _measure(
    source: Path,
    out: Path,
    phones: Path | None,
    model: str,
    split: str,
    clips: int,
    device: str,
) -> "tuple[AttentionMap, ...]":
    """Draw the attention; return the means over vowels and plosives if phones are given."""
    from deitalk.audio.load import load_audio
    from deitalk.data.clips import read_phones
    from deitalk.models.checkpoint import load_model
    from deitalk.research.evaluation.attention import (
        attention_of,
        corpus_attention,
        spectra_per_second,
    )
    from deitalk.research.evaluation.attention_figure import (
        attention_maps,
        plot_attention,
        plot_clip,
    )

    network = load_model(model, device=device)
    if source.is_dir():
        pooled = corpus_attention(network, source, split=split, n_clips=clips)
        plot_attention(*pooled, spectra_per_second(network), out)
        return pooled
    recording = load_audio(source)
    along = attention_of(network, recording.waveform)
    known = None if phones is None else read_phones(phones)
    plot_clip(*along, known or (), out)
    return attention_maps(along.weights, known, along.fps) if known else ()
