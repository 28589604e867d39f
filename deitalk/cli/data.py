"""`deitalk data`: dataset folders of captured takes, and an actor's voice."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deitalk.cli.console import bar, console, emit, emit_json
from deitalk.cli.options import MAX_COUNT, CheckedCommands, Force, Json
from deitalk.cli.targets import reserve_file, reserve_folder
from deitalk.errors import DeitalkError
from rig.errors import as_line

if TYPE_CHECKING:
    from rig import ControlSet

app = CheckedCommands(
    help="Make a dataset folder of captured takes, check it; measure a voice.",
    no_args_is_help=True,
)


FIXABLE = ("offset", "drift", "rest pose", "dead")
"""Checks of captures whose faults `check --fix` corrects."""


Rig = Annotated[
    str | None,
    typer.Option(
        help="Another rig, whose curves stay as they are: YAML, arkit, metahuman-raw, cc4, daz8, "
        "daz9 or facegood."
    ),
]


RigMap = Annotated[
    Path | None,
    typer.Option(
        "--map",
        "--mapping",
        help="Curves of another rig: CSV of target, source, weight, offset.",
    ),
]
Fps = Annotated[float | None, typer.Option(help="Frames per second of files that hold no rate.")]


def _controls(rig: str | None) -> "ControlSet | None":
    from deitalk.config.rig_file import read_controls

    return None if rig is None else read_controls(rig)


@app.callback()
def _group() -> None:
    """Make a dataset folder of captured takes, check it; measure a voice."""


@app.command("import")
def import_(
    sources: Annotated[
        list[Path],
        typer.Argument(help="Files of captured curves, videos of a face, or folders of takes."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Dataset folder.")],
    actor: Annotated[str | None, typer.Option(help="Actor of all takes.")] = None,
    emotion: Annotated[
        str | None, typer.Option("--emotion", "-e", help="Emotion of all takes.")
    ] = None,
    style: Annotated[str | None, typer.Option(help="Style of all takes, any word.")] = None,
    pattern: Annotated[
        str | None,
        typer.Option(
            help="Regular expression on a take's path, with groups (?P<actor>…), (?P<emotion>…) "
            "or (?P<style>…)."
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(
            help="CSV with a column take, and any of actor, emotion, style, voice, split."
        ),
    ] = None,
    mapping: RigMap = None,
    rig: Rig = None,
    rig_from: Annotated[
        Path | None,
        typer.Option(help="Takes whose columns are the rig; its file is OUT/rig.yaml."),
    ] = None,
    fps: Fps = None,
    audio: Annotated[
        list[Path] | None, typer.Option(help="Folder of recordings that lie elsewhere; repeatable.")
    ] = None,
    longest: Annotated[float, typer.Option(help="Longest clip, seconds.")] = 15.0,
    keep_listening: Annotated[
        bool, typer.Option("--keep-listening", help="Keep pauses of more than 1.5 s.")
    ] = False,
    split_by: Annotated[
        str,
        typer.Option(
            help="Hold clips out: whole actors (actor), or takes and blocks of time (time); by "
            "default all are learnt from, which finetune judges by folds."
        ),
    ] = "auto",
    as_json: Json = False,
    force: Force = False,
) -> None:
    r"""Write a dataset folder of captured takes: iPhone, video, MetaHuman Animator, any rig.

    Live Link Face takes are read as the app leaves them (CSV beside .mov). Takes are cut in pauses
    into clips; every clip lists the controls that its source can know. Sources, labels and faults:
    docs/finetuning.md.

    Examples
    --------
    deitalk data import takes/ --actor anna -o anna_data/

    deitalk data import talk.mp4 --actor anna -o anna_data/

    deitalk data import takes/ --pattern "(?P<actor>\w+?)_(?P<emotion>\w+?)_" -o data/

    deitalk data import mocap/ --map my_rig.csv --fps 30 -o data/

    deitalk data import mocap/ --rig my_rig.yaml --fps 30 -o data/

    deitalk data import mocap/ --rig-from mocap/ --fps 30 -o data/

    deitalk data import mocap/ --rig cc4 --fps 30 -o data/
    """
    reserve_folder(out, kind="dataset", force=force, inputs=(*sources, table, mapping))
    with console().status("loading"):
        from deitalk.data.captures.imported import import_captures
        from deitalk.data.captures.rig_of import rig_of_takes

        if rig is not None and rig_from is not None:
            raise DeitalkError("--rig-from makes the rig of the takes; leave --rig out")
        controls = _controls(rig) if rig_from is None else rig_of_takes([rig_from], fps)
    with bar("importing") as progress:
        result = import_captures(
            sources,
            out,
            actor=actor,
            emotion=emotion,
            style=style,
            pattern=pattern,
            table=table,
            mapping=mapping,
            rig=controls,
            fps=fps,
            audio=audio or (),
            longest=longest,
            keep_listening=keep_listening,
            split_by=split_by,
            force=force,
            progress=progress,
        )
    if as_json:
        emit_json(result.as_dict(), indent=1)
    else:
        for line in result.lines():
            emit(as_line(line))
        emit(as_line(f"{out}: {result.summary}"))
    console().note(*result.warnings)


@app.command()
def check(
    folder: Annotated[Path, typer.Argument(help="Dataset folder with clips.csv.")],
    most: Annotated[
        int | None,
        typer.Option(min=1, max=MAX_COUNT, help="Most clips to read, evenly spread."),
    ] = None,
    rig: Rig = None,
    fix: Annotated[
        bool,
        typer.Option(
            "--fix",
            help="Of captured takes: write offsets, names of emotions, lists of known controls and "
            "curves without the actors' rest pose, and a report into check/.",
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Check a dataset folder for training; exit code 1 on errors.

    Names, rates, lengths, offset of curves and sound, silence, ranges, controls that never move,
    balance of the emotions, speakers in several splits. Of captured takes (`deitalk data import`)
    also drift, rest poses, channels that are clipped, frozen, jittering or dead, swapped sides,
    faces unlike their emotion, and usable minutes.

    Examples
    --------
    deitalk data check my_capture/

    deitalk data check my_capture/ --fix
    """
    from deitalk.config.rig_file import rig_of_dataset
    from deitalk.data.captures.mend import mend, rename_emotions
    from deitalk.data.checks import inspect_dataset

    if fix and most is not None:
        raise DeitalkError("--fix reads every clip; leave --most out")
    renamed = rename_emotions(folder) if fix else 0
    with bar("reading") as progress:
        checks, survey = inspect_dataset(
            folder, controls=_controls(rig_of_dataset(folder, rig)), most=most, progress=progress
        )
    if fix and survey is None:
        raise DeitalkError(f"{folder}: no clip states its take; --fix needs `deitalk data import`")
    if as_json:
        emit_json([{"check": c.name, "level": c.level, "text": c.text} for c in checks], indent=1)
    else:
        for c in checks:
            emit(as_line(f"{c.level:8} {c.name:13} {c.text}"))
    wrong = [c.name for c in checks if c.level != "ok" and c.name in FIXABLE]
    if not fix and survey is not None and wrong:
        console().note(f"--fix corrects {', '.join(wrong)}")
    if fix and survey is not None:
        mended = mend(folder, survey, checks, emotions=renamed)
        console().print(f"{mended.summary}; {folder / 'check' / 'report.md'}")
    if any(c.level == "error" for c in checks):
        raise typer.Exit(1)


