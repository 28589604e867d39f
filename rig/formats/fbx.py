"""FBX by Blender (extra fbx): the head of `rig.formats.glb` with the same shapes and animation."""

from pathlib import Path
from tempfile import TemporaryDirectory

from rig.controls import ControlSet
from rig.curves import RigCurves
from rig.formats import glb
from rig.mesh.fbx import blender, fbx_to_glb, glb_to_fbx
from rig.retarget.morph_head import baked_picture


def write(path: Path, curves: RigCurves, identity: int | str = 0) -> None:
    """Write the head of a GLB as FBX, in metres, y up, one key a frame; one picture for colours."""
    from rig.face import build_head

    blender()
    with TemporaryDirectory(prefix="deitalk-") as folder:
        between = Path(folder) / "take.glb"
        glb.write(between, curves, identity)
        glb_to_fbx(between, path, curves.fps, paint=baked_picture(build_head(identity)))


def read(path: Path, controls: ControlSet | None, fps: float | None) -> RigCurves:
    """Read the shapes and bones of an FBX; errors are those of `rig.formats.glb.read`."""
    with TemporaryDirectory(prefix="deitalk-") as folder:
        between = Path(folder) / path.with_suffix(".glb").name
        fbx_to_glb(path, between)
        return glb.read(between, controls, fps)
