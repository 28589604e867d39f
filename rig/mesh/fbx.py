"""FBX through Blender's exporter and importer, the optional package bpy.

A wheel of bpy fits one version of Python: the variable ``BPY_PYTHON`` names another Python that
has it.
"""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from rig.arrays import Float64
from rig.errors import FormatError
from rig.files.reading import check_file
from rig.limits import MESH_BYTES
from rig.mesh.glb import read_container, write_container

SCRIPT = Path(__file__).with_name("fbx_blender.py")
SECONDS = 1800


def glb_to_fbx(
    source: Path | str,
    target: Path | str,
    fps: float,
    tolerance: float = 0.0,
    paint: tuple[Float64, bytes] | None = None,
) -> None:
    """Write the last animation of a GLB, its meshes, shapes and bones as FBX.

    Parameters
    ----------
    source, target : Path or str
        ``.glb`` and ``.fbx``; the unit is the metre.
    fps : float
        Rate of the file; every frame has keys.
    tolerance : float
        Above 0: few linear keys that stay this near to weights; to turns within ten times as many
        degrees.
    paint : tuple of array [shape=(N, 3, 2), range 0 to 1] and bytes, optional
        Texture coordinates of the faces' corners of the one mesh, from the top left, and a JPEG:
        instead of its own texture, since an FBX shows no vertex colours.

    Raises
    ------
    FormatError
        If there is no bpy, or Blender does not read or write the file.
    """
    document, binary = read_container(source)
    document["animations"] = document.get("animations", [])[-1:]
    with TemporaryDirectory(prefix="deitalk-") as folder:
        write_container(Path(folder) / "a.glb", document, binary)
        if paint is not None:
            np.save(Path(folder) / "a.npy", paint[0].reshape(-1, 2).astype(np.float32))
            (Path(folder) / "a.png").write_bytes(paint[1])
        run_blender(Path(folder) / "a.glb", target, fps, tolerance)


def fbx_to_glb(source: Path | str, target: Path | str) -> None:
    """Write shapes, bones and animation of an FBX as GLB; errors are those of `glb_to_fbx`."""
    check_file(Path(source), MESH_BYTES)
    run_blender(source, target)


def blender() -> str:
    """Path of the Python that has bpy; looked up before long work.

    Raises
    ------
    FormatError
        If there is none.
    """
    python = os.environ.get("BPY_PYTHON", "")
    if not python and importlib.util.find_spec("bpy") is None:
        raise FormatError(
            "FBX needs the package bpy: pip install 'deitalk[fbx]', or name a Python that has it: "
            "BPY_PYTHON=/path/to/python"
        )
    return python or sys.executable


def run_blender(source: Path | str, target: Path | str, *numbers: float) -> None:
    """Run the script of this module in a Python with bpy."""
    places = [os.path.abspath(path) for path in (source, target)]
    command = [blender(), str(SCRIPT), *places, *map(str, numbers)]
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=SECONDS, env=clean
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FormatError(f"Blender did not run: {error}") from error
    if done.returncode or not Path(target).is_file():
        lines = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        reason = lines[-1] if lines else "no reason"
        raise FormatError(f"Blender makes no {Path(target).suffix}: {reason}")
