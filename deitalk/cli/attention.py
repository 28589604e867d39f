"""`deitalk attention`: where a model listens."""

import json
from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.words import words
from deitalk.errors import DataError


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
    split: Annotated[str, typer.Option(help="Of a dataset folder.")] = "validation",
    clips: Annotated[int, typer.Option(min=1, help="Recordings of a dataset folder.")] = 20,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    force: Annotated[bool, typer.Option("--force", help="Replace the picture.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the numbers for machines.")
    ] = False,
) -> None:
    """Draw the temporal attention of a model over a recording, or over vowels and plosives.

    Evenness is the entropy of a frame's weights over that of equal ones: 1 listens everywhere in
    the window, 0 to one spectrum. SDFA reports even weights at vowels, a peak at plosives.

    Examples
    --------
    deitalk attention speech.wav --phones speech.csv -o attention.png

    deitalk attention DATA --clips 20 -o attention.png
    """
    if out.suffix not in (".png", ".svg", ".pdf"):
        raise DataError(f"{out}: a picture is .png, .svg or .pdf")
    if out.exists() and not force:
        raise DataError(f"{out} exists; add --force to replace it, or name another file")
    if source.is_dir() and phones is not None:
        raise DataError("--phones goes with one recording; a dataset folder brings its own")
    with words().status("listening"):
        from deitalk.attention import attention_of, corpus_attention, load_listener
        from deitalk.attention_plot import AttentionMap, attention_maps, plot_attention, plot_clip
        from deitalk.audio import load_audio
        from deitalk.data.folder import read_phones

        network = load_listener(model, device=device)
        pooled: tuple[AttentionMap, ...]
        if source.is_dir():
            pooled = corpus_attention(network, source, split=split, n_clips=clips)
            config = network.config.frontend
            plot_attention(*pooled, config.frame_rate / getattr(config, "time_stack", 1), out)
        else:
            recording = load_audio(source)
            heard = attention_of(network, recording.waveform)
            known = None if phones is None else read_phones(phones)
            plot_clip(*heard, known or (), out)
            pooled = attention_maps(heard.weights, known, heard.fps) if known else ()
    said = {}
    for name, kind in zip(("vowels", "plosives"), pooled, strict=False):
        said[name] = {"phones": len(kind.phones), "evenness": kind.evenness, "peak": kind.peak}
    if as_json:
        typer.echo(json.dumps({"out": str(out), **said}))
        return
    words().print(str(out), markup=False)
    for name, numbers in said.items():
        words().print(
            f"{name}: {numbers['phones']}, evenness {numbers['evenness']:.3f}, "
            f"largest weight {numbers['peak']:.3f} on average"
        )
