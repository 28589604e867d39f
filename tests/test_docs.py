"""Agreement of the pages on formats, Unreal and the papers with the code."""

import re
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

DOCS = Path(__file__).resolve().parents[1] / "docs"
ROOT = Path(__file__).resolve().parents[1]


def test_list_of_formats_equals_the_output_of_the_command():
    from deitalk.cli import convert as module

    app = typer.Typer()
    app.command()(getattr(module, "convert", module))
    printed = CliRunner().invoke(app, ["--list-formats"]).stdout
    assert printed in (DOCS / "formats.md").read_text()


@pytest.mark.parametrize("page", sorted(DOCS.glob("unreal*.md")))
def test_functions_of_the_script_exist(page):
    script = (ROOT / "rig/unreal/deitalk_unreal.py").read_text()
    for function in re.findall(r"\bd\.(\w+)\(", page.read_text()):
        assert f"def {function}(" in script


def test_names_of_the_architecture_exist_in_the_code():
    spec = spec_from_file_location("make_architecture", DOCS / "make_architecture.py")
    script = module_from_spec(spec)
    spec.loader.exec_module(script)
    for stage in script.STAGES.values():
        assert hasattr(import_module(stage.module), stage.name), stage


@pytest.mark.parametrize(("page", "equations"), [("deitalk.md", 13), ("sdfa.md", 8)])
def test_every_equation_of_a_paper_stands_beside_its_code(page, equations):
    """Rows `| paper | equation | code |`; that the code exists is tested with all pages."""
    rows = re.findall(
        r"^\| ([^|]*Eq\. [^|]*) \|.*`\w+/[\w/]+\.py`, `\w", (DOCS / page).read_text(), re.M
    )
    found = {int(n) for row in rows for n in re.findall(r"\d+", row.partition("Eq.")[2])}
    assert found >= set(range(1, equations + 1))
    assert {"`Paper silent:`", "`Deviation:`"} <= set(
        re.findall(r"`[\w ]+:`", (DOCS / page).read_text())
    )