@app.command()
def voice(
    out: Annotated[Path, typer.Option("--out", "-o", help="Reference file, .json.")],
    recordings: Annotated[
        list[Path] | None, typer.Argument(help="Recordings of one actor; none with --takes alone.")
    ] = None,
    takes: Annotated[
        list[Path] | None,
        typer.Option(help="Captured takes of the actor, with or without sound; repeatable."),
    ] = None,
    mapping: RigMap = None,
    fps: Fps = None,
    model: Annotated[str, typer.Option(help="Model whose takes count from it.")] = "default",
    force: Force = False,
) -> None:
    """Write the reference of an actor, for `deitalk animate --voice`.

    Intensity then counts from this actor's usual voice instead of an average speaker's: a soft
    voice is not always faint, a sharp one not always strong. A dozen lines are enough.

    Traits of the actor's motion are drawn, or measured on 20 s and more of captured takes
    (--takes): blinks, the stronger side, width of brows and head, the side of averted looks.

    Examples
    --------
    deitalk data voice anna/*.wav -o anna.json

    deitalk data voice anna/*.wav --takes captured/ -o anna.json
    """
    from deitalk.errors import AudioError

    sounds, sources = recordings or [], takes or []
    if out.suffix != ".json":
        raise AudioError(f"{out}: an actor reference is a .json file")
    if not sounds and not sources:
        raise AudioError("nothing to measure; name recordings of the actor, or --takes")
    reserve_file(out, force=force, inputs=[*sounds, *sources, mapping])
    from deitalk.pipeline.actor_voice import measure_actor
    from rig.files import atomic_write

    traits: dict[str, float] = {}
    if sources:
        from deitalk.data.captures.columns import read_mapping
        from deitalk.data.captures.sources import find_takes
        from deitalk.data.captures.take import read_capture
        from deitalk.data.captures.traits import measure_traits

        table = None if mapping is None else read_mapping(mapping)
        found, _ = find_takes(sources, None if table is None else table.sources)
        captures = []
        with bar("reading") as progress:
            for done, take in enumerate(found, 1):
                captures.append(read_capture(take.curves, mapping=table, fps=fps))
                progress(done / len(found))
        traits = measure_traits(captures)
    if not sounds and not traits:
        raise AudioError(
            f"{sources[0]}: no trait can be measured on the takes; give 20 s and more of moving "
            "lids, brows, eyes or head, or recordings"
        )
    with bar("measuring") as progress:
        actor = measure_actor(
            sounds, lambda done: progress(done / len(sounds)), model=model, traits=traits
        )
    with atomic_write(out) as path:
        path.write_text(actor.as_json(), encoding="utf-8")
    emit(
        as_line(
            f"{out}: strength {actor.strength:.2f} in {actor.recordings} recordings "
            f"({actor.seconds:.0f} s)"
        )
    )
    if sources:
        measured = ", ".join(f"{name} {value:.2f}" for name, value in traits.items())
        drawn = ", ".join(name for name in actor.traits if name not in traits) or "none"
        emit(as_line(f"measured on the takes: {measured or 'nothing'}; drawn at random: {drawn}"))
