"""Blender add-on: curves of deitalk on the shape keys of a face.

Run in Blender 4.2.23, 4.5.15 and 5.0.1.

``deitalk install blender`` writes it as one file that needs nothing else. In Blender:
Edit > Preferences > Add-ons > Install from Disk, choose it, tick it. Then select the face and
choose File > Import > deitalk curves: a take folder, any file of it, or

- ``*.unreal.json``: shape keys named after MetaHuman's raw curves (``jawOpen``,
  ``CTRL_expressions_jawOpen``, ``head_lod0_mesh__jaw_open``), or those of an avatar (VRM, VRChat,
  Ready Player Me, Character Creator, Daz, MMD), fitted to the raw curves;
- a Live Link Face CSV: shape keys named after ARKit (``mouthSmileLeft``, ``mouthSmile_L``);
- ``curves.json`` or ``.csv`` of any set whose names are those of shape keys, spelled as for
  ``deitalk retarget`` (``blendShape1.jawOpen``);
- ``.glb`` of deitalk: its animation, by the names of its shapes.

File > Export > deitalk curves writes the keys of the selected faces and boards as a CSV, frame by
frame, which ``deitalk diff`` compares with the take.

A selected armature with the bones of the MetaHuman face board (``CTRL_C_jaw`` ...) gets the
take's controls. In a take folder the file whose names fit the face best is taken. All selected
meshes with such shape keys are keyed: face, teeth, lashes.
"""

import csv
import json
import math
import os
import re
from dataclasses import dataclass
from typing import Any

import bpy  # type: ignore[import-not-found]
import numpy as np
from bpy_extras.io_utils import ExportHelper, ImportHelper  # type: ignore[import-not-found]

from rig.conversion.shape_fit import close_lips, closing_columns, fit_shapes, pose_of, shape_key
from rig.formats.blender import POSES, RAW, REST, VISEMES
from rig.unreal.deitalk_clip import curve_keys

bl_info = {
    "name": "deitalk curves",
    "author": "deitalk",
    "version": (1, 0, 0),
    "blender": (3, 4, 0),
    "location": "File > Import > deitalk curves",
    "description": "Curves of a deitalk take on ARKit or MetaHuman shape keys",
    "category": "Import-Export",
}
MARK = "deitalk"
"""Property of the actions that the add-on makes."""
RATE = "deitalk_rate"
"""Property of an action: frames a second of the take, if its times are even within `UNEVEN`."""
UNEVEN = 1e-3
PREFIX = "CTRL_expressions_"
SOUNDS = (".wav", ".flac", ".ogg", ".mp3", ".m4a")


@dataclass
class Curves:
    """Curves of one file.

    Parameters
    ----------
    times : array [shape=(T,)], seconds
    values : dict of str to array [shape=(T,)]
        By name.
    path : str
    lost : float [range 0 to 1]
        Share of the movement that the shapes do not show, where it is known.
    turns : bool
        Whether there is a head track, which no shape shows.
    """

    times: Any
    values: dict[str, Any]
    path: str
    lost: float = 0.0
    turns: bool = False


def read(path: str) -> Curves:
    """Return the curves of a file; ValueError with one line if it is none of the known ones."""
    try:
        if path.lower().endswith(".json"):
            return _read_json(path)
        with open(path, newline="", encoding="utf-8-sig") as stream:
            rows = csv.reader(stream)
            header = next(rows)
            cells = [row for row in rows if row]
        first = [name.strip().lower() for name in header[:2]]
        if first == ["timecode", "blendshapecount"]:
            # Return seconds from the first; FF counts sixtieths, or thirtieths if none exceeds 30.
            texts = [row[0] for row in cells]
            fields = np.array([[float(part) for part in text.split(":")] for text in texts])
            rate = 60 if fields[:, 3].max() > 30 else 30
            seconds = fields[:, :3] @ [3600, 60, 1] + fields[:, 3] / rate
            times = seconds - seconds[0]
        elif first == ["frame", "time"]:
            times = np.array([float(row[1]) for row in cells])
        else:
            raise ValueError(f"{os.path.basename(path)} is no CSV of Live Link Face or deitalk")
        numbers = np.array([row[2 : len(header)] for row in cells], float)
        return Curves(times, {name: numbers[:, i] for i, name in enumerate(header[2:])}, path)
    except (KeyError, TypeError, IndexError, StopIteration, UnicodeDecodeError) as error:
        raise ValueError(f"{os.path.basename(path)} is damaged or of another kind") from error


