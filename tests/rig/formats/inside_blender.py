"""What `test_blender_addon` does inside Blender, or inside a Python that has bpy.

::

    python inside_blender.py ADDON TAKE GLB      # the last line is OUT and JSON
"""

import importlib.util
import json
import os
import sys

import bpy
import numpy

numpy.bool = bool  # the importer of Blender 3.4 needs it, numpy dropped it
addon_path, take, glb = sys.argv[-3:]
bpy.ops.wm.read_factory_settings(use_empty=True)
spec = importlib.util.spec_from_file_location("deitalk_blender", addon_path)
addon = importlib.util.module_from_spec(spec)
spec.loader.exec_module(addon)
addon.register()
scene = bpy.context.scene


def face(*names):
    """A triangle, selected; each key lifts all of it by one."""
    for other in bpy.data.objects:
        other.select_set(False)
    data = bpy.data.meshes.new("face")
    data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    made = bpy.data.objects.new("face", data)
    scene.collection.objects.link(made)
    made.shape_key_add(name="Basis")
    for name in names:
        key = made.shape_key_add(name=name)
        key.value = 0
        for point in key.data:
            point.co.z = 1
    made.select_set(True)
    bpy.context.view_layer.objects.active = made
    return made


def values(made, frame):
    """Values of the keys at a frame, and how far the face has moved."""
    scene.frame_set(frame)
    found = {block.name: block.value for block in made.data.shape_keys.key_blocks[1:]}
    moved = made.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return found | {"moved": moved.to_mesh().vertices[0].co.z}


def sounds():
    editor = scene.sequence_editor
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    return [[strip.sound.filepath.rsplit("/", 1)[-1], strip.frame_start] for strip in strips]


def curves_of(made):
    """Curves of the keys' action, which 5.0 and later have in the slot alone."""
    action = made.data.shape_keys.animation_data.action
    if hasattr(action, "fcurves"):
        return action.fcurves
    return action.layers[0].strips[0].channelbags[0].fcurves


def load(path, **given):
    return list(bpy.ops.import_anim.deitalk(filepath=path, **given))


out = {"version": bpy.app.version_string, "has_sound": bpy.app.build_options.audaspace}
scene.render.fps = 24
arkit = face("blendShape1.jawOpen", "mouthSmile_L", "unknown")
out["folder"] = load(take + "/")
out["at_24"] = [values(arkit, 1), values(arkit, 9)]
out["rate"] = scene.render.fps / scene.render.fps_base
out["sounds"], out["end"] = sounds(), scene.frame_end
out["again"] = load(take + "/curves.json")
out["after"] = values(arkit, 9)
out["actions"], out["sounds_after"] = len(bpy.data.actions), sounds()
raw = face("head_lod0_mesh__mouth_corner_pull_L", "CTRL_expressions_jawOpen", 'nose"WrinkleL')
scene.render.fps = 60
out["raw"] = load(take + "/hi.unreal.json", start=0.0, with_sound=False)
out["raw_values"] = [values(raw, 0), values(raw, 20)]
out["kinds"] = sorted({p.interpolation for c in curves_of(raw) for p in c.keyframe_points})
shapes = face("mouthClose", "jawOpen")
scene.render.fps = 25
out["glb"] = load(glb, start=0.0)
out["glb_values"] = [values(shapes, 0), values(shapes, 2)]
out["objects"] = len(bpy.data.objects)
few = face("jawOpen", "mouthSmileLeft", "Mouth_Smile_R")
scene.render.fps = 60
for still in (True, False):
    out["few"] = load(
        take + "/hi.unreal.json", start=0.0, tolerance=0.01, still=still, with_sound=False
    )
    out[f"few_keys_{still}"] = {
        curve.data_path.split('"')[1]: len(curve.keyframe_points) for curve in curves_of(few)
    }
out["few_values"] = [values(few, frame) for frame in range(0, 80, 2)]
rigged = face("jawOpen", "mouthSmileLeft")
driver = rigged.data.shape_keys.key_blocks["jawOpen"].driver_add("value")
driver.driver.expression = "0.25"
out["driven"] = load(take + "/")
out["driven_values"] = values(rigged, 1 + 10)
scene.render.fps = 30
rig = bpy.data.objects.new("board", bpy.data.armatures.new("board"))
scene.collection.objects.link(rig)
shapes = face("jawOpen")
shapes.select_set(False)
rig.select_set(True)
bpy.context.view_layer.objects.active = rig
bpy.ops.object.mode_set(mode="EDIT")
for name in ("CTRL_C_jaw", "CTRL_L_eye", "other"):
    bone = rig.data.edit_bones.new(name)
    bone.tail = (0, 0, 1)
bpy.ops.object.mode_set(mode="OBJECT")
out["board"] = load(take + "/", start=0.0, with_sound=False)
out["board_values"] = []
for frame in (0, 7, 20):
    scene.frame_set(frame)
    bones = rig.pose.bones
    out["board_values"].append([*bones["CTRL_C_jaw"].location, *bones["CTRL_L_eye"].location])
shapes.select_set(True)
out["batch"] = load(take + "/..", batch=True, start=1.0, with_sound=False)
tracks = shapes.data.shape_keys.animation_data.nla_tracks
out["strips"] = [[s.name, s.frame_start, s.frame_end] for t in tracks for s in t.strips]
out["batch_values"] = [values(shapes, frame)["jawOpen"] for frame in (1 + 7, 41 + 7)]
face("smile")
out["errors"] = []
for wrong in (take + "/curves.json", take + "/.."):
    try:
        load(wrong)
    except RuntimeError as error:
        out["errors"].append(str(error).strip())
addon.unregister()
sys.stdout.write(f"\nOUT {json.dumps(out)}\n")
sys.stdout.flush()
os._exit(0)  # a bpy of a Python may crash as it ends
