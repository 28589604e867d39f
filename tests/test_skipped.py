"""The option that lists skipped tests for a later run."""

import os
import subprocess
import sys
from pathlib import Path

TESTS = """
import pytest

def test_passes(): pass

@pytest.mark.parametrize("n", [1, 2])
def test_skips_by_itself(n): pytest.skip("no such program")

@pytest.mark.skipif(True, reason="no such program")
def test_skips_by_mark(): pass

@pytest.mark.xfail(reason="known")
def test_fails_as_expected(): assert False
"""


def test_skipped_tests_are_listed_and_can_be_run_again(tmp_path):
    conftest = Path(__file__).with_name("conftest.py").read_text()
    (tmp_path / "conftest.py").write_text(conftest)
    (tmp_path / "test_a.py").write_text(TESTS)
    (tmp_path / "test_b.py").write_text("import pytest\npytest.importorskip('no_such_package')\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    given = {"cwd": tmp_path, "capture_output": True, "text": True,
             "env": os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}}  # fmt: skip
    split = ("-p", "xdist", "-n", "1")
    first = subprocess.run([*command, *split, "--skipped-to=skipped"], **given)
    assert first.returncode == 0, first.stdout
    listed = (tmp_path / "skipped").read_text().split()
    assert listed == [
        "test_a.py::test_skips_by_itself",
        "test_a.py::test_skips_by_mark",
        "test_b.py",
    ]
    again = subprocess.run([*command, "@skipped"], **given)
    assert again.returncode in (0, 5), again.stdout
    assert "4 skipped" in again.stdout