def _read_json(path: str) -> Curves:
    with open(path, encoding="utf-8") as stream:
        data = json.load(stream)
    schema = str(data.get("schema", ""))
    if schema.startswith("deitalk.unreal/"):
        n_frames, (over, under) = data["n_frames"], data["frame_rate"]
        raw = {name: _raw(curve, data["board"], n_frames) for name, curve in data["raw"].items()}
        curves = Curves(np.arange(n_frames) * under / over, raw, path)
        curves.turns = any(np.any(values) for values in data.get("head", {}).values())
        return curves
    if not schema.startswith("deitalk.curves/"):
        raise ValueError(f"{os.path.basename(path)} has no curves of deitalk")
    rows = np.array(data["values"], float)
    values = {name: rows[:, i] for i, name in enumerate(data["names"])}
    curves = Curves(np.arange(len(rows)) / data["fps"], values, path)
    curves.turns = bool(np.any(data.get("head", 0)))
    return curves


def _raw(curve: Any, board: dict[str, Any], n_frames: int) -> Any:
    """Return a raw curve: numbers, or a function with knots of a sum of channels of the board."""
    if not isinstance(curve, dict):
        return np.zeros(n_frames) + curve
    channels = [board[control][axis] for control, axis in (of.split(".") for of in curve["of"])]
    place = np.clip(sum(np.zeros(n_frames) + np.array(values) for values in channels), -1, 1)
    places, levels = np.array(curve["knots"], float).T
    return np.interp(place, places, levels)


def files_of_take(path: str) -> list[str]:
    """Return a file and the other files of curves of its take folder, or those of a folder.

    Raises
    ------
    ValueError
        If a folder is no take.
    """
    chosen = [] if os.path.isdir(path) else [path]
    folder = os.path.dirname(os.path.abspath(path)) if chosen else path
    if not os.path.isfile(os.path.join(folder, "take.json")):
        if not chosen:
            raise ValueError(f"{path} is no take folder; choose one that has a take.json")
        return chosen
    known = (".unreal.json", ".csv", "curves.json")
    others = [
        os.path.join(folder, name)
        for name in sorted(os.listdir(folder))
        if name.endswith(known) and name != "intensity.csv"
    ]
    return [*chosen, *(other for other in others if other not in map(os.path.abspath, chosen))]


def keys_of(mesh: Any) -> dict[str, Any]:
    """Return the shape keys of a mesh object by `shape_key`, without the basis."""
    blocks = mesh.data.shape_keys.key_blocks if mesh.data.shape_keys else []
    return {shape_key(block.name): block for block in blocks[1:]}


def best_fit(path: str, meshes: list[Any]) -> Curves:
    """Return the curves, of the file or of its take, whose names fit most shape keys.

    Raises
    ------
    ValueError
        If none fits any.
    """
    wanted = {name for mesh in meshes for name in keys_of(mesh)}
    found, reason = [], ""
    for candidate in files_of_take(path):
        try:
            found.append(read(candidate))
        except ValueError as error:
            reason = reason or str(error)
    raw = [curves for curves in found if any(name.startswith(PREFIX) for name in curves.values)]
    found += [fitted(curves, sorted(wanted)) for curves in raw]  # last: by name is exact
    counts = [len(wanted & {shape_key(name) for name in curves.values}) for curves in found]
    best = found[counts.index(max(counts))] if any(counts) else None
    if best is None:
        raise ValueError(
            reason
            or f"none of {len(wanted)} shape keys has a name of {os.path.basename(path)}: select "
            "the face; ARKit's names need the Live Link CSV, MetaHuman's the .unreal.json"
        )
    return best


