"""Commands killed at random moments, a few rounds of `tests/kill`; hundreds: ``python -m tests.kill``."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.kill.contents import check_whole, contents, hidden

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a system that forks")


def kill(command: str, rounds: int) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.kill", "--command", command, "--rounds", str(rounds)],
        cwd=ROOT, capture_output=True, text=True, timeout=900, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert f"{rounds} equal" in done.stdout and " 0 failures" in done.stdout


def test_killed_conversion_leaves_complete_files_and_succeeds_again():
    kill("convert", 4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    ["animate-new", "animate-replace", "train", "import", "fix", "corpus", "preview", "receive"],
)
def test_killed_command_leaves_complete_files_and_succeeds_again(command):
    kill(command, 3)


@pytest.mark.slow
def test_batch_killed_again_and_again_loses_and_repeats_no_line():
    done = subprocess.run(
        [sys.executable, "-m", "tests.kill.batch", "--lines", "30", "--kills", "4"],
        cwd=ROOT, capture_output=True, text=True, timeout=900, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.csv", "a,b\n1,2\n3"), ("a.csv", "a,b\n1\n"), ("a.json", '{"a": 1'), ("a.html", "<html>")],
)
def test_half_written_files_are_found(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(AssertionError, match="half-written"):
        check_whole(tmp_path)


def test_hidden_files_are_found_and_times_are_not_compared(tmp_path):
    (tmp_path / ".deitalk-manifest.json").write_text("{}")
    assert hidden(tmp_path) == []
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / ".part.csv").write_text("")
    assert hidden(tmp_path) == ["sub/.part.csv"]
    (tmp_path / "take.json").write_text('{"written": 1, "frames": 2}')
    assert contents(tmp_path) == {"take.json": {"frames": 2}}
