"""Code, commands, files, tests and make targets of the README and the other pages exist."""

import re
from pathlib import Path

import pytest
from typer.main import get_command

from deitalk.cli import app
from deitalk.models.folder import embedded_models

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
PAGES = [
    *(Path(name) for name in ("README.md", "MODEL_CARD.md", "configs/README.md")),
    *(page.relative_to(ROOT) for page in sorted((ROOT / "docs").glob("*.md"))),
]


def test_python_of_the_readme_runs(monkeypatch, capsys):
    if "default" not in embedded_models():
        pytest.skip("the default weights are not in this checkout")
    monkeypatch.chdir(ROOT)
    (block,) = re.findall(r"```python\n(.*?)```", README, re.S)
    exec(compile(block, "README.md", "exec"), {})
    jaw, intensity = map(float, capsys.readouterr().out.split())
    assert 0.1 < jaw < 1
    assert 0.2 < intensity < 0.9


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_linked_files_of_the_pages_exist(page):
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", (ROOT / page).read_text()):
        assert (ROOT / page).parent.joinpath(target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_commands_of_the_pages_exist_with_their_options(page):
    commands = get_command(app).commands
    text = (ROOT / page).read_text()
    for line in re.findall(r"(?:^|`|time )deitalk ([a-z][^\n#`]*)", text, re.M):
        words = line.split()
        command = commands[words[0]]
        if hasattr(command, "commands") and len(words) > 1:
            command = command.commands[words[1]]
        known = {option for parameter in command.params for option in parameter.opts}
        for word in words:
            if word.startswith("-") and len(word) > 1:
                assert word.split("=")[0] in known, f"{line}: {word}"


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_tests_of_the_pages_exist(page):
    text = (ROOT / page).read_text()
    for file, _, word in re.findall(r"pytest (tests/\w+\.py)( -k (\w+))?", text):
        assert re.search(rf"def test_\w*{word}", (ROOT / file).read_text()), f"{file} -k {word}"


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_make_targets_of_the_pages_exist(page):
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"(?:^|`)make ([a-z-]+)", (ROOT / page).read_text(), re.M):
        assert re.search(rf"^{target}:", makefile, re.M), target
