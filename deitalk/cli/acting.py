"""Options of an acting: one for each field of `deitalk.acting.Acting`, in its panel."""

import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import wraps
from typing import Annotated, Any

import typer

from deitalk.acting import OLD_NAMES, Acting, modern, renamed
from deitalk.cli.console import console
from rig import limits

_TYPES = {"number": float, "integer": int, "boolean": bool}
_SCHEMA = Acting.model_json_schema()["properties"]
_OLD_FLAGS = {"idle": "--idle/--no-idle", "raw": "--raw"}


@dataclass(frozen=True)
class Given:
    """An acting of options.

    Attributes
    ----------
    acting : Acting
    texts : tuple of str
        The options as written: files among them are inputs of the command.
    """

    acting: Acting
    texts: tuple[str, ...]


def acting_options(
    command: Callable[..., None], fields: Iterable[str] = Acting.model_fields
) -> Callable[..., None]:
    """Put an option for each field in place of a command's parameter `given`, a `Given`.

    Parameters
    ----------
    command : callable
        Of typer.
    fields : iterable of str
        Names of those that the command takes; all by default.
    """
    signature = inspect.signature(command)
    names = list(fields)
    own = signature.parameters
    old = [name for name, new in OLD_NAMES.items() if new in names and name not in own]
    made: list[inspect.Parameter] = []
    for parameter in own.values():
        if parameter.name == "given":
            made += [*map(_option, names), *map(_old_option, old)]
        else:
            made.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    @wraps(command)
    def run(**arguments: Any) -> None:
        found = {name: arguments.pop(name) for name in names}
        former = {n: value for n in old if (value := arguments.pop(n)) is not None}
        changed = [name for name in names if found[name] != _SCHEMA[name]["default"]]
        found |= modern(former | {name: found[name] for name in changed})[0]
        for name, value in former.items():
            console().note(f"{_spelled(name, value)} is now {_spelled(*renamed(name, value))}")
        texts = tuple(value for value in found.values() if isinstance(value, str))
        command(given=Given(Acting.of(**found), texts), **arguments)

    run.__signature__ = signature.replace(parameters=made)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in made} | {"return": None}
    return run


def _option(name: str) -> inspect.Parameter:
    schema = _SCHEMA[name]
    kind, default = _TYPES.get(schema.get("type", ""), str), schema["default"]
    more: dict[str, Any] = {"min": 0, "max": limits.SEED} if kind is int else {}
    flags = [f"--{name.replace('_', '-')}"]
    if kind is bool:
        flags = [f"{flags[0]}/--no-{name}"]
    if name == "emotion":
        flags.append("-e")
    option = typer.Option(
        *flags,
        help=schema["description"],
        rich_help_panel=schema.get("x-panel"),
        show_default=bool(default),
        **more,
    )
    return _parameter(name, Annotated[kind | None if default is None else kind, option], default)


def _old_option(name: str) -> inspect.Parameter:
    flag = _OLD_FLAGS.get(name, f"--{name}")
    kind = bool if name in _OLD_FLAGS else str
    return _parameter(name, Annotated[kind | None, typer.Option(flag, hidden=True)], None)


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)


def _spelled(name: str, value: Any) -> str:
    """An option as it is written."""
    option = f"--{name.replace('_', '-')}"
    if isinstance(value, bool):
        return option if value else f"--no-{name}"
    text = str(value)
    return f"{option} {text if text.isalnum() else repr(text)}"
