"""Heads on the command line."""

from typer.testing import CliRunner

from deitalk.cli import app
from rig.face import IDENTITIES
from rig.face.identity import ROLES


def test_identities_are_listed_with_their_roles():
    rows = [
        row.split("\t")
        for row in CliRunner().invoke(app, ["face", "identities"]).output.split("\n")
    ]
    rows = [row for row in rows if len(row) > 1]
    assert [row[1] for row in rows] == [person.name for person in IDENTITIES]
    assert {row[2]: row[1] for row in rows if len(row) == 3} == ROLES


def test_unknown_identity_is_an_error_before_the_take_is_made(tmp_path):
    command = ["animate", "docs/samples/amiable.flac", "--preview", "--identity", "nobody"]
    result = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "take/")])
    assert result.exit_code != 0
    assert "female, male, child" in str(result.exception) + result.output
    assert not (tmp_path / "take").exists()
