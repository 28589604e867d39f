"""Every option of every command with invalid values: one line, before any work."""

import functools
import inspect
import sys
from pathlib import Path
from typing import get_args

import pytest
from typer.main import get_command

from deitalk.audio.load import write_wav
from deitalk.cli import app, main
from deitalk.errors import DeitalkError
from deitalk.models.device import check_device, require_device
from rig import default_controls, rest_curves, write_curves
from tests.command import ran

NUMBERS = ["nan", "inf", "-inf", "", "x"]
HUGE = str(10**30)


def functions(group, *path):
    """Every command as (words of the command line, function)."""
    if path and (own := group.registered_callback) and own.invoke_without_command:
        yield path, own.callback
    for command in group.registered_commands:
        yield (*path, command.name or command.callback.__name__), command.callback
    for below in group.registered_groups:
        yield from functions(below.typer_instance, *path, below.name)


@functools.cache
def command_of(path):
    """The command object of typer."""
    found = get_command(app)
    for word in path:
        found = found.commands[word]
    return found


def rows():
    """Every parameter with a value: (words of the command line, name, option or None, types)."""
    for path, function in functions(app):
        made = {parameter.name: parameter for parameter in command_of(path).params}
        for name, parameter in inspect.signature(function).parameters.items():
            if not get_args(parameter.annotation):
                continue  # the context
            kind, info = get_args(parameter.annotation)[:2]
            kinds = {kind, *get_args(kind), *(k for one in get_args(kind) for k in get_args(one))}
            if bool not in kinds:
                is_option = type(info).__name__ == "OptionInfo"
                option = max(made[name].opts, key=len) if is_option else None
                yield " ".join(path), name, option, kinds


ROWS = list(rows())
FLOATS = [row[:3] for row in ROWS if float in row[3]]
INTEGERS = [row[:3] for row in ROWS if int in row[3]]
PATHS = [row[:3] for row in ROWS if Path in row[3]]


