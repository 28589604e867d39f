"""Error messages of the library name parameters; options belong to the command line."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OPTION = re.compile(r"(?:^|[\s`'\"(])--[a-z]")
PARSES_OPTIONS = ("cli", "unreal", "web")
"""Folders of the command line, the script inside Unreal and the build of the page."""


def texts(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Texts within `raise` statements, and where they stand."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise):
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield part.lineno, part.value


def options(source: str) -> list[str]:
    """Options that messages name, but for those of a pip command."""
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


def test_options_are_found_in_messages():
    source = "raise A(f'{x} exists; ' 'give --force')\nraise B('pip install --user a')\nx = ' --a'"
    assert [found.partition(":")[0] for found in options(source)] == ["1"]
