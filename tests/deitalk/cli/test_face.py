"""Heads on the command line."""

import pytest
import soundfile
from typer.testing import CliRunner

from deitalk.cli import app
from deitalk.research.evaluation.benchmark_curves import speechlike
from rig.face import IDENTITIES
from rig.face.identity import ROLES
from tests.command import ran


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


@pytest.mark.parametrize("out", ["take/", "a.csv"])
def test_identity_is_refused_where_no_head_is_written(tmp_path, out):
    command = ["animate", "docs/samples/amiable.flac", "--identity", "child"]
    result = CliRunner().invoke(app, [*command, "-o", f"{tmp_path}/{out}"])
    assert result.exit_code != 0
    assert "usd" in (error := str(result.exception)) and "\n" not in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.csv", "--versus", "b.csv", "-o", "x.mp4"], "--versus is of a page"),
        (["a.csv", "--view", "eyes", "-o", "x.html"], "--view of a video"),
        (["a.wav"], "is a recording"),
    ],
)
def test_what_a_preview_cannot_show_is_refused(arguments, message):
    assert message in str(CliRunner().invoke(app, ["preview", *arguments]).exception)


def test_animate_writes_the_given_head(tmp_path, monkeypatch):
    def write(path, curves, identity=0):
        path.write_text(identity.name)

    monkeypatch.setattr("rig.formats.usd.write", write)
    soundfile.write(tmp_path / "a.wav", speechlike(1.0), 16_000)
    command = ["animate", f"{tmp_path}/a.wav", "-o", f"{tmp_path}/a.usda", "--identity", "child"]
    ran(*command)
    assert (tmp_path / "a.usda").read_text() == "Kaya"
