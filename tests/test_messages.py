"""Error messages: one short line; the library names parameters, the command line options."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from deitalk.errors import DeitalkError
from rig.errors import RigError
from rig.limits import MESSAGE_CHARACTERS

ROOT = Path(__file__).resolve().parents[1]
OPTION = re.compile(r"(?:^|[\s`'\"(])--[a-z]")
PARSES_OPTIONS = ("cli", "unreal", "web")
"""Folders of the command line, the script inside Unreal and the build of the page."""


def texts(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Texts within `raise` statements, and their places."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise):
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield part.lineno, part.value


def options(source: str) -> list[str]:
    """Options in messages, except those of a pip command."""
    return [
        f"{line}: {text}"
        for line, text in texts(ast.parse(source))
        if OPTION.search(text) and "pip install" not in text
    ]


def test_library_messages_name_no_option():
    wrong = [
        f"{path.relative_to(ROOT)}:{found}"
        for package in ("rig", "deitalk")
        for path in sorted((ROOT / package).rglob("*.py"))
        if not {*path.relative_to(ROOT).parts} & {*PARSES_OPTIONS} and path.stem != "__main__"
        for found in options(path.read_text(encoding="utf-8"))
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("text", ["\0" * 1000, "a\n" * 300, "\udc80" * 400, "x" * 10_000])
def test_message_with_escapes_stays_within_its_limit(text):
    for kind in (RigError, DeitalkError):
        message = str(kind(f"name {text} end"))
        assert len(message) <= MESSAGE_CHARACTERS
        assert "\n" not in message and "\0" not in message
        assert message.startswith("name ") and message.endswith(" end")