def fitted(curves: Curves, keys: list[str]) -> Curves:
    """Return curves of shapes by `shape_key`, fitted to raw curves; unknown shapes are left out."""
    known = {key: np.zeros(len(RAW)) for key in POSES}
    for key, pose in POSES.items():
        known[key][list(pose)] = list(pose.values())
    poses = np.array([pose_of(key, known, RAW) for key in keys])
    columns = closing_columns(keys)
    used = [i for i, pose in enumerate(poses) if pose.any() or i in (columns or ())]
    zeros, values = np.zeros(len(curves.times)), curves.values
    moved = np.column_stack([values.get(PREFIX + name, zeros) for name in RAW]) - REST
    visemes = np.array([key in VISEMES for key in keys])
    weights, missed, _ = fit_shapes(moved, poses, visemes, RAW, columns is not None)
    if columns:
        close_lips(weights, moved, columns, RAW, 1.0)
        missed[:, [name.startswith("mouthLipsTogether") for name in RAW]] = 0.0
    found = Curves(curves.times, {keys[i]: weights[:, i] for i in used}, curves.path)
    found.lost = float(np.sqrt((missed**2).sum() / max((moved**2).sum(), 1e-12)))
    found.turns = curves.turns
    return found


def apply(
    curves: Curves,
    meshes: list[Any],
    scene: Any,
    start: float = 1.0,
    tolerance: float = 0.0,
    still: bool = True,
) -> tuple[int, float, list[str]]:
    """Key the shape keys of meshes.

    Times are in seconds and are put into the frame rate of the scene. Keys are linear; with a
    tolerance above 0 they are few, and their curves stay within it. Without `still`, keys that move
    less than that get none. An action that is there is replaced.

    Returns
    -------
    count : int
        Shape keys that have keys now.
    last : float
        The last frame.
    driven : list of str
        Names of shape keys that a driver moves: they have no keys, which it would overrule.
    """
    rate = scene.render.fps / scene.render.fps_base
    frames = start + curves.times * rate
    by_name = {shape_key(name): values for name, values in curves.values.items()}
    count, driven = 0, []
    for mesh in meshes:
        shape_keys = mesh.data.shape_keys
        found = {name: block for name, block in keys_of(mesh).items() if name in by_name}
        held = [name for name, block in found.items() if _path(block) in _drivers(shape_keys)]
        driven += [found.pop(name).name for name in held]
        if not found:
            continue
        lists = _new_action(shape_keys, curves)
        for name, block in found.items():
            values = by_name[name]
            block.slider_min = min(block.slider_min, math.floor(values.min()))
            block.slider_max = max(block.slider_max, math.ceil(values.max()))
            if still or np.ptp(values) > tolerance:
                key_curve(lists.new(_path(block)), frames, values, tolerance)
                count += 1
    return count, float(frames[-1]), driven


def apply_board(
    path: str,
    board: Any,
    scene: Any,
    start: float = 1.0,
    tolerance: float = 0.0,
    still: bool = True,
) -> tuple[int, float, int]:
    """Key the pose bones of a MetaHuman face board with the controls of a take's curves.

    A control ``CTRL_C_jaw.ty`` is the y of the location of the bone ``CTRL_C_jaw``, in its own
    axes. Returned are the number of channels, the last frame, and the number of controls that move
    and have no bone.

    Raises
    ------
    ValueError
        If the take has no curves of the board.
    """
    rate, bones = scene.render.fps / scene.render.fps_base, board.pose.bones
    for candidate in files_of_take(path):
        try:
            curves = read(candidate)
        except ValueError:
            continue
        channels = [(name, re.fullmatch(r"(CTRL_\w+)\.t([xy])", name)) for name in curves.values]
        keyed = [(name, *found.groups()) for name, found in channels if found and found[1] in bones]
        if not keyed:
            continue
        lists = _new_action(board, curves, "OBJECT")
        frames, count = start + curves.times * rate, 0
        for name, bone, axis in keyed:
            values = curves.values[name]
            if still or np.ptp(values) > tolerance:
                curve = lists.new(f'pose.bones["{bone}"].location', index="xy".index(axis))
                key_curve(curve, frames, values, tolerance)
                count += 1
        shown = {name for name, *_ in keyed}
        lost = sum(np.ptp(v) > 1e-6 for name, v in curves.values.items() if name not in shown)
        return count, float(frames[-1]), int(lost)
    raise ValueError(f"{os.path.basename(path)} has no curves of the board; open curves.json")


