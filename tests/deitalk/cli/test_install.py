import json
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from deitalk.cli.install import PLUGINS, unreal
from deitalk.errors import DeitalkError, MissingError
from rig.errors import ExistsError

app = typer.Typer()
app.command()(unreal)


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture
def project(tmp_path):
    (tmp_path / "My Game").mkdir()
    (tmp_path / "My Game" / "MyGame.uproject").write_text("{}")
    return tmp_path / "My Game"


def test_plugin_has_what_unreal_looks_for_at_its_start(project):
    assert run(project / "MyGame.uproject").exit_code == 0
    plugin = project / "Plugins" / "deitalk"
    described = json.loads((plugin / "deitalk.uplugin").read_text())
    assert described["FileVersion"] == 3 and described["CanContainContent"]
    assert [p["Name"] for p in described["Plugins"] if p["Enabled"]] == list(PLUGINS)
    scripts = {path.name for path in (plugin / "Content" / "Python").iterdir()}
    assert {"init_unreal.py", "deitalk_menu.py", "deitalk_unreal.py", "deitalk_clip.py"} <= scripts
    assert "__init__.py" not in scripts
    settings = json.loads((plugin / "Content/Python/deitalk_settings.json").read_text())
    done = subprocess.run([*settings["command"], "--version"], capture_output=True, text=True)
    assert done.returncode == 0 and settings["command"][0] == sys.executable


def test_plugin_is_written_again_with_force_only(project):
    assert run(project).exit_code == 0
    assert isinstance(run(project).exception, ExistsError)
    assert run(project, "--service", "http://10.0.0.2:8000", "--force").exit_code == 0
    path = project / "Plugins/deitalk/Content/Python/deitalk_settings.json"
    assert json.loads(path.read_text())["service"] == "http://10.0.0.2:8000"


def test_faults_are_one_line(project, tmp_path):
    for arguments, kind, message in (
        ([tmp_path], DeitalkError, "has no .uproject file"),
        ([tmp_path / "absent"], MissingError, "does not exist"),
        ([project, "--service", "host:80"], DeitalkError, "must begin with http://"),
    ):
        error = run(*arguments).exception
        assert isinstance(error, kind) and message in str(error) and "\n" not in str(error)
    assert not (project / "Plugins").exists()
