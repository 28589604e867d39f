"""Dependencies: the tested lowest and newest sets, and which wheels of PyTorch `make setup` takes."""

import http.server
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from tests.each import each

ROOT = Path(__file__).resolve().parents[1]
TORCH_INDEX = ROOT / "constraints/torch_index.py"
TOOLS = {"dev", "video", "ray", "audio2face", "fbx"}
"""Extras of the checks, and those that need a Python, a machine or another package of their own."""


def requirements():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *(x for k, v in extras.items() if k not in TOOLS for x in v)]
    found = [Requirement(line) for line in lines]
    return [r for r in found if r.name != "deitalk"]


def pinned(name):
    """Versions by lower-case name; every line of the file is NAME==VERSION."""
    lines = (ROOT / "constraints" / name).read_text().splitlines()
    pairs = [line.split("==") for line in lines if not line.startswith("#")]
    return {name.lower().replace("_", "-"): Version(version) for name, version in pairs}


def test_lowest_set_has_the_lower_bounds_of_the_package():
    bounds = {}
    for r in requirements():
        (bound,) = [s.version for s in r.specifier if s.operator == ">="]
        assert bounds.setdefault(r.name.lower(), Version(bound)) == Version(bound), r.name
    assert bounds.items() <= pinned("lowest.txt").items()


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@each(("target", "option"), [("setup", "--no-compile"), ("test", "--compile")])
def test_bytecode_of_all_packages_is_for_tests_alone(tmp_path, target, option):
    """It is 0.4 GB, of which a user needs a tenth."""
    command = ["make", "--dry-run", target, f"VENV={tmp_path}/venv", "TORCH=pypi"]
    lines = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    installs = [line.split() for line in lines.splitlines() if "--editable" in line]
    assert installs and all(option in words for words in installs)


def test_newest_set_has_a_version_of_every_requirement_that_is_allowed():
    newest = pinned("newest.txt")
    for r in requirements():
        assert r.specifier.contains(newest[r.name.lower()]), r


@pytest.fixture
def index():
    """An index that answers, on this machine."""
    handler = http.server.SimpleHTTPRequestHandler
    with http.server.HTTPServer(("127.0.0.1", 0), type("H", (handler,), {"do_GET": _answer})) as it:
        threading.Thread(target=it.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{it.server_port}"
        it.shutdown()


def _answer(self):
    self.send_response(200)
    self.end_headers()
    self.wfile.write(b"torch")


def chosen(*words, path=""):
    done = subprocess.run(
        [sys.executable, TORCH_INDEX, *words], capture_output=True, text=True,
        env=os.environ | {"PATH": path, "no_proxy": "127.0.0.1"}, timeout=60,
    )  # fmt: skip
    return done.returncode, done.stdout.strip(), done.stderr.strip()


@pytest.mark.skipif(Path("/proc/driver/nvidia/version").exists(), reason="has an NVIDIA GPU")
def test_machines_without_an_nvidia_gpu_take_the_wheels_of_the_cpu(index):
    assert chosen("auto", index)[:2] == (0, f"--extra-index-url {index}")
    assert chosen("pypi", index)[:2] == (0, "")


def test_machines_with_an_nvidia_gpu_take_the_ordinary_wheels(index, tmp_path):
    (tmp_path / "nvidia-smi").write_text("#!/bin/sh\n")
    (tmp_path / "nvidia-smi").chmod(0o755)
    code, option, said = chosen("auto", index, path=str(tmp_path))
    assert (code, option) == (0, "") and "NVIDIA GPU" in said
    assert chosen("cpu", index, path=str(tmp_path))[1] == f"--extra-index-url {index}"


def test_an_index_that_never_answers_is_given_up_within_seconds():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        began = time.monotonic()
        code, option, said = chosen("auto", f"http://127.0.0.1:{silent.getsockname()[1]}")
        assert time.monotonic() - began < 15
    assert (code, option) == (0, "")
    assert "does not answer" in said or "NVIDIA" in said


def test_another_wish_is_refused():
    code, option, said = chosen("gpu")
    assert code == 1 and option == "" and said == "TORCH=gpu must be auto, cpu or pypi"
