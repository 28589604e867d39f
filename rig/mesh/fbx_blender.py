"""Run in a Python that has bpy: GLB to FBX, or FBX to GLB.

``fbx_blender.py SOURCE TARGET [FPS TOLERANCE]``; an FBX that is written has these two.
"""

import os
import sys
from math import ceil
from typing import Any

import bpy  # type: ignore[import-not-found]


def to_fbx(source: str, target: str, fps: float, tolerance: float) -> None:
    """Export what the GLB shows: meshes with shapes, bones, textures, the active animation."""
    scene = bpy.context.scene
    scene.render.fps = ceil(fps)
    scene.render.fps_base = ceil(fps) / fps
    bpy.ops.import_scene.gltf(filepath=source, bone_heuristic="BLENDER")
    set_range(scene)
    for material in bpy.data.materials:
        link_textures(material.node_tree)
    # The exporter drops keys that differ from the last one by less than a share of the value.
    bpy.ops.export_scene.fbx(
        filepath=target, check_existing=False, apply_scale_options="FBX_SCALE_ALL",
        use_mesh_modifiers=False, add_leaf_bones=False, path_mode="COPY", embed_textures=True,
        bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False,
        bake_anim_simplify_factor=1000 * tolerance,
    )  # fmt: skip


def to_glb(source: str, target: str) -> None:
    """Export every frame of the FBX's shapes and bones, without what only the eye sees."""
    bpy.ops.import_scene.fbx(filepath=source, anim_offset=0)
    set_range(bpy.context.scene)
    bpy.ops.export_scene.gltf(
        filepath=target, check_existing=False, export_animation_mode="ACTIVE_ACTIONS",
        export_force_sampling=True, export_optimize_animation_size=False,
        export_normals=False, export_morph_normal=False, export_texcoords=False,
        export_materials="NONE",
    )  # fmt: skip


def set_range(scene: Any) -> None:
    """Let the scene run as long as its animations, from frame 0."""
    ends = [action.frame_range[1] for action in bpy.data.actions]
    scene.frame_start, scene.frame_end = 0, round(max(ends, default=0))


def link_textures(tree: Any) -> None:
    """Link the texture of the base colour itself: the exporter passes over vertex colours."""
    for surface in [node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"]:
        colour = surface.inputs["Base Color"]
        waiting = [link.from_node for link in colour.links]
        while waiting:
            node = waiting.pop()
            if node.type == "TEX_IMAGE":
                tree.links.new(node.outputs["Color"], colour)
                break
            waiting += [link.from_node for socket in node.inputs for link in socket.links]


if __name__ == "__main__":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    place, result, *numbers = sys.argv[1:]
    if result.endswith(".glb"):
        to_glb(place, result)
    else:
        to_fbx(place, result, *map(float, numbers))
    os._exit(0)  # some versions crash at the end
