"""GLB (glTF 2.0 binary): our head with morph targets and their animation.

Opens in Blender, three.js, Windows' viewer and Unreal. For a face of your own, see
``deitalk retarget``.
"""

from pathlib import Path

from rig.curves import RigCurves
from rig.mesh.glb import WeightAnimation, write_glb
from rig.retarget.morph_head import in_metres, morph_head


def write(path: Path, curves: RigCurves) -> None:
    """Write one mesh in metres, y up, facing +z, and one animation of its weights."""
    rig, colours = morph_head()
    animation = WeightAnimation(rig.weights(curves), curves.fps)
    write_glb(path, in_metres(rig.shapes), animation=animation, colours=colours)
