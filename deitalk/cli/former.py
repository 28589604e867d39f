"""Names of commands before this release: each still works, and prints the line of today.

To be removed with the next release, as is `deitalk.cli.animate.suggest`.
"""

import shlex
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from typer.core import TyperGroup

from deitalk.cli.console import console


class Former(NamedTuple):
    """What a command is called today: its words, options to add, and renamed options."""

    words: tuple[str, ...]
    added: tuple[str, ...] = ()
    options: Mapping[str, tuple[str, ...]] = MappingProxyType({})


FORMER = {
    ("mesh",): Former(("animate",), ("--vertices",), {"--speaker": ("--identity",)}),
    ("plot",): Former(("animate",)),
    ("livelink", "send"): Former(("live",), ("--model", "default")),
    ("livelink", "replay"): Former(("live",)),
    ("livelink", "receive"): Former(
        ("live",),
        options={"--out": ("--record",), "-o": ("--record",), "--idle": ("--timeout",)},
    ),
    ("controls",): Former(("face", "controls")),
    ("unreal",): Former(("install", "unreal")),
    ("blender",): Former(("install", "blender")),
    ("studio",): Former(("serve",), ("--open",)),
    ("openapi",): Former(("serve", "openapi")),
    ("key",): Former(("serve", "key")),
    ("actor", "build"): Former(("data", "voice")),
    ("benchmark",): Former(("evaluate",), ("--speed",), {"--model": ()}),
}


def today(arguments: list[str]) -> list[str]:
    """A command line with the names of today."""
    found = next((words for words in FORMER if tuple(arguments[: len(words)]) == words), None)
    if found is None:
        return arguments
    former = FORMER[found]
    rest = [part for word in arguments[len(found) :] for part in _renamed(word, former.options)]
    return [*former.words, *former.added, *rest]


def _renamed(word: str, options: Mapping[str, tuple[str, ...]]) -> list[str]:
    name, equals, value = word.partition("=")
    if word[:2] in options:  # a short option, alone or with its value
        return [*options[word[:2]], *filter(None, [word[2:]])]
    if name not in options:
        return [word]
    return [*options[name], *([value] if equals else [])]


class Commands(TyperGroup):
    """The commands, also under their former names."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As that of typer, of the line of today."""
        if (line := today(args)) is not args:
            console().note(f"this command is now: {shlex.join(('deitalk', *line))}")
        return super().parse_args(ctx, line)
