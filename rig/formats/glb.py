"""GLB (glTF 2.0 binary): our head with morph targets and their animation.

Curves of the board move shapes of its controls, ARKit's curves the 52 shapes of `arkit_head`.
Opens in Blender, three.js, Windows' viewer and Unreal. For a face of your own, see
``deitalk retarget``.
"""

from pathlib import Path

from rig.conversion.arkit import ARKIT_ID
from rig.curves import RigCurves
from rig.face.accents import matrices, quaternions
from rig.mesh.glb import RigidMotion, WeightAnimation, write_glb
from rig.retarget.morph_head import METRES_PER_CM, in_metres, morph_head, textured


def write(path: Path, curves: RigCurves, identity: int | str = 0) -> None:
    """Write one mesh in metres, y up, facing +z, and one animation of its weights and its node.

    ARKit's curves become weights of shapes with Apple's names, and of four correctives.

    The head track turns and shifts the whole mesh about the joint of skull and spine.
    `identity` is a number or name of an embedded head.
    """
    if curves.control_set == ARKIT_ID:
        from rig.retarget.arkit_head import write_animation

        write_animation(path, curves, identity, motion=_motion(curves))
        return
    from rig.face import build_head

    rig, _ = morph_head(identity)
    colours, surface = textured(build_head(identity))
    animation = WeightAnimation(rig.weights(curves), curves.fps, motion=_motion(curves))
    write_glb(path, in_metres(rig.shapes), animation=animation, colours=colours, surface=surface)


def _motion(curves: RigCurves) -> RigidMotion | None:
    if curves.head is None:
        return None
    _, translation = matrices(curves.head)
    return RigidMotion(quaternions(curves.head), translation * METRES_PER_CM)