@pytest.fixture
def refused(monkeypatch, capsys, tmp_path):
    """Run a command that must end with one line on stderr; return exit code and line."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        there = {*tmp_path.iterdir()}
        monkeypatch.setattr(sys, "argv", ["deitalk", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1, lines
        assert lines[0].startswith("deitalk: ")
        assert {*tmp_path.iterdir()} == there, "something was written"
        return ended.value.code, lines[0]

    return run


def typed(command, option, value):
    """A command line with the option, and a missing file for every argument."""
    arguments = [
        "no-such-file"
        for p in command_of(tuple(command.split())).params
        if not p.opts[0].startswith("-")
    ]
    return [*command.split(), *arguments, f"{option}={value}"]


def test_table_has_all_options():
    named = {(command, option) for command, _, option, _ in ROWS}
    assert {("animate", "--fps"), ("convert", "--gain"), ("serve", "--port")} <= named
    assert len(FLOATS) >= 15 and len(INTEGERS) >= 15 and len(PATHS) >= 30


def test_fractions_reject_numbers_that_are_not_finite(refused):
    for command, _, option in FLOATS:
        for value in NUMBERS:
            code, line = refused(*typed(command, option, value))
            assert code == 2 and option in line, (command, option, value, line)


def test_whole_numbers_reject_values_out_of_range(refused):
    for command, name, option in INTEGERS:
        for value in ("nan", "", "1.5", HUGE, f"-{HUGE}"):
            code, line = refused(*typed(command, option, value))
            where = (command, option, value, line)
            assert code in (1, 2) and (option in line or "port" in line), where
            if name in ("seed", "threads", "workers"):
                assert code == 2, where


def test_paths_reject_the_empty_name(refused):
    for command, name, option in PATHS:
        line = typed(command, option, "")
        if option is None:
            places = [
                p.name for p in command_of(tuple(command.split())).params if p.opts[0][0] != "-"
            ]
            empty = ["" if place == name else "no-such-file" for place in places]
            line = [*command.split(), *empty]
        code, message = refused(*line)
        where = (command, option, message)
        assert code == 2 and "an empty path" in message, where
        assert (option or name) in message.lower(), where


def test_devices_reject_unknown_names(refused):
    commands = [command for command, name, _, _ in ROWS if name == "device"]
    assert {"animate", "batch"} <= {*commands}
    for command in commands:
        for device in ("meta", "mps:7", "cuda:", "cuda:-1", "gpu", "", "[red]", "CPU "):
            code, line = refused(*typed(command, "--device", device))
            assert code == 2 and repr(device) in line and "cuda:N" in line, (command, device, line)


def test_missing_devices_are_refused():
    import torch

    assert require_device("cpu") == check_device("cpu") == "cpu"
    with pytest.raises(DeitalkError, match=r"'cuda:987'.*CUDA device"):
        require_device("cuda:987")
    if not torch.backends.mps.is_available():
        with pytest.raises(DeitalkError, match="no Metal"):
            require_device("mps")
    with pytest.raises(DeitalkError, match="unknown"):
        check_device(None)


def test_convert_rejects_hostile_numbers_and_names(refused, tmp_path):
    write_curves(tmp_path / "c.csv", rest_curves(5, controls=default_controls()))
    for option, value, expected in (
        ("--start", "1e308", "time 1e+308 s"),
        ("--end", "1e308", "time 1e+308 s"),
        ("--smooth", "1e308", "up to 60 s"),
        ("--smooth", "-1", "0 or more"),
        ("--gain", "brow=nan", "NAME=NUMBER"),
        ("--gain", "brow=1e308", "within ±1e+06"),
        ("--offset", "brow=-1e308", "within ±1e+06"),
        ("--gain", "[red]=1", "[red]"),
        ("--fps", "0", "fps=0"),
        ("--rig", "\udcff", r"\udcff"),
        ("--to", "a\nb", r"a\nb"),
    ):
        code, line = refused("convert", "c.csv", "out.json", option, value)
        assert code == 1 and expected in line, line


def test_live_rejects_hostile_addresses(refused, tmp_path):
    write_curves(tmp_path / "c.csv", rest_curves(5, controls=default_controls()))
    for option, value, expected in (
        ("--host", "\udcff", "cannot send to"),
        ("--host", "a" * 70, "cannot send to"),
        ("--host", "..", "cannot send to"),
        ("--host", "no-such-host.invalid", "cannot send to no-such-host.invalid"),
        ("--subject", "\udcff", "is no UTF-8"),
        ("--subject", "x" * 10_000, "subject has 10000 bytes"),
        ("--port", "65536", "1 to 65535"),
        ("--port", "0", "1 to 65535"),
        ("--port", HUGE, "1 to 65535"),
        ("--protocol", "[red]", "[red]"),
        ("--fps", "-1", "fps=-1"),
        ("--rig", "face", "--rig 'face' is unknown"),
        ("--emotion", "furious", "unknown emotion 'furious'"),
        ("--intensity", "-1", "0 to 4"),
        ("--start-signal", "no-such-host.invalid:8000", "cannot send to"),
    ):
        code, line = refused("live", "c.csv", option, value)
        assert code in (1, 2) and expected in line, line
    for host in ("\udcff", "a" * 70, "no host"):
        code, line = refused("live", "--record", "take.csv", "--host", host)
        assert code == 1 and "cannot listen on" in line, line


@pytest.mark.parametrize("name", ["Scene 1.2.csv", "a.b.c.json", "take.v2"])
def test_preview_keeps_the_name_without_its_suffix(tmp_path, name, monkeypatch):
    source, targets = tmp_path / name, []
    source.parent.joinpath("take.v2").mkdir()
    write_wav(tmp_path / "take.v2" / "audio.wav", [0.0] * 1600)
    write_curves(source / "curves.json" if name == "take.v2" else source, rest_curves(3))
    monkeypatch.setattr(
        "deitalk.preview.page.render_page", lambda shown, target, **given: targets.append(target)
    )
    ran("preview", source)
    assert targets == [
        source / "preview.html" if name == "take.v2" else source.with_suffix(".html")
    ]
