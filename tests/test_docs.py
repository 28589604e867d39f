"""Agreement of the pages on formats, Unreal and the papers with the code."""

import re
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


def test_counts_of_the_pages_equal_those_of_the_code():
    from rig import default_controls
    from rig.conversion.arkit import arkit_controls, raw_controls

    keyed = [c for c in default_controls().controls if c.role in ("driver", "master")]
    names = {c.ue_control: c.type for c in keyed}
    assert (len(raw_controls()), len(arkit_controls())) == (251, 61)
    assert len(names) == 162
    assert sum(kind == "Vector2D" for kind in names.values()) == 14


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
