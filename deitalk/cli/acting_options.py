"""Options of an acting: one for each field of `deitalk.acting.Acting`, in its panel."""

import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import wraps
from typing import Annotated, Any

import typer
from pydantic import WithJsonSchema
from pydantic.fields import FieldInfo

from deitalk.acting import Acting
from deitalk.audio.choice import MOST_TRACKS, AudioChoice
from rig import limits


@dataclass(frozen=True)
class Given:
    """An acting of options.

    Attributes
    ----------
    acting : Acting
    texts : tuple of str
        The options as written: files among them are inputs of the command.
    choice : AudioChoice
        Which signal of the recording.
    """

    acting: Acting
    texts: tuple[str, ...]
    choice: AudioChoice


def acting_options(
    command: Callable[..., None],
    fields: Iterable[str] = Acting.model_fields,
    *,
    of_recording: bool = True,
) -> Callable[..., None]:
    """Put an option for each field in place of a command's parameter `given`, a `Given`.

    Parameters
    ----------
    command : callable
        Of typer.
    fields : iterable of str
        Names of those that the command takes; all by default.
    of_recording : bool
        Whether it takes the options of a recording's signal too.
    """
    signature = inspect.signature(command)
    names = list(fields)
    own = signature.parameters
    signal = [*SIGNAL] if of_recording else []
    made: list[inspect.Parameter] = []
    for parameter in own.values():
        if parameter.name == "given":
            made += map(_option, names)
            made += (_parameter(name, SIGNAL[name], None) for name in signal)
        else:
            made.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    @wraps(command)
    def run(**arguments: Any) -> None:
        choice = AudioChoice.of(**{name: arguments.pop(name) for name in signal})
        found = {name: arguments.pop(name) for name in names}
        parts = (part for v in found.values() for part in (v if isinstance(v, list) else [v]))
        texts = tuple(part for part in parts if isinstance(part, str))
        command(given=Given(Acting.of(**found), texts, choice), **arguments)

    run.__signature__ = signature.replace(parameters=made)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in made} | {"return": None}
    return run


SIGNAL: dict[str, Any] = {
    "track": Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_TRACKS,
            rich_help_panel="Recording",
            help="Sound track, from 1 on; else the first with speech.",
        ),
    ],
    "channel": Annotated[
        str | None,
        typer.Option(
            rich_help_panel="Recording",
            help="Channel: a number from 1 on, left, right, centre, loudest or mix; else the "
            "centre of surround sound, or the mean of all.",
        ),
    ],
    "raw": Annotated[
        str | None,
        typer.Option(
            rich_help_panel="Recording",
            help="Form of samples without a header: encoding, Hz, channels, such as s16le,24000,1.",
        ),
    ],
}
"""Options of `deitalk.audio.choice.AudioChoice`."""


def _option(name: str) -> inspect.Parameter:
    field = Acting.model_fields[name]
    extra: dict[str, Any] = field.json_schema_extra or {}  # type: ignore[assignment]
    kind, default = _kind(field), extra.get("default", field.default)
    more: dict[str, Any] = {"min": 0, "max": limits.SEED} if kind is int else {}
    if kind is float:  # as text, for `rig.written_number`
        kind, more = str, {"metavar": "<number>"}
    flags = [f"--{name.replace('_', '-')}"]
    if kind is bool:
        flags = [f"{flags[0]}/--no-{name}"]
    if name == "emotion":
        flags.append("-e")
    if name == "role":
        flags.append("--speaker")
    help_text = field.description
    if extra.get("x-repeated"):
        kind, default, help_text = list[str], None, f"{help_text} Repeatable."
    option = typer.Option(
        *flags,
        help=help_text,
        rich_help_panel=extra.get("x-panel"),
        show_default=bool(default),
        **more,
    )
    return _parameter(name, Annotated[kind | None if default is None else kind, option], default)


def _kind(field: FieldInfo) -> Any:
    """Type of a field's option; the whole JSON schema would take a hundredth of a second."""
    if field.annotation is bool:
        return bool
    stated = (part.json_schema for part in field.metadata if isinstance(part, WithJsonSchema))
    return {"number": float, "integer": int}.get((next(stated, None) or {}).get("type", ""), str)


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)
