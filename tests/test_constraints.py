"""Dependencies: the tested lowest and newest sets, and which wheels of PyTorch `make setup` takes."""

import http.server
import os
import shutil
import socket
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
TORCH_INDEX = ROOT / "constraints/torch_index.py"
TOOLS = {"dev", "video", "ray", "audio2face", "fbx", "pipecat", "livekit"}
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
@pytest.mark.parametrize(("target", "option"), [("setup", "--no-compile"), ("test", "--compile")])
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
        env=os.environ | {"PATH": path, "no_proxy": "127.0.0.1"}, timeout=300,
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
        code, option, said = chosen("auto", f"http://127.0.0.1:{silent.getsockname()[1]}")
    assert (code, option) == (0, "")
    assert "does not answer" in said or "NVIDIA" in said


def test_another_wish_is_refused():
    code, option, said = chosen("gpu")
    assert code == 1 and option == "" and said == "TORCH=gpu must be auto, cpu or pypi"


STUB = """#!/bin/sh
exec {real} -c '
import runpy, sys
sys.version_info = ({version}, 1)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")' "$@"
"""
"""A program that says to be another version of Python."""


@pytest.fixture
def checkout(tmp_path):
    """Makefile and what it needs for an environment, in a folder with spaces."""
    folder = tmp_path / "my checkout"
    (folder / "constraints").mkdir(parents=True)
    for name in ("Makefile", "pyproject.toml", "constraints/environment.py"):
        shutil.copy(ROOT / name, folder / name)
    (tmp_path / "programs").mkdir()
    return folder


def stub(checkout, name, version):
    path = checkout.parent / "programs" / name
    path.write_text(STUB.format(real=sys.executable, version=version))
    path.chmod(0o755)


def environment_of(checkout, version, *, whole=True):
    (checkout / ".venv/bin").mkdir(parents=True)
    (checkout / ".venv/pyvenv.cfg").write_text(f"home = /usr\nversion = {version}\n")
    (checkout / ".venv/bin/python").symlink_to(sys.executable)
    if whole:
        (checkout / ".venv/bin/.installed").touch()
    (checkout / ".venv/old").touch()


def made(checkout, *words):
    """Whether the environment was made, and what was said."""
    path = os.pathsep.join((str(checkout.parent / "programs"), "/usr/bin", "/bin"))
    done = subprocess.run(
        ["make", ".venv/pyvenv.cfg", *words], cwd=checkout, capture_output=True, text=True,
        env={k: v for k, v in os.environ.items() if k != "PYTHON"} | {"PATH": path},
    )  # fmt: skip
    is_new = (checkout / ".venv/bin/pip").exists() and not (checkout / ".venv/old").exists()
    assert done.returncode == 0 or not is_new
    lines = [line for line in done.stderr.splitlines() if not line.startswith("make")]
    assert len(lines) <= 1, done.stderr
    return is_new, "".join(lines)


needs_make = pytest.mark.skipif(
    shutil.which("make") is None or sys.platform == "win32", reason="needs make"
)


def test_an_environment_outside_of_the_checkout_is_never_cleared(checkout, tmp_path):
    environment_of(tmp_path / "other project", "3.11.2", whole=False)
    folder = tmp_path / "other project/.venv"
    command = [sys.executable, checkout / "constraints/environment.py", folder]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 1 and "outside of this checkout: remove it" in done.stderr
    assert (folder / "old").exists() and (folder / "pyvenv.cfg").exists()


@needs_make
@pytest.mark.parametrize("version", ["3, 8", "3, 9", "3, 10", "3, 15"])
def test_a_python_that_is_not_allowed_is_refused_before_anything_is_made(checkout, version):
    stub(checkout, "python3", version)
    is_new, said = made(checkout)
    assert not is_new and not (checkout / ".venv").exists()
    assert f"(Python {version.replace(', ', '.')}) does not do; deitalk needs Python 3.11" in said
    assert "make demo PYTHON=python3.1" in said
    if version == "3, 9":
        stub(checkout, "python3.13", "3, 13")
        assert made(checkout, "PYTHON=python3.13")[0]


@needs_make
def test_without_python_the_way_out_is_named(checkout):
    is_new, said = made(checkout, "PYTHON=python3.99")
    assert not is_new and said.startswith("there is no python3.99: install Python 3.11 or later")


@needs_make
@pytest.mark.parametrize(
    ("version", "whole", "words", "is_made"),
    [
        ("3.12.1", True, [], False),
        ("3.12.1", True, ["PYTHON=python3.12"], False),
        ("3.13.1", True, ["PYTHON=python3.12"], True),  # another is asked for
        ("3.12.1", False, [], True),  # pip was interrupted
        ("3.9.18", True, [], True),
        ("3.9.18", False, ["PYTHON=python3.12"], True),
    ],
)
def test_an_environment_that_is_half_made_or_of_another_python_is_made_again(
    checkout, version, whole, words, is_made
):
    for name in ("python3", "python3.12"):
        stub(checkout, name, "3, 12")
    environment_of(checkout, version, whole=whole)
    assert made(checkout, *words)[0] == is_made


@needs_make
def test_a_whole_environment_stays_where_python3_is_too_old(checkout):
    stub(checkout, "python3", "3, 9")
    environment_of(checkout, "3.12.1")
    assert made(checkout) == (False, "") and (checkout / ".venv/old").exists()


@needs_make
def test_a_folder_that_is_no_environment_is_left_alone(checkout):
    stub(checkout, "python3", "3, 12")
    (checkout / ".venv").mkdir()
    (checkout / ".venv/thesis.doc").touch()
    assert "is no virtual environment" in made(checkout)[1]
    assert (checkout / ".venv/thesis.doc").exists()
