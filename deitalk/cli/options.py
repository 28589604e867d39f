"""Options that several commands share, and checks of the arguments of every command.

Numbers with a fraction must be finite, paths must not be empty: `CheckedCommands` adds these checks
to each of its commands.
"""

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin

import typer

from rig.limits import MOST_DELAY, MOST_HANDLES
from rig.written_number import number_of

MAX_THREADS = 1024
"""Most threads; more end the process on most systems."""
MAX_PROCESSES = 256
MAX_COUNT = 10**9
"""Largest number of steps, clips or recordings."""

EDITING, MESH, EXPERT = "Editing", "Mesh", "Expert"
"""Panels of options in the help; those of every day have none and come first."""

Command = TypeVar("Command", bound=Callable[..., Any])


class CheckedCommands(typer.Typer):
    """A group of commands whose arguments are checked."""

    def command(self, *arguments: Any, **options: Any) -> Callable[[Command], Command]:
        """Register a command as `typer.Typer.command` does."""
        return _checking(super().command(*arguments, **options))

    def callback(self, *arguments: Any, **options: Any) -> Callable[[Command], Command]:
        """Register a callback as `typer.Typer.callback` does."""
        return _checking(super().callback(*arguments, **options))


def _checking(register: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Wrap `register`: add checks to the arguments of a command."""

    def checked(function: Command) -> Command:
        for parameter in inspect.signature(function).parameters.values():
            if get_origin(parameter.annotation) is Annotated:
                _check(*get_args(parameter.annotation)[:2])
        return register(function)

    return checked


def _check(kind: Any, option: Any) -> None:
    """Add the checks of a type to an option or argument."""
    kinds = {kind, *get_args(kind)}
    if float in kinds:
        option.callback = finite
    elif Path in {inner for one in kinds for inner in (one, *get_args(one))}:
        option.parser = path


def finite(value: float | None) -> float | None:
    """Return a number; raise for NaN and infinity."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value:g} is not a finite number")
    return value


def share_of(text: str | float) -> float:
    """Return a share, 0 to 1, such as ``.6`` or ``60%``."""
    share = number_of(text)
    if not 0 <= share <= 1:
        raise typer.BadParameter(f"{text} must be a number, 0 to 1, or a percentage")
    return share


def usable_device(name: str) -> str:
    """Return the name of a device; raise if torch does not have it."""
    from deitalk.errors import DeitalkError
    from deitalk.models.device import check_device

    try:
        return check_device(name)
    except DeitalkError as error:
        raise typer.BadParameter(str(error)) from None


def path(text: str | Path) -> Path:
    """Return a path; raise for an empty one, which would stand for the current folder."""
    if not str(text):
        raise typer.BadParameter("an empty path; name a file or a folder")
    return Path(text)


def control_set_of(rig: str) -> str:
    """Return the control set of --rig: board, raw, arkit or an avatar; raise for another."""
    from deitalk.errors import DeitalkError
    from rig.controls import DEFAULT_ID
    from rig.conversion.arkit import ARKIT_ID
    from rig.conversion.avatars import AVATARS
    from rig.conversion.raw import RAW_ID

    sets = {"board": DEFAULT_ID, "raw": RAW_ID, "arkit": ARKIT_ID} | {a: a for a in AVATARS}
    if rig not in sets:
        raise DeitalkError(f"--rig {rig!r} is unknown; use {', '.join(sets)}, or as-is to convert")
    return sets[rig]


Model = Annotated[str, typer.Option(help="default, live, or a model folder.")]
AnyModel = Annotated[
    str,
    typer.Option("--model", help="default, live, a mesh model (mesh_head, sdfa), or a folder."),
]
Backend = Annotated[
    str,
    typer.Option(
        rich_help_panel=EXPERT,
        help="onnx: ONNX Runtime; torch; auto: ONNX Runtime on a processor.",
    ),
]
Device = Annotated[
    str,
    typer.Option(rich_help_panel=EXPERT, help="cpu, cuda, cuda:N or mps.", callback=usable_device),
]
Rate = Annotated[
    float | None, typer.Option(help="Rate of the written curves: 24 25 29.97 30 50 60.")
]
Digits = Annotated[
    int | None,
    typer.Option(
        min=2,
        max=6,
        rich_help_panel=EDITING,
        help="Digits after the point of csv, json and unreal.json; else 6.",
    ),
]
Timecode = Annotated[
    str,
    typer.Option(
        rich_help_panel=EDITING,
        help="Of the first frame: zero, recording (that of a WAV), HH:MM:SS:FF; HH:MM:SS;FF is "
        "drop frame.",
    ),
]
Delay = Annotated[
    int,
    typer.Option(
        min=-MOST_DELAY,
        max=MOST_DELAY,
        rich_help_panel=EDITING,
        help="Frames by which the face is late against the sound; early if negative.",
    ),
]
Handles = Annotated[
    int,
    typer.Option(
        min=0,
        max=MOST_HANDLES,
        rich_help_panel=EDITING,
        help="Frames added before and after, which hold the pose; the time code is earlier by "
        "them.",
    ),
]
Threads = Annotated[
    int,
    typer.Option(
        min=1,
        max=MAX_THREADS,
        rich_help_panel=EXPERT,
        help="CPU threads, at most one per processor; more than one seldom helps so small a "
        "network.",
    ),
]
Identity = Annotated[
    str,
    typer.Option(
        help="Head: female, male, child, one of `deitalk face identities`, or the .npz of "
        "`deitalk face import`."
    ),
]
WrittenIdentity = Annotated[
    str | None,
    typer.Option(
        "--identity",
        rich_help_panel=MESH,
        help="Head of a GLB, a USD, --preview or --vertices: female, male, child, one of "
        "`deitalk face identities`, or the .npz of `deitalk face import`; a speaker of an SDFA "
        "model.",
    ),
]
MeshOut = Annotated[
    str,
    typer.Option(
        "--out", "-o", help=".glb, .fbx (retarget), .npz (vertices) or a folder/ for .ply files."
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files.")]
ForceFolder = Annotated[bool, typer.Option("--force", help="Replace the folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print a summary as JSON.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", help="Override, such as train.steps=400.")
]
Resume = Annotated[
    bool, typer.Option("--resume", help="Continue the run folder; begin it if it is new.")
]
Track = Annotated[
    list[str] | None,
    typer.Option("--track", help="Also log to tensorboard (in OUT), wandb or mlflow."),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Exit code 3 where loudness predicts as well.")
]
Base = Annotated[
    str | None,
    typer.Option("--from", help="Model to tune: default, a folder, or org/name on the hub."),
]
Recipe = Annotated[
    Path | None, typer.Option("--recipe", help="YAML, such as configs/finetune.yaml.")
]
RigFile = Annotated[
    str | None,
    typer.Option(
        "--rig", help="YAML of a rig other than the MetaHuman board; by default DATA/rig.yaml."
    ),
]
RigMap = Annotated[
    Path | None,
    typer.Option(
        "--map", help="Table of the rig's curves to the board, which carries emotions to it."
    ),
]
LeaveOut = Annotated[
    str | None, typer.Option("--leave-out", help="Take or actor to test on, not to train on.")
]
