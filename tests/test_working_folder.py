"""Nothing that lies in the working folder is executed or read unasked, whatever its name.

Every command and the service run in a folder that holds a module of every name that Python could
look for; each leaves a mark when it is executed.
"""

import json
import os
import pkgutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.api.conftest import wav
from tests.api.server import Server, free_port, stop, wait_until
from tests.dataset import write_dataset
from tests.takes import write_live_link

ROOT = Path(__file__).resolve().parents[1]
NAMES = {
    *sys.stdlib_module_names,
    *(module.name for module in pkgutil.iter_modules()),
    *("rig", "deitalk", "api", "sitecustomize", "usercustomize", "conftest", "bpy", "ray"),
} - {"__main__"}
SETTINGS = {
    ".env": "DEITALK_PORT=1\nPYTHONSTARTUP=struct.py\n",
    "matplotlibrc": "savefig.dpi: 13\nbackend: module://struct\n",
    "alembic.ini": "[alembic]\nscript_location = struct\n",
    "pyproject.toml": "[tool.deitalk]\nport = 1\n",
    "pyvenv.cfg": "home = /nowhere\n",
    "service.yaml": "port: 1\n",
    "settings.yaml": "port: 1\n",
}
PROGRAM = """
import json, sys
from deitalk.cli import app, main
if __name__ == "__main__":
    for words in json.loads(sys.argv[1]):
        sys.argv = ["deitalk", *words]
        try:
            if words[0] in ("train", "corpus"):
                from deitalk.research.cli import app
            main(app)
        except SystemExit as ended:
            print(json.dumps([words, ended.code]), flush=True)
"""
"""As the installed program: a script outside the working folder."""


@pytest.fixture
def folder(tmp_path):
    """A working folder with a file of every name, and recordings."""
    here = tmp_path / "here"
    here.mkdir()
    for name in NAMES:
        text = f"with open({str(tmp_path / 'executed')!r}, 'a') as f:\n    f.write('{name}\\n')\n"
        (here / f"{name}.py").write_text(text)
    for name, text in SETTINGS.items():
        (here / name).write_text(text)
    for name in ("default", "mel", "live", "happy", "arkit", "cpu"):  # names of the product
        (here / name).mkdir()
    (here / "speech.wav").write_bytes(wav(0.8))
    (tmp_path / "program.py").write_text(PROGRAM)
    return here


def environment(**more):
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("DEITALK_", "PYTHON"))}
    return kept | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"} | more


def executed(folder):
    mark = folder.parent / "executed"
    return sorted(set(mark.read_text().split())) if mark.exists() else []


