"""`python -m deitalk.research corpus`: make a dataset of labelled speech and facial curves."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console
from deitalk.cli.options import MAX_PROCESSES, CheckedCommands, Force
from deitalk.cli.targets import reserve_folder
from deitalk.errors import DataError
from deitalk.research.cli.options import MAX_SEED

MAX_HOURS = 10_000
"""Most hours of synthetic speech."""

app = CheckedCommands(
    help="Make a dataset of labelled speech and facial curves.", no_args_is_help=True
)


@app.callback()
def _group() -> None:
    """Make a dataset of labelled speech and facial curves."""


@app.command()
def build(
    out: Annotated[Path, typer.Option("--out", "-o", help="Dataset folder; resumed if begun.")],
    hours: Annotated[
        float, typer.Option(min=0, max=MAX_HOURS, help="Hours of synthetic speech.")
    ] = 1.0,
    recordings: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of real speech with transcripts (LibriSpeech layout, tables, "
            "or clips.csv); may be given several times."
        ),
    ] = None,
    alignments: Annotated[
        Path | None, typer.Option(help="Folder that keeps phone times between builds.")
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, max=MAX_SEED, help="Seed of voices, words, prosody and emotions.")
    ] = 0,
    workers: Annotated[int, typer.Option(min=1, max=MAX_PROCESSES, help="Processes.")] = 2,
) -> None:
    """Synthesise speech, align recordings, compute their curves, and write a dataset folder.

    Examples
    --------
    python -m deitalk.research corpus build --hours 1 -o corpus/

    python -m deitalk.research corpus build --hours 4 --recordings LibriSpeech/dev-clean -o corpus/
    """
    from deitalk.research.corpus import build as building
    from deitalk.research.corpus.engines import available_engines
    from deitalk.research.corpus.recordings import recordings as list_recordings

    engines = []
    for name, reason in available_engines().items():
        if reason is None:
            engines.append(name)
        elif hours > 0:
            console().print(f"without {name}: {reason}")
    found = [recording for folder in recordings or () for recording in list_recordings(folder)]
    if not found and (hours <= 0 or not engines):
        raise DataError(
            "no speech engine is installed and no recordings are given; "
            "install espeak-ng (pip install espeakng-loader) or name --recordings"
        )
    shards = building.recorded_shards(found, seed, alignments)
    if hours > 0:
        shards += building.synthetic_shards(hours, seed, engines)
    done = 0
    with bar("building") as progress:

        def advance(seconds: float) -> None:
            nonlocal done
            done += 1
            progress(done / len(shards))

        frame = building.build(out, shards, workers=workers, progress=advance)
    counts = frame.groupby("split").size().to_dict()
    console().print(
        f"{out}: {len(frame)} clips ({', '.join(f'{v} {k}' for k, v in counts.items())})"
    )


@app.command()
def sheet(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the two pictures.")],
    phones: Annotated[
        str, typer.Option(help="Phones of the channel picture, such as 'SIL M AA SIL'.")
    ] = "",
    force: Force = False,
) -> None:
    """Draw the articulation tables: channels of a sentence, phones by emotions on a face."""
    from deitalk.research.corpus import figures as pictures
    from rig.files import output_folder

    reserve_folder(out, kind="pictures", force=force)
    names = (phones or pictures.SENTENCE).split()
    timed = pictures.evenly_timed(names)
    with console().status("drawing"), output_folder(out, kind="pictures", force=force) as stage:
        pictures.plot_channels(timed, stage / "channels.png")
        pictures.draw_faces(stage / "faces.png")
    console().print(f"{out}: channels.png, faces.png")
