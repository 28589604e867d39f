"""GLB (glTF 2.0 binary): our head with morph targets and their animation.

Opens in Blender, three.js, Windows' viewer and Unreal. For a face of your own, see
``deitalk retarget``.
"""

from pathlib import Path

from rig.curves import RigCurves
from rig.face.turn import matrices, quaternions
from rig.mesh.glb import RigidMotion, WeightAnimation, write_glb
from rig.retarget.morph_head import METRES_PER_CM, in_metres, morph_head


def write(path: Path, curves: RigCurves) -> None:
    """Write one mesh in metres, y up, facing +z, and one animation of its weights and its node.

    The head track turns and shifts the whole mesh about the joint of skull and spine.
    """
    rig, colours = morph_head()
    animation = WeightAnimation(rig.weights(curves), curves.fps, motion=_motion(curves))
    write_glb(path, in_metres(rig.shapes), animation=animation, colours=colours)


def _motion(curves: RigCurves) -> RigidMotion | None:
    if curves.head is None:
        return None
    _, translation = matrices(curves.head)
    return RigidMotion(quaternions(curves.head), translation * METRES_PER_CM)
