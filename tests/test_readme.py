"""The README says what is so: its Python runs, its files and commands exist."""

import re
from pathlib import Path

import pytest
from typer.main import get_command

from deitalk.checkpoint import embedded_models
from deitalk.cli import app

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()


def test_python_of_the_readme_runs(monkeypatch, capsys):
    if "default" not in embedded_models():
        pytest.skip("the default weights are not in this checkout")
    monkeypatch.chdir(ROOT)
    (block,) = re.findall(r"```python\n(.*?)```", README, re.S)
    exec(compile(block, "README.md", "exec"), {})
    jaw, intensity = map(float, capsys.readouterr().out.split())
    assert 0.1 < jaw < 1
    assert 0.2 < intensity < 0.9


def test_files_the_readme_links_to_exist():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_commands_the_readme_types_exist_with_their_options():
    commands = get_command(app).commands
    for line in re.findall(r"^deitalk ([^\n#]*)", README, re.M):
        words = line.split()
        command = commands[words[0]]
        if hasattr(command, "commands"):
            command = command.commands[words[1]]
        known = {option for parameter in command.params for option in parameter.opts}
        for word in words:
            if word.startswith("-") and len(word) > 1:
                assert word.split("=")[0] in known, f"{line}: {word}"


def test_make_targets_the_readme_names_exist():
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^make ([a-z-]+)", README, re.M):
        assert re.search(rf"^{target}:", makefile, re.M), target
