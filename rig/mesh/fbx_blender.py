"""Run in a Python that has bpy: GLB to FBX, or FBX to GLB.

``fbx_blender.py SOURCE TARGET [FPS TOLERANCE]``; an FBX that is written has these two.
"""

import importlib.util
import os
import sys
from math import ceil
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]

EQUAL = 1e-6
"""Factor of the exporter by which only equal values are."""
WIDTHS = {"DeformPercent": 100.0, "R": 10.0, "T": 0.1}
"""Tolerance of percents, degrees and metres for a share of 1."""


def to_fbx(source: str, target: str, fps: float, tolerance: float) -> None:
    """Export what the GLB shows: meshes with shapes, bones, textures, the active animation."""
    scene = bpy.context.scene
    scene.render.fps = ceil(fps)
    scene.render.fps_base = ceil(fps) / fps
    bpy.ops.import_scene.gltf(filepath=source, bone_heuristic="BLENDER")
    for collection in bpy.data.collections:
        if collection.name.startswith("glTF_not_exported"):  # the importer's picture of a bone
            for helper in list(collection.objects):
                bpy.data.objects.remove(helper)
    set_range(scene)
    for material in bpy.data.materials:
        link_textures(material.node_tree)
    if Path(source).with_suffix(".npy").is_file():
        paint(Path(source))
    if tolerance:
        keep_few_keys(tolerance)
    bpy.ops.export_scene.fbx(
        filepath=target, check_existing=False, apply_scale_options="FBX_SCALE_ALL",
        use_mesh_modifiers=False, add_leaf_bones=False, path_mode="COPY", embed_textures=True,
        bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False,
        bake_anim_simplify_factor=EQUAL * bool(tolerance),
    )  # fmt: skip


def keep_few_keys(tolerance: float) -> None:
    """Let the exporter write the keys between which straight lines stay within a tolerance.

    Its own rule drops keys that differ little from the one before, and keeps most. Importers,
    Blender's among them, take FBX keys for linear.
    """
    from io_scene_fbx.fbx_utils import AnimationCurveNodeWrapper  # type: ignore[import-not-found]

    clip = Path(__file__).parents[1] / "unreal" / "deitalk_clip.py"
    spec = importlib.util.spec_from_file_location("deitalk_clip", clip)
    assert spec is not None and spec.loader is not None
    keys: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(keys)
    keys.fit_segment = off_line
    by_blender = AnimationCurveNodeWrapper.simplify

    def simplify(node: Any, *options: Any) -> None:
        by_blender(node, *options)
        width = tolerance * WIDTHS.get(node.fbx_gname[0], 1.0)
        for values, written in zip(node._frame_values_array, node._frame_write_mask_array):  # noqa: B905
            if written.any():
                written[1:-1] = False
                written[[key[0] for key in keys.curve_keys(values.tolist(), width)]] = True

    AnimationCurveNodeWrapper.simplify = simplify


def off_line(values: list[float], first: int, last: int) -> tuple[float, float, float]:
    """Largest distance of values from the line between two of them, and its slope twice."""
    start, slope = values[first], (values[last] - values[first]) / (last - first)
    off = max(abs(values[i] - start - slope * (i - first)) for i in range(first, last))
    return off, slope, slope


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


def paint(source: Path) -> None:
    """Lay the picture beside a GLB over its one mesh, by the coordinates beside it."""
    import numpy as np

    (mesh,) = bpy.data.meshes
    layer, uv = mesh.uv_layers[0], np.load(source.with_suffix(".npy"))
    layer.data.foreach_set("uv", (uv * [1, -1] + [0, 1]).astype(np.float32).ravel())
    picture = bpy.data.images.load(str(source.with_suffix(".png")))
    for material in mesh.materials:
        for surface in material.node_tree.nodes:
            if surface.type == "BSDF_PRINCIPLED":
                surface.inputs["Base Color"].links[0].from_node.image = picture


if __name__ == "__main__":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    place, result, *numbers = sys.argv[1:]
    if result.endswith(".glb"):
        to_glb(place, result)
    else:
        to_fbx(place, result, *map(float, numbers))
    os._exit(0)  # some versions crash at the end