def takes_of(path: str) -> list[str]:
    """Return the take folders within a folder, or within that of a file.

    Raises
    ------
    ValueError
        If there is none.
    """
    folder = path if os.path.isdir(path) else os.path.dirname(path)
    inside = [os.path.join(folder, name) for name in sorted(os.listdir(folder))]
    found = [take for take in inside if os.path.isfile(os.path.join(take, "take.json"))]
    if not found:
        raise ValueError(f"{folder} has no take folders")
    return found


def push_down(owners: list[Any], name: str, start: float) -> None:
    """Put the actions of shape keys and boards on strips of the NLA, so that the next take fits."""
    for owner in owners:
        data = owner.animation_data
        if data is None or data.action is None or MARK not in data.action:
            continue
        action, data.action = data.action, None
        action.name, action.use_fake_user = name, True
        strip = data.nla_tracks.new().strips.new(name, int(start), action)
        strip.extrapolation = "NOTHING"  # a strip would hide those below it
        if hasattr(strip, "action_slot"):
            strip.action_slot = action.slots[0]


def key_curve(curve: Any, frames: Any, values: Any, tolerance: float) -> None:
    """Give a curve its keys: all of them, linear, or few with handles within a tolerance."""
    keys = np.array(curve_keys(values.tolist(), tolerance) if tolerance else [])
    chosen = keys[:, 0].astype(int) if tolerance else np.arange(len(values))
    places, points = np.column_stack([frames[chosen], values[chosen]]), curve.keyframe_points
    points.add(len(places))
    points.foreach_set("co", places.ravel())
    points.foreach_set("interpolation", np.full(len(places), BEZIER if tolerance else LINEAR))
    if tolerance:
        points.foreach_set("handle_left_type", np.zeros(len(places), int))
        points.foreach_set("handle_right_type", np.zeros(len(places), int))
        # A handle a third of the way to the next key makes the curve the cubic of the slopes.
        gaps = np.diff(places[:, 0], prepend=places[0, 0] - 1, append=places[-1, 0] + 1) / 3
        steps = np.diff(chosen, prepend=chosen[0] - 1, append=chosen[-1] + 1) / 3
        left = places - np.column_stack([gaps[:-1], keys[:, 1] * steps[:-1]])
        right = places + np.column_stack([gaps[1:], keys[:, 2] * steps[1:]])
        points.foreach_set("handle_left", left.ravel())
        points.foreach_set("handle_right", right.ravel())
    curve.update()


def _drivers(shape_keys: Any) -> set[str]:
    """Return the paths of what drivers move."""
    data = shape_keys.animation_data
    return {driver.data_path for driver in data.drivers} if data else set()


LINEAR, BEZIER = 1, 2
"""Numbers of interpolations of Keyframe; 0 is the type FREE of its handles."""


def _path(block: Any) -> str:
    name = block.name.replace("\\", "\\\\").replace('"', '\\"')
    return f'key_blocks["{name}"].value'


def _new_action(shape_keys: Any, curves: Curves, kind: str = "KEY") -> Any:
    """Return the list of curves of a new action of shape keys; 4.4 and later have it in a slot.

    The action knows the rate of the curves, if they have one. The action of an earlier import is
    removed if nothing else uses it.
    """
    name, steps = os.path.basename(curves.path), np.diff(curves.times)
    data = shape_keys.animation_data or shape_keys.animation_data_create()
    before, action = data.action, bpy.data.actions.new(name)
    data.action, action[MARK] = action, name
    if len(steps) and np.ptp(steps) < UNEVEN:
        action[RATE] = float(1 / steps.mean())
    if before is not None and MARK in before and not before.users:
        bpy.data.actions.remove(before)
    if not hasattr(action, "slots"):
        return action.fcurves
    slot = data.action_slot = action.slots.new(id_type=kind, name=shape_keys.name)
    strip = action.layers.new(name="curves").strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True).fcurves


