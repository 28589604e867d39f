"""`deitalk actor`: the usual voice of an actor."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, emit
from deitalk.cli.options import CheckedCommands, Force
from deitalk.cli.paths import reserve_file
from rig.errors import as_line

app = CheckedCommands(help="Measure the usual voice of an actor.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Measure the usual voice of an actor."""


@app.command()
def build(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings of one actor.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Reference file, .json.")],
    force: Force = False,
) -> None:
    """Write the reference of an actor, for `deitalk animate --voice`.

    Intensity then counts from this actor's usual voice instead of an average speaker's: a soft
    voice is not always faint, a sharp one not always strong. A dozen lines are enough.

    Examples
    --------
    deitalk actor build anna/*.wav -o anna.json
    """
    from deitalk.errors import AudioError

    if out.suffix != ".json":
        raise AudioError(f"{out}: an actor reference is a .json file")
    reserve_file(out, force=force, inputs=recordings)
    from deitalk.pipeline.speech import measure_actor
    from rig.files import atomic_write

    with bar("measuring") as progress:
        actor = measure_actor(recordings, lambda done: progress(done / len(recordings)))
    with atomic_write(out) as path:
        path.write_text(actor.as_json(), encoding="utf-8")
    emit(
        as_line(
            f"{out}: strength {actor.strength:.2f} in {actor.recordings} recordings "
            f"({actor.seconds:.0f} s)"
        )
    )
