"""`deitalk install`: the menu in an Unreal project, the add-on of Blender."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

import typer

from deitalk.cli.console import console
from deitalk.cli.options import CheckedCommands, Force
from deitalk.cli.targets import reserve_file, reserve_folder
from deitalk.errors import DeitalkError, MissingError

app = CheckedCommands(help="Install deitalk in another program.")

KIND = "unreal-plugin"
PLUGINS = ("PythonScriptPlugin", "EditorScriptingUtilities", "SequencerScripting", "ControlRig")
"""Plugins of the engine that the scripts need; Unreal enables them with ours."""


@app.command()
def unreal(
    project: Annotated[
        Path, typer.Argument(help="Folder of an Unreal project, or its .uproject file.")
    ],
    service: Annotated[
        str, typer.Option(help="Address of `deitalk serve`; else this deitalk is started.")
    ] = "",
    key: Annotated[str, typer.Option(help="API key of that service.")] = "",
    force: Force = False,
) -> None:
    """Add a menu to an Unreal project: Animate audio…, with the result placed in Sequencer.

    Writes the plugin Plugins/deitalk; the editor shows the menu after its next start.

    Examples
    --------
    deitalk install unreal C:/Projects/MyGame

    deitalk install unreal MyGame.uproject --service http://192.168.0.20:8000 --force
    """
    import rig.unreal
    from deitalk.installed import __version__
    from rig.files import output_folder

    root = project.parent if project.suffix.lower() == ".uproject" else project
    if not root.is_dir():
        raise MissingError(f"{project} does not exist")
    if not list(root.glob("*.uproject")):
        raise DeitalkError(f"{root} has no .uproject file; name the folder of an Unreal project")
    folder = root / "Plugins" / "deitalk"
    if service and urlsplit(service).scheme not in ("http", "https"):
        raise DeitalkError(f"--service {service!r} must begin with http:// or https://")
    reserve_folder(folder, kind=KIND, force=force)
    settings = {"command": [sys.executable, "-P", "-m", "deitalk"], "service": service, "key": key}
    description = {
        "FileVersion": 3,
        "Version": 1,
        "VersionName": __version__,
        "FriendlyName": "deitalk",
        "Description": "Facial animation from speech and an emotion",
        "Category": "Animation",
        "CanContainContent": True,
        "EnabledByDefault": True,
        "Plugins": [{"Name": name, "Enabled": True} for name in PLUGINS],
    }
    with output_folder(folder, kind=KIND, force=force) as stage:
        _write_json(stage / "deitalk.uplugin", description)
        scripts = stage / "Content" / "Python"
        scripts.mkdir(parents=True)
        for source in Path(rig.unreal.__file__).parent.glob("*.py"):
            if source.name != "__init__.py":
                (scripts / source.name).write_bytes(source.read_bytes())
        _write_json(scripts / "deitalk_settings.json", settings)
    console().print(f"{folder}: start the editor again, then: menu deitalk > Animate audio…")


def _write_json(path: Path, data: dict[str, Any]) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


@app.command()
def blender(
    out: Annotated[Path, typer.Argument(help="File to write, .py.")] = Path("deitalk_blender.py"),
    force: Force = False,
) -> None:
    """Write the Blender add-on: takes on the shape keys of a face.

    Install it in Blender: Edit > Preferences > Add-ons > Install from Disk.

    Examples
    --------
    deitalk install blender deitalk_blender.py
    """
    from rig.files import atomic_write
    from rig.formats.blender import addon_text

    if out.suffix.lower() != ".py":
        raise DeitalkError(f"{out} has suffix {out.suffix or 'none'!r}; an add-on is a .py file")
    reserve_file(out, force=force)
    with atomic_write(out) as beside:
        beside.write_text(addon_text(), encoding="utf-8")
    console().print(f"{out}: Blender > Edit > Preferences > Add-ons > Install from Disk")