def ran(folder, *commands, **more):
    """Exit codes of commands that run one after another."""
    done = subprocess.run(
        [sys.executable, folder.parent / "program.py", json.dumps(commands)],
        cwd=folder, env=environment(**more), capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert executed(folder) == [], done.stderr
    codes = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[[")]
    assert [words for words, _ in codes] == [list(words) for words in commands], done.stderr
    return [(words[0], code) for words, code in codes if code], done.stderr


ANIMATE = ("animate", "speech.wav", "-e", "happy")
TRAIN = ("--set", "train.steps=2", "--set", "train.workers=2")
STARTING = [
    (*ANIMATE, "-o", "take/"),
    (*ANIMATE, "--backend", "onnx", "-o", "onnx.csv"),
    ("batch", "lines", "--workers", "2", "-o", "out"),
    ("train", str(ROOT / "configs/tiny.yaml"), "--data", "words", *TRAIN, "-o", "run"),
    ("corpus", "build", "--hours", "0.001", "--workers", "2", "-o", "corpus"),
]
"""Commands that start other processes, after one that a take is made by."""
OTHERS = [
    (*ANIMATE, "--model", "mel", "--device", "cpu", "-o", "curves.png"),
    (*ANIMATE, "--words", "and now the news", "-o", "words.csv"),
    ("preview", "take/", "-o", "review.mp4"),
    ("convert", "take/", "shapes.csv", "--to", "livelink"),
    ("convert", "take/", "shapes.glb"),
    ("convert", "take/", "again.npz", "--rig", "arkit"),
    ("validate", "take/"),
    ("face", "identities"),
    ("face", "controls"),
    ("face", "export", "-o", "head.glb"),
    ("retarget", "take/", "--mesh", "head.glb", "-o", "own.glb"),
    ("live", "take/", "--port", "9"),
    ("live", "speech.wav", "--port", "9"),
    ("install", "unreal", "game"),
    ("install", "blender"),
    ("serve", "openapi"),
    ("serve", "key", "farm"),
    ("model", "info", "default"),
    ("data", "import", "takes", *"--actor anna -e happy --split-by none -o data".split()),
    ("data", "check", "words"),
    ("data", "voice", "speech.wav", "-o", "anna.json"),
    ("finetune", "words", *TRAIN, "-o", "tuned"),
]


@pytest.mark.parametrize(
    "commands", [STARTING, pytest.param([STARTING[0], *OTHERS], marks=pytest.mark.slow)]
)
def test_commands_execute_nothing_of_the_working_folder(folder, tmp_path, commands):
    (folder / "game").mkdir()
    (folder / "game/Game.uproject").write_text("{}")
    (folder / "lines").mkdir()
    for name in "abc":
        (folder / f"lines/{name}.wav").write_bytes(wav(0.5))
    for i in range(3):
        write_live_link(folder / f"takes/speech_{i}_anna.csv", 3.0)
    write_dataset(folder / "words")
    failed, said = ran(folder, *commands, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert not failed, said


def test_service_executes_nothing_of_the_working_folder(folder, tmp_path):
    port = free_port()
    given = {"PORT": port, "DATA": tmp_path / "data", "WORKERS": 2}
    variables = {f"DEITALK_{name}": str(value) for name, value in given.items()}
    log = tmp_path / "log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, folder.parent / "program.py", '[["serve"]]'],
            cwd=folder, env=environment(**variables), stdout=out, stderr=out,
        )  # fmt: skip
    server = Server(f"http://127.0.0.1:{port}", process, log)
    try:
        wait_until(server, "/readyz")
        with server.client() as client:
            assert client.post("/v1/animations?format=csv", content=wav(1.0)).is_success
            job = client.post("/v1/jobs", files={"recording": ("a.wav", wav(1.0))}).json()
            while job["status"] in ("queued", "running"):
                time.sleep(0.2)  # there is a limit of requests a minute
                job = client.get(f"/v1/jobs/{job['id']}").json()
            assert job["status"] == "done"
    finally:
        stop(server)
    assert executed(folder) == []


def test_python_m_imports_nothing_from_there_once_the_package_runs(folder):
    """Python itself looks there first for the package and for what this needs to begin."""
    for path in folder.glob("*.py"):
        if path.stem in {*sys.stdlib_module_names, "rig", "deitalk"}:
            path.unlink()
    command = [sys.executable, "-m", "deitalk", *ANIMATE, "-o", "curves.csv"]
    subprocess.run(command, cwd=folder, env=environment(), check=True)
    assert executed(folder) == []


def test_unreal_starts_python_without_the_working_folder(folder):
    (folder / "game").mkdir()
    (folder / "game/Game.uproject").write_text("{}")
    ran(folder, ("install", "unreal", "game"))
    (settings,) = folder.rglob("deitalk_settings.json")
    command = json.loads(settings.read_text())["command"]
    subprocess.run([*command, *ANIMATE, "-o", "take/"], cwd=folder, env=environment(), check=True)
    assert executed(folder) == []


IN_PYTHON = """
import os, sys
from deitalk import animate_batch
if __name__ == "__main__":
    report = animate_batch("lines", "out", workers=2)
    assert report.counts["done"] == 2, report
    assert "PYTHONSAFEPATH" not in os.environ
"""


def test_processes_of_the_python_interface_execute_nothing_of_the_working_folder(folder):
    (folder / "lines").mkdir()
    for name in "ab":
        (folder / f"lines/{name}.wav").write_bytes(wav(0.5))
    (folder.parent / "own.py").write_text(IN_PYTHON)
    command = [sys.executable, folder.parent / "own.py"]
    subprocess.run(command, cwd=folder, env=environment(), check=True)
    assert executed(folder) == []


def test_pictures_are_the_same_beside_settings_of_matplotlib(tmp_path):
    pictures = []
    for folder, text in (("plain", ""), ("other", "axes.facecolor: red\nsavefig.dpi: 13\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "matplotlibrc").write_text(text)
        code = (
            "from pathlib import Path\nfrom deitalk.evaluation.figures import drawing\n"
            "with drawing(Path('x.png'), (2, 2)) as figure:\n    figure.subplots()"
        )
        command = [sys.executable, "-P", "-c", code]
        subprocess.run(command, cwd=tmp_path / folder, env=environment(), check=True)
        pictures.append((tmp_path / folder / "x.png").read_bytes())
    assert pictures[0] == pictures[1]
