"""Code, commands, files, names, tests and make targets of the README and the other pages exist."""

import ast
import re
import tomllib
from pathlib import Path

import pytest
from typer.main import get_command

from deitalk.models.folder import embedded_models
from tests.command import commands_of

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
PAGES = [
    *(Path(name) for name in ("README.md", "CHANGELOG.md", "MODEL_CARD.md", "configs/README.md")),
    *(page.relative_to(ROOT) for page in sorted((ROOT / "docs").rglob("*.md"))),
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


def anchors(text):
    """Anchors of the headings of a page, as GitHub forms them."""
    headings = re.findall(r"^#+ (.+)$", prose(text), re.M)
    return {re.sub(r"[^\w\- ]", "", heading).lower().replace(" ", "-") for heading in headings}


def prose(text):
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)


@pytest.mark.parametrize("page", PAGES)
def test_linked_files_and_headings_of_the_pages_exist(page):
    text = prose((ROOT / page).read_text())
    for target, anchor in re.findall(r"\]\((?!http)([^)#]*)#?([^)]*)\)", text):
        linked = (ROOT / page).parent / target if target else ROOT / page
        assert linked.exists(), target
        assert not anchor or anchor in anchors(linked.read_text()), f"{target}#{anchor}"


@pytest.mark.parametrize("page", PAGES)
def test_paths_of_the_pages_exist(page):
    """A path in backticks, and the names that are listed beside a Python file."""
    text = (ROOT / page).read_text()
    for path, names in re.findall(
        r"`((?:rig|deitalk|api|docs|tests|configs)/[\w./-]*)`((?:, `[\w.]+`)*)", text
    ):
        assert (ROOT / path).exists(), path
        for name in re.findall(r"`(\w[\w.]*)`", names) if path.endswith(".py") else ():
            scope = ast.parse((ROOT / path).read_text()).body
            for part in name.split("."):
                found = [node for node in scope if part in defined(node)]
                if not found and name.endswith(".py"):
                    break
                assert found, f"{path}: {name}"
                scope = getattr(found[0], "body", [])


def defined(node):
    """Names that a statement defines."""
    targets = [*getattr(node, "targets", ()), getattr(node, "target", None)]
    return {getattr(node, "name", None), *(getattr(target, "id", None) for target in targets)}


@pytest.mark.parametrize("page", PAGES)
def test_extras_of_the_pages_exist(page):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for extras in re.findall(r"deitalk\[([\w,]+)\]", (ROOT / page).read_text()):
        assert set(extras.split(",")) <= set(project["optional-dependencies"]), extras


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_the_pages_exist_with_their_options(page):
    text = (ROOT / page).read_text()
    for line in re.findall(
        r"(?:^|`|time )(?:deitalk|python -m deitalk\.research) ([a-z][^\n#`]*)", text, re.M
    ):
        words = line.split()
        command = get_command(commands_of(words[0])).commands[words[0]]
        if hasattr(command, "commands") and words[1:] and words[1][0] != "-":
            command = command.commands[words[1]]
        known = {option for parameter in command.params for option in parameter.opts}
        for word in words:
            if word.startswith("-") and len(word) > 1:
                assert word.split("=")[0] in known, f"{line}: {word}"


@pytest.mark.parametrize("page", PAGES)
def test_tests_of_the_pages_exist(page):
    text = (ROOT / page).read_text()
    for file, _, word in re.findall(r"pytest (tests/\w+\.py)( -k (\w+))?", text):
        assert re.search(rf"def test_\w*{word}", (ROOT / file).read_text()), f"{file} -k {word}"


@pytest.mark.parametrize("page", PAGES)
def test_make_targets_of_the_pages_exist(page):
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"(?:^|`)make ([a-z-]+)", (ROOT / page).read_text(), re.M):
        assert re.search(rf"^{target}:", makefile, re.M), target


@pytest.mark.parametrize("page", PAGES)
def test_modules_that_pages_run_exist(page):
    text = (ROOT / page).read_text()
    for module in re.findall(r"python -m ((?:rig|deitalk|tests)[\w.]*)", text):
        path = ROOT.joinpath(*module.split("."))
        assert path.is_dir() or path.with_suffix(".py").is_file(), module
