"""An animator's session inside Blender, or a Python that has bpy: import, edit keys, export.

::

    python edit_inside_blender.py ADDON TAKE OUT RATE KIND [MOVES]   # KIND: board, raw or arkit

MOVES is JSON: control or shape, first and last second, and what is added to its keys there.
"""

import importlib.util
import json
import os
import sys

import bpy
import numpy

numpy.bool = bool
addon_path, take, target, rate, kind, moves = sys.argv[-6:]
bpy.ops.wm.read_factory_settings(use_empty=True)
spec = importlib.util.spec_from_file_location("deitalk_blender", addon_path)
addon = importlib.util.module_from_spec(spec)
spec.loader.exec_module(addon)
addon.register()
scene = bpy.context.scene
scene.render.fps = int(rate)
moves = json.loads(moves)


def selected(made):
    scene.collection.objects.link(made)
    made.select_set(True)
    bpy.context.view_layer.objects.active = made
    return made


if kind == "board":
    with open(take + "/curves.csv") as stream:
        names = stream.readline().strip().split(",")[2:]
    made = selected(bpy.data.objects.new("board", bpy.data.armatures.new("board")))
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in dict.fromkeys(name.rsplit(".", 1)[0] for name in names):
        made.data.edit_bones.new(bone).tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    owner = made
else:
    data = bpy.data.meshes.new("face")
    data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    made = selected(bpy.data.objects.new("face", data))
    made.shape_key_add(name="Basis")
    for name in moves:
        made.shape_key_add(name=name)
    owner = made.data.shape_keys
done = bpy.ops.import_anim.deitalk(filepath=take + "/", with_sound=False)
assert done == {"FINISHED"}, done
per_second, edited = scene.render.fps / scene.render.fps_base, 0
for curve in addon.keyed(owner):
    for name, (start, end, added) in moves.items():
        bone, _, axis = name.partition(".t")
        path = f'pose.bones["{bone}"].location' if axis else f'key_blocks["{name}"].value'
        if curve.data_path != path or (axis and curve.array_index != "xy".index(axis)):
            continue
        for point in curve.keyframe_points:
            if start - 1e-3 <= (point.co.x - 1) / per_second <= end + 1e-3:
                point.co.y += added
                edited += 1
        curve.update()
done = bpy.ops.export_anim.deitalk(filepath=target)
assert done == {"FINISHED"}, done
for other in bpy.data.objects:
    other.select_set(False)
try:
    bpy.ops.export_anim.deitalk(filepath=target + ".none")
    refused = ""
except RuntimeError as error:
    refused = str(error).strip()
out = {"edited": edited, "refused": refused, "version": bpy.app.version_string}
sys.stdout.write(f"\nOUT {json.dumps(out)}\n")
sys.stdout.flush()
os._exit(0)  # a bpy of a Python may hang or crash as it ends
