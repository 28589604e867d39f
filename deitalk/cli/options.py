"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.arguments import MAX_COUNT, MAX_THREADS, usable_device

Model = Annotated[str, typer.Option(help="default, live, or a model folder.")]
AnyModel = Annotated[
    str, typer.Option("--model", help="default, live, a model folder, or an .onnx file.")
]
Backend = Annotated[
    str, typer.Option(help="torch, or onnx: ONNX Runtime (extra onnx), which starts faster.")
]
Device = Annotated[str, typer.Option(help="cpu, cuda, cuda:N or mps.", callback=usable_device)]
Digits = Annotated[
    int | None,
    typer.Option(min=2, max=6, help="Digits after the point of csv, json and unreal.json; else 6."),
]
Timecode = Annotated[
    str, typer.Option(help="Of the first frame: zero, recording (that of a WAV), HH:MM:SS:FF.")
]
Threads = Annotated[
    int,
    typer.Option(
        min=1,
        max=MAX_THREADS,
        help="CPU threads, at most one per processor; more than one seldom helps so small a "
        "network.",
    ),
]
Most = Annotated[
    int | None,
    typer.Option(min=1, max=MAX_COUNT, help="Most recordings of every source."),
]
Identity = Annotated[
    str,
    typer.Option(
        help="Head: female, male, child, or a number or name of `deitalk face identities`."
    ),
]
WrittenIdentity = Annotated[
    str | None,
    typer.Option(
        "--identity",
        help="Head of a GLB, a USD or --preview: female, male, child, or one of `deitalk face "
        "identities`.",
    ),
]
Picture = Annotated[Path, typer.Option("--out", "-o", help=".png, .svg or .pdf.")]
MeshOut = Annotated[
    str,
    typer.Option("--out", "-o", help=".glb, .npz (vertices) or a folder/ for .ply files."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files.")]
Json = Annotated[bool, typer.Option("--json", help="Print a summary as JSON.")]