def take_from_glb(path: str, meshes: list[Any]) -> Curves:
    """Return the curves of the animated shapes of a GLB, by Blender's own importer."""
    before, scene = set(bpy.data.objects), bpy.context.scene
    actions = set(bpy.data.actions)
    bpy.ops.import_scene.gltf(filepath=path)
    added = [found for found in bpy.data.objects if found not in before]
    try:
        for mesh in (found for found in added if found.type == "MESH"):
            keys = mesh.data.shape_keys
            if keys and keys.animation_data and keys.animation_data.action:
                return _sampled(keys, scene, path)
        raise ValueError(f"{os.path.basename(path)} has no animated shapes")
    finally:
        for found in added:
            bpy.data.objects.remove(found, do_unlink=True)
        for action in [found for found in bpy.data.actions if found not in actions]:
            bpy.data.actions.remove(action)
        for mesh in meshes:
            mesh.select_set(True)


def _sampled(keys: Any, scene: Any, path: str) -> Curves:
    """Return the values of animated shape keys at each frame of the scene's rate."""
    first, last = (round(number) for number in keys.animation_data.action.frame_range)
    rate, was = scene.render.fps / scene.render.fps_base, scene.frame_current
    blocks, rows = keys.key_blocks[1:], []
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        rows.append([block.value for block in blocks])
    scene.frame_set(was)
    values = {block.name: np.array(row) for block, row in zip(blocks, zip(*rows))}  # noqa: B905
    return Curves(np.arange(len(rows)) / rate, values, path)


def sound_of(path: str) -> str:
    """Return the sound beside a file or in a folder.

    It is ``audio.wav`` of a take, else of the file's name; empty if there is none.
    """
    folder, name = (path, "") if os.path.isdir(path) else os.path.split(os.path.abspath(path))
    stem = name.split(".")[0]
    for candidate in ("audio_48k.wav", "audio.wav", *(stem + suffix for suffix in SOUNDS)):
        if os.path.isfile(os.path.join(folder, candidate)):
            return os.path.join(folder, candidate)
    return ""


def add_sound(path: str, scene: Any, start: float) -> None:
    """Add a sound to the sequencer of the scene, once, and scrub with it.

    Raises
    ------
    RuntimeError
        If this Blender reads no sound.
    """
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    for strip in list(strips):
        if strip.type == "SOUND" and bpy.path.abspath(strip.sound.filepath) == path:
            strips.remove(strip)
    strips.new_sound(os.path.basename(path), path, 1, int(start))
    scene.use_audio_scrub = True
    scene.sync_mode = "AUDIO_SYNC"


