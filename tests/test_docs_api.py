"""Agreement of docs/api.md with the docstrings, and the exported types."""

import importlib
import importlib.util
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
import soundfile

import deitalk
import rig
from deitalk.models.folder import embedded_models

ROOT = Path(__file__).resolve().parents[1]
PUBLIC = [(package, name) for package in (deitalk, rig) for name in package.__all__]


@pytest.fixture(scope="module")
def maker():
    path = ROOT / "docs/make_api.py"
    module = importlib.util.module_from_spec(
        spec := importlib.util.spec_from_file_location("m", path)
    )
    spec.loader.exec_module(module)
    return module


def test_api_page_is_current(maker):
    written = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    assert written == maker.page(), "run `make docs`"


@pytest.mark.skipif("default" not in embedded_models(), reason="needs the embedded weights")
def test_python_of_the_page_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "docs/samples").mkdir(parents=True)
    sound, rate = soundfile.read(ROOT / "docs/samples/promise.flac")
    soundfile.write(tmp_path / "docs/samples/promise.flac", sound[: rate // 2], rate)
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/api.md").read_text(), re.S)
    for _ in range(2):  # after `make demo` the folder take/ is there
        exec(compile(block, "api.md", "exec"), {})
        assert capsys.readouterr().out == "(185,)\n"
    assert (tmp_path / "take/take.json").is_file() and (tmp_path / "face.glb").is_file()


def test_schema_of_the_page_is_current(maker):
    assert maker.SCHEMA.read_text(encoding="utf-8") == maker.acting_schema(), "run `make docs`"


def test_api_page_has_every_public_name_and_error(maker):
    page = maker.page()
    for _, name in PUBLIC:
        assert name == "__version__" or re.search(rf"^\| `{name}[`(]", page, re.M), name
    for field in deitalk.Acting.model_fields:
        assert f"| `{field}` |" in page, field
    for module in maker.ERRORS:
        for name, kind in vars(importlib.import_module(module)).items():
            if inspect.isclass(kind) and kind.__module__ == module:
                assert f"─ {name}" in page, name


@pytest.mark.parametrize(
    ("package", "name"), [pair for pair in PUBLIC if inspect.isfunction(getattr(*pair))]
)
def test_signatures_name_the_parameters(maker, package, name):
    value = getattr(package, name)
    written = maker.signature(value)
    names = re.findall(r"\w+", written.partition("(")[2])
    assert written.startswith(f"{name}(") and names == list(inspect.signature(value).parameters)


USER = """
from pathlib import Path
import numpy as np
import deitalk
from rig import RigCurves, read_curves

performance = deitalk.animate(np.zeros(16000, np.float32), {"happy": 0.7}, sample_rate=16000)
curves: RigCurves = performance.curves
where: Path = performance.save("take/", fps=60, force=True)
share: float = performance.mean_applied_intensity
deitalk.animate_mesh("a.wav", "happy", speaker=1).save("face.glb")
read_curves("take/curves.csv").resample(24)
reveal_type(performance)
deitalk.animate("a.wav", track="loud")
"""


@pytest.mark.slow
def test_type_hints_are_exported(tmp_path):
    pytest.importorskip("mypy")
    for package in ("deitalk", "rig"):
        assert (ROOT / package / "py.typed").is_file()
    (tmp_path / "user.py").write_text(USER)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--follow-imports=silent", "--ignore-missing-imports",
         "--cache-dir", str(tmp_path / "cache"), "user.py"],
        capture_output=True, text=True, cwd=tmp_path, env={"MYPYPATH": str(ROOT), "PATH": ""},
    )  # fmt: skip
    lines = done.stdout.splitlines()
    assert 'Revealed type is "deitalk.pipeline.performance.Performance"' in lines[0]
    assert 'incompatible type "str"; expected "int | None"' in lines[1]
    assert lines[2].startswith("Found 1 error")
