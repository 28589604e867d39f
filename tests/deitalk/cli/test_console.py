"""Output of commands: plain text for any file name, and progress for logs."""

import json
import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from deitalk.cli import app
from deitalk.cli.console import console, emit, emit_json, name_option
from deitalk.errors import DeitalkError
from rig import default_controls, rest_curves, write_curves
from rig.errors import RigError, as_line, decodable_values

ROOT = Path(__file__).resolve().parents[3]
HOSTILE = ["[red]", "br[/b]", ":smile:", "[link=file:///]x", "\\[bold]"]


@pytest.mark.parametrize("name", HOSTILE)
def test_names_that_look_like_markup_are_printed_unchanged(name, capsys):
    console().print(f"{name}: 3 frames")
    console().note(name)
    emit(name)
    printed = capsys.readouterr()
    assert printed.err == f"{name}: 3 frames\nnote: {name}\n"
    assert printed.out == f"{name}\n"


@pytest.mark.parametrize(
    ("name", "printed"),
    [
        ("caf\udce9.wav", r"caf\xe9.wav"),
        ("\ud800", r"\ud800"),
        ("café 日本.wav", "café 日本.wav"),
        ("two\nlines", r"two\nlines"),
        ("\x1b[31mred", r"\x1b[31mred"),
        ("a\u2028b", r"a\u2028b"),
    ],
)
def test_one_line_escapes_unprintable_characters(name, printed):
    assert as_line(name) == printed
    assert len(as_line(name).encode().splitlines()) == 1


def test_emit_json_writes_names_that_are_no_utf8(capsys):
    emit_json({"\udcff": ["\udcff", ("é", 1.5, None)]})
    assert json.loads(capsys.readouterr().out) == {r"\xff": [r"\xff", ["é", 1.5, None]]}
    assert decodable_values({"a": True}) == {"a": True}


def test_commands_print_through_the_console_only():
    for path in (ROOT / "deitalk/cli").glob("*.py"):
        text = path.read_text()
        if path.name != "console.py":
            assert not re.search(r"typer\.echo|(?<![.\w])print\(|import rich|from rich", text), path


def test_help_has_no_markup():
    for command in all_commands(get_command(app)):
        for text in [command.help, *(getattr(p, "help", "") for p in command.params)]:
            assert "[" not in (text or ""), f"{command.name}: {text}"


def all_commands(command):
    """A command and those below it."""
    below = getattr(command, "commands", {}).values()
    return [command, *(inner for one in below for inner in all_commands(one))]


def run(folder, *arguments, **environment):
    return subprocess.run(
        [sys.executable, "-m", "deitalk", *arguments],
        capture_output=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        timeout=120,
    )


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such file names")
def test_convert_takes_file_names_that_are_no_utf8(tmp_path):
    source, target = os.path.join(os.fsencode(tmp_path), b"\xff.csv"), b"t\xfe[b].json"
    write_curves(tmp_path / "c.csv", rest_curves(3, controls=default_controls()))
    os.rename(tmp_path / "c.csv", source)
    done = run(tmp_path, "convert", source, target, LC_ALL="C", PYTHONUTF8="0")
    assert done.returncode == 0, done.stderr
    assert done.stderr == rb"t\xfe[b].json: json, 3 frames at 30 fps" + b"\n"
    done = run(tmp_path, "convert", source, target, LC_ALL="C.UTF-8")
    assert done.returncode == 1 and done.stderr.startswith(rb"deitalk: t\xfe[b].json exists")


@pytest.mark.parametrize(
    ("message", "parameter", "printed"),
    [
        ("a.csv exists, set `force=True`", "force", "a.csv exists, set --force"),
        ("no rate; give `fps`", "fps", "no rate; give --fps"),
        ("no GPU; give `backend=software`", "backend", "no GPU; give --backend software"),
        ("give `start_from`", "start_from", "give --start-from"),
        ("`fps` of `x`.csv; see `deitalk -h`", "x.csv", "`fps` of `x`.csv; see `deitalk -h`"),
        ("set `force=True`", "", "set `force=True`"),
    ],
)
def test_name_option_replaces_the_named_parameter_only(message, parameter, printed):
    for kind in (RigError, DeitalkError):
        assert name_option(kind(message, parameter=parameter)) == printed


def test_errors_keep_their_parameter_across_processes():
    error = pickle.loads(pickle.dumps(RigError("exists; set `force=True`", parameter="force")))
    assert name_option(error) == "exists; set --force"