class DEITALK_OT_import(bpy.types.Operator, ImportHelper):  # type: ignore[misc]
    """Key the shape keys of the selected faces with curves of deitalk."""

    bl_idname = "import_anim.deitalk"
    bl_label = "Import deitalk curves"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012
    filter_glob: bpy.props.StringProperty(default="*.json;*.csv;*.glb", options={"HIDDEN"})  # type: ignore[valid-type]
    start: bpy.props.FloatProperty(name="First frame", default=1.0)  # type: ignore[valid-type]
    tolerance: bpy.props.FloatProperty(name="Tolerance of keys", default=0.0, min=0.0, max=0.1)  # type: ignore[valid-type]
    still: bpy.props.BoolProperty(name="Key what is still", default=True)  # type: ignore[valid-type]
    batch: bpy.props.BoolProperty(name="Every take of the folder", default=False)  # type: ignore[valid-type]
    with_sound: bpy.props.BoolProperty(name="Add the sound", default=True)  # type: ignore[valid-type]

    def execute(self, context: Any) -> set[str]:
        """Run the import; a mistake is one line."""
        selected = context.selected_objects
        meshes = [found for found in selected if found.type == "MESH"]
        boards = [found for found in selected if found.type == "ARMATURE"]
        start = self.start
        try:
            for path in takes_of(self.filepath) if self.batch else [self.filepath]:
                last = self._key(path, meshes, boards, context.scene, start)
                if self.batch:
                    owners = [mesh.data.shape_keys for mesh in meshes if mesh.data.shape_keys]
                    push_down([*owners, *boards], os.path.basename(path), start)
                start = math.ceil(last) + 1
        except (OSError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def _key(
        self, path: str, meshes: list[Any], boards: list[Any], scene: Any, start: float
    ) -> float:
        """Key meshes and boards with one take and add its sound; return its last frame."""
        how, last = (scene, start, self.tolerance, self.still), start
        for board in boards:
            count, last, lost = apply_board(path, board, *how)
            notes = (
                f"{count} channels of {board.name} from {os.path.basename(os.path.normpath(path))}"
            )
            without = f", {lost} moving controls have no bone" if lost else ""
            self.report({"INFO"}, notes + without)
        if meshes or not boards:
            last = max(last, self._key_shapes(path, meshes, how))
        scene.frame_end = max(scene.frame_end, math.ceil(last))
        sound = sound_of(path) if self.with_sound else ""
        try:
            if sound:
                add_sound(sound, scene, start)
        except RuntimeError as error:
            self.report({"WARNING"}, f"keys without the sound: {error}")
        return last

    def _key_shapes(self, path: str, meshes: list[Any], how: Any) -> float:
        is_glb = path.lower().endswith(".glb")
        curves = take_from_glb(path, meshes) if is_glb else best_fit(path, meshes)
        count, last, driven = apply(curves, meshes, *how)
        if driven:
            self.report({"WARNING"}, f"a driver moves {_listed(driven)}: no keys there")
        if not count:
            raise ValueError(
                f"no shape key without a driver has a name of {os.path.basename(curves.path)}"
            )
        notes = [
            f"{count} shape keys from {os.path.basename(curves.path)}",
            *unshown(curves, meshes),
        ]
        self.report({"INFO"}, ", ".join(notes))
        return last


def keyed(owner: Any) -> list[Any]:
    """Return the F-curves of the action of a board or of shape keys."""
    data = owner.animation_data
    if data is None or data.action is None:
        return []
    if hasattr(data.action, "fcurves"):
        return list(data.action.fcurves)
    bags = [strip.channelbag(data.action_slot) for strip in data.action.layers[0].strips]
    return [curve for bag in bags if bag for curve in bag.fcurves]


def channels_of(objects: list[Any]) -> dict[str, tuple[Any, int, float]]:
    """Return what has keys, by the name of its control or shape.

    Each is what holds the value (a pose bone, or a shape key), the axis of its location (-1 of a
    shape key) and the last frame with a key.
    """
    raw = {shape_key(PREFIX + name): PREFIX + name for name in RAW}
    found: dict[str, tuple[Any, int, float]] = {}
    for made in objects:
        owner = made.data.shape_keys if made.type == "MESH" else made
        for curve in keyed(owner) if owner else []:
            last = curve.range()[1]
            board = re.fullmatch(r'pose\.bones\["(CTRL_\w+)"\]\.location', curve.data_path)
            if board and made.type == "ARMATURE" and curve.array_index < 2:
                bone = made.pose.bones.get(board[1])
                name = f"{board[1]}.t{'xy'[curve.array_index]}"
                found.setdefault(name, (bone, curve.array_index, last))
            elif made.type == "MESH":
                block = next((b for b in owner.key_blocks if _path(b) == curve.data_path), None)
                if block:
                    plain = re.split(r"[.|]", block.name)[-1]
                    name = raw.get(shape_key(block.name), plain)
                    found.setdefault(name, (block, -1, last))
    return {name: channel for name, channel in found.items() if channel[0] is not None}


def export(path: str, objects: list[Any], scene: Any, start: float = 1.0) -> tuple[int, int]:
    """Write what has keys as a CSV with a row for each frame of the take that was imported.

    Without one, or with takes of several rates, the rows are frames of the scene.

    Returns
    -------
    channels, frames : int

    Raises
    ------
    ValueError
        If nothing that is selected has keys.
    """
    channels = channels_of(objects)
    if not channels:
        raise ValueError("nothing that is selected has keys of a face; select what was imported")
    scene_rate, was = scene.render.fps / scene.render.fps_base, scene.frame_current
    actions = {held.id_data.animation_data.action for held, *_ in channels.values()}
    rates = {round(action.get(RATE, scene_rate), 3) for action in actions}
    rate = rates.pop() if len(rates) == 1 else scene_rate
    last = max(last for *_, last in channels.values())
    rows = []
    for row in range(math.ceil((last - start) / scene_rate * rate - 1e-3) + 1):
        frame = start + row / rate * scene_rate
        scene.frame_set(math.floor(frame), subframe=frame % 1)
        values = [held.location[axis] if axis >= 0 else held.value
                  for held, axis, _ in channels.values()]  # fmt: skip
        rows.append([row, f"{row / rate:.6f}", *(f"{value:.6f}" for value in values)])
    scene.frame_set(was)
    with open(path, "w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([["frame", "time", *channels], *rows])
    return len(channels), len(rows)


class DEITALK_OT_export(bpy.types.Operator, ExportHelper):  # type: ignore[misc]
    """Write the keys of the selected faces and boards for ``deitalk diff``."""

    bl_idname = "export_anim.deitalk"
    bl_label = "Export deitalk curves"
    filename_ext = ".csv"
    filter_glob: bpy.props.StringProperty(default="*.csv", options={"HIDDEN"})  # type: ignore[valid-type]
    start: bpy.props.FloatProperty(name="First frame", default=1.0)  # type: ignore[valid-type]

    def execute(self, context: Any) -> set[str]:
        """Run the export; a mistake is one line."""
        try:
            wanted = [f for f in context.selected_objects if f.type in ("MESH", "ARMATURE")]
            channels, frames = export(self.filepath, wanted, context.scene, self.start)
        except (OSError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{channels} curves of {frames} frames in {self.filepath}")
        return {"FINISHED"}


def unshown(curves: Curves, meshes: list[Any]) -> list[str]:
    """Say what of the curves the shape keys do not show."""
    have = {name for mesh in meshes for name in keys_of(mesh)}
    moving = [name for name, values in curves.values.items() if np.ptp(values) > 1e-6]
    without = [name for name in moving if shape_key(name) not in have]
    notes = (
        [f"{len(without)} moving curves have no shape key: {_listed(without)}"] if without else []
    )
    if curves.lost > 0.001:
        notes.append(f"{curves.lost:.0%} of the movement has no shape")
    return [*notes, "the head does not turn"] if curves.turns else notes


def _listed(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _entry(menu: Any, _context: Any) -> None:
    menu.layout.operator(DEITALK_OT_import.bl_idname, text="deitalk curves (.json, .csv, .glb)")


def _export_entry(menu: Any, _context: Any) -> None:
    menu.layout.operator(DEITALK_OT_export.bl_idname, text="deitalk curves (.csv)")


def register() -> None:
    """Add the operators and their menu entries."""
    for operator in (DEITALK_OT_import, DEITALK_OT_export):
        bpy.utils.register_class(operator)
    bpy.types.TOPBAR_MT_file_import.append(_entry)
    bpy.types.TOPBAR_MT_file_export.append(_export_entry)


def unregister() -> None:
    """Remove them."""
    bpy.types.TOPBAR_MT_file_export.remove(_export_entry)
    bpy.types.TOPBAR_MT_file_import.remove(_entry)
    for operator in (DEITALK_OT_export, DEITALK_OT_import):
        bpy.utils.unregister_class(operator)


if __name__ == "__main__":
    register()
