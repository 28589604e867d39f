"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.arguments import MAX_COUNT, MAX_THREADS, usable_device

Emotion = Annotated[
    str,
    typer.Option(
        "--emotion",
        "-e",
        help="neutral, angry, happy, sad, surprised; weights such as happy=0.7,surprised=0.3; "
        "a keyframed track (.csv .json .yaml); animate also: auto, suggested from the voice.",
    ),
]
Intensity = Annotated[
    float, typer.Option(help="Factor on the intensity predicted from the voice, 0 to 4.")
]
IntensityCurve = Annotated[
    Path | None, typer.Option(help="Edited intensity.csv of a take, instead of the prediction.")
]
Voice = Annotated[
    Path | None,
    typer.Option(help="Usual voice of the actor, from `deitalk actor build`."),
]
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
Words = Annotated[
    str | None,
    typer.Option(
        "--transcript",
        help="What is said: text, .txt, .csv (start, end, word) or .TextGrid; its closures are met "
        "where the sound agrees.",
    ),
]
PhonesGiven = Annotated[
    str | None,
    typer.Option(
        "--phones", help="The same as phones (ARPABET or IPA), without espeak-ng for their sounds."
    ),
]
Language = Annotated[
    str, typer.Option(help="espeak-ng's voice for the words: en-us, en-gb, de, fr, es, cmn …")
]
LifeFactors = Annotated[
    str | None,
    typer.Option("--life", help="Factors on them, 0 to 2: brows=.8,head=1.2,blinks=1,gaze=.5."),
]
LookAt = Annotated[
    str, typer.Option(help="Listener's place: degrees to the character's left and up.")
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
