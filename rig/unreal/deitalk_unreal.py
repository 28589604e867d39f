"""Import of deitalk animation into Unreal Engine (5.3 to 5.7), run inside the editor.

Needs nothing but Unreal's own Python (3.9 or later) and a ``*.unreal.json`` that
``deitalk convert take/curves.json speech.unreal.json`` writes. In the editor's Python console::

    import sys; sys.path.append(r"C:/folder/of/this/file")
    import deitalk_unreal as d
    d.anim_sequence(r"C:/take/speech.unreal.json")              # raw curves, one AnimSequence
    d.control_rig(r"C:/take/speech.unreal.json")                # keys on the open Level Sequence
    d.live_link_csv(r"C:/take/Slate_1_deitalk.csv")             # Live Link take

or from the command field: ``py "C:/…/deitalk_unreal.py" anim "C:/take/speech.unreal.json"``.
With ``dry_run=True`` (``--dry-run``) every step is printed and nothing is changed; that also works
outside Unreal. Plugins to enable: Python Editor Script Plugin; for ``live_link_csv`` also Live Link
Face Importer.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any

try:
    import unreal  # type: ignore[import-not-found]
except ImportError:  # outside the editor: dry runs only
    unreal = None

SCHEMA = "deitalk.unreal/1"
FOLDER = "/Game/deitalk"
SKELETONS = (
    "/Game/MetaHumans/Common/Face/Face_Archetype_Skeleton",
    "/MetaHumanCharacter/Face/Face_Archetype_Skeleton",
)
BOARD = "Face_ControlBoard_CtrlRig"
OLDER_NAMES = {
    "CTRL_C_tongue_move": "CTRL_C_tongue",
    "CTRL_C_tongue_wideNarrow": "CTRL_C_tongue_narrowWide",
    "CTRL_C_tongue_tipMove": "CTRL_C_tongue_tip",
    "CTRL_C_tongue_bendTwist": "CTRL_C_tongue_roll",
}
"""Controls that boards of 2021 to 2023 spell differently."""


class DeitalkError(RuntimeError):
    """An error that the user can correct; the message says how."""


def anim_sequence(
    path: str, skeleton: str = "", name: str = "", folder: str = FOLDER, dry_run: bool = False
) -> Any:
    """Write all raw curves into a new AnimSequence, in one bracket.

    Without the bracket Unreal rebuilds the asset after each curve: minutes instead of a second.

    Parameters
    ----------
    path : str
        A ``*.unreal.json``.
    skeleton : str
        Asset path of the face skeleton; the usual places are tried if it is empty.
    name, folder : str
        Of the new asset; the name is the file's if it is empty.
    dry_run : bool
        Print what would be done and change nothing.

    Returns
    -------
    unreal.AnimSequence, or None in a dry run
    """
    data = load(path)
    name = name or asset_name(path)
    n_frames, rate = data["n_frames"], data["frame_rate"]
    say(
        f"AnimSequence {folder}/{name}: {len(data['raw'])} curves, {n_frames} frames at "
        f"{rate[0]}/{rate[1]} fps"
    )
    if dry_run:
        for curve, values in data["raw"].items():
            say(f"  {curve}: {_describe(values)}")
        return None
    need_unreal()
    sequence = _new_sequence(name, folder, _skeleton(skeleton))
    controller = sequence.controller
    controller.open_bracket("deitalk")
    try:
        controller.set_frame_rate(unreal.FrameRate(rate[0], rate[1]), False)
        # a sequence has one key more than frames
        controller.set_number_of_frames(unreal.FrameNumber(max(n_frames - 1, 1)), False)
        times = [i * rate[1] / rate[0] for i in range(n_frames)]
        for curve, values in data["raw"].items():
            _add_curve(sequence, curve, times, values)
    finally:
        controller.close_bracket(False)
    unreal.EditorAssetLibrary.save_loaded_asset(sequence)
    say(f"saved {folder}/{name}; drag it onto the Face track, then Bake to Control Rig to edit it")
    return sequence


def control_rig(
    path: str, sequence: str = "", rig: str = BOARD, start_frame: int = 0, dry_run: bool = False
) -> list[str]:
    """Key the face board in a Level Sequence; controls that never move get one key.

    Parameters
    ----------
    path : str
        A ``*.unreal.json``.
    sequence : str
        Asset path of the Level Sequence; the one open in Sequencer if it is empty.
    rig : str
        Name of the control rig. Its track must be in the sequence: drag the MetaHuman in first.
    start_frame : int
        First frame, in the sequence's display rate.
    dry_run : bool
        Print what would be done and change nothing.

    Returns
    -------
    list of str
        Controls that this board does not have, which were left out.
    """
    data = load(path)
    say(f"{len(data['board'])} controls of {rig}, {data['n_frames']} frames from {start_frame}")
    if dry_run:
        for control, channels in data["board"].items():
            kind = "float" if "value" in channels else "Vector2D"
            keys = ", ".join(f"{axis} {_describe(values)}" for axis, values in channels.items())
            say(f"  {control} ({kind}): {keys}")
        return []
    need_unreal()
    level_sequence = find_sequence(sequence)
    board = find_rig(level_sequence, rig)
    display = level_sequence.get_display_rate()
    fps = display.numerator / display.denominator
    skipped = []
    with unreal.ScopedSlowTask(len(data["board"]), "deitalk: keys on the face board") as task:
        task.make_dialog(True)
        for control, channels in data["board"].items():
            if task.should_cancel():
                raise DeitalkError("cancelled; undo to remove the keys written so far")
            task.enter_progress_frame(1, control)
            resampled = {axis: _resampled(data, values, fps) for axis, values in channels.items()}
            if not _set_keys(level_sequence, board, control, resampled, start_frame):
                skipped.append(control)
    unreal.LevelSequenceEditorBlueprintLibrary.refresh_current_level_sequence()
    if skipped:
        _warn(f"this board has no {', '.join(skipped)}; left out")
    say(f"keyed {len(data['board']) - len(skipped)} controls of {rig}")
    return skipped


def live_link_csv(path: str, folder: str = FOLDER, dry_run: bool = False) -> Any:
    """Import a Live Link Face CSV as a Level Sequence with a Live Link track.

    Parameters
    ----------
    path : str
        ``<Slate>_<Take>_<Subject>.csv``; the subject is what you choose as ARKit Face Subject.
    folder : str
        Where the asset goes. It must hold no asset of the file's name: that would be a re-import.
    dry_run : bool
        Print what would be done and change nothing.

    Returns
    -------
    list of str
        Paths of the imported objects; empty in a dry run.
    """
    if not os.path.isfile(path):
        raise DeitalkError(f"{path} does not exist")
    parts = asset_name(path).split("_")
    if len(parts) < 3:
        raise DeitalkError(f"{path}: the name must be <Slate>_<Take>_<Subject>.csv")
    say(f"import {path} into {folder}, Live Link subject {parts[2]!r}")
    if dry_run:
        return []
    need_unreal()
    if unreal.EditorAssetLibrary.does_asset_exist(f"{folder}/{asset_name(path)}"):
        raise DeitalkError(f"{folder}/{asset_name(path)} exists; rename the file or the asset")
    factory = getattr(unreal, "LiveLinkFaceImporterFactory", None)
    if factory is None:
        raise DeitalkError("enable the plugin Live Link Face Importer, then restart the editor")
    task = unreal.AssetImportTask()
    task.filename = path
    task.destination_path = folder
    task.factory = factory()
    task.automated = True
    task.save = True
    unreal.AssetToolsHelpers.get_asset_tools().import_asset_tasks([task])
    return list(task.imported_object_paths)


def load(path: str) -> dict[str, Any]:
    """Read and check a ``*.unreal.json``."""
    try:
        with open(path, encoding="utf-8") as stream:
            data = json.load(stream)
    except (OSError, ValueError) as error:
        raise DeitalkError(f"cannot read {path}: {error}") from error
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise DeitalkError(f"{path} is not of schema {SCHEMA}; write it with deitalk convert")
    n_frames = data.get("n_frames")
    if not isinstance(n_frames, int) or n_frames < 1:
        raise DeitalkError(f"{path}: n_frames is {n_frames!r}; it must be 1 or more")
    channels = list(data.get("raw", {}).values())
    channels += [v for channel in data.get("board", {}).values() for v in channel.values()]
    for values in channels:
        if isinstance(values, list) and len(values) != n_frames:
            raise DeitalkError(f"{path}: a curve has {len(values)} values, not {n_frames}")
    return data


def asset_name(path: str) -> str:
    """Return the file's name as an asset name: letters, digits and underscores."""
    stem = os.path.basename(path).split(".")[0]
    return "".join(c if c.isalnum() or c == "_" else "_" for c in stem)


def _add_curve(sequence: Any, name: str, times: list[float], values: Any) -> None:
    library = unreal.AnimationLibrary
    library.add_curve(sequence, name, unreal.RawCurveTrackTypes.RCT_FLOAT, False)
    if isinstance(values, list):
        library.add_float_curve_keys(sequence, name, times, [float(v) for v in values])
    else:
        ends = [times[0], times[-1]] if len(times) > 1 else [times[0]]
        library.add_float_curve_keys(sequence, name, ends, [float(values)] * len(ends))


def _set_keys(
    sequence: Any, board: Any, control: str, keys: dict[str, list[float]], start: int
) -> bool:
    """Key one control under the name it has on this board; return whether it has one."""
    name = _name_on(board, control)
    if not name:
        return False
    length = max(len(values) for values in keys.values())
    frames = [unreal.FrameNumber(start + i) for i in range(length)]
    library, unit = unreal.ControlRigSequencerLibrary, display_rate()
    if "value" in keys:
        library.set_local_control_rig_floats(sequence, board, name, frames, keys["value"], unit)
        return True
    x, y = (keys[a] * length if len(keys[a]) == 1 else keys[a] for a in ("x", "y"))
    pairs = [unreal.Vector2D(x[i], y[i]) for i in range(length)]
    library.set_local_control_rig_vector2_ds(sequence, board, name, frames, pairs, unit)
    return True


def _name_on(board: Any, control: str) -> str:
    """Return a control's name on this board, or nothing.

    ``CTRL_C_tongue_roll`` is on both generations and means different things: an older board's is
    our ``CTRL_C_tongue_bendTwist``.
    """
    is_older = not has_control(board, "CTRL_C_tongue_move")
    if is_older and control == "CTRL_C_tongue_roll":
        return ""
    name = OLDER_NAMES.get(control, control) if is_older else control
    return name if has_control(board, name) else ""


def has_control(board: Any, name: str) -> bool:
    """Return whether a control rig has a control."""
    key = unreal.RigElementKey(type=unreal.RigElementType.CONTROL, name=name)
    return bool(board.get_hierarchy().contains(key))


def _resampled(data: dict[str, Any], values: Any, fps: float) -> list[float]:
    """Return values at the sequence's rate, linear between frames; one number stays one."""
    if not isinstance(values, list):
        return [float(values)]
    own = data["frame_rate"][0] / data["frame_rate"][1]
    if abs(own - fps) < 1e-3:
        return [float(v) for v in values]
    last = len(values) - 1
    out = []
    for i in range(int(last * fps / own + 1e-6) + 1):
        position = min(i * own / fps, last)
        low = int(position)
        high = min(low + 1, last)
        out.append(values[low] + (position - low) * (values[high] - values[low]))
    return out


def display_rate() -> Any:
    """Return the time unit, whose enum has two names in these versions of Unreal."""
    enum = getattr(unreal, "MovieSceneTimeUnit", None) or unreal.SequenceTimeUnit
    return enum.DISPLAY_RATE


def _new_sequence(name: str, folder: str, skeleton: Any) -> Any:
    if unreal.EditorAssetLibrary.does_asset_exist(f"{folder}/{name}"):
        raise DeitalkError(f"{folder}/{name} exists; give another name")
    factory = unreal.AnimSequenceFactory()
    factory.set_editor_property("target_skeleton", skeleton)
    tools = unreal.AssetToolsHelpers.get_asset_tools()
    sequence = tools.create_asset(name, folder, unreal.AnimSequence, factory)
    if sequence is None:
        raise DeitalkError(f"Unreal did not create {folder}/{name}; is the folder writable?")
    return sequence


def _skeleton(path: str) -> Any:
    for place in (path,) if path else SKELETONS:
        skeleton = unreal.load_asset(place)
        if skeleton is not None:
            return skeleton
    tried = path or ", ".join(SKELETONS)
    raise DeitalkError(f"no skeleton at {tried}; give skeleton='/Game/…/Face_Archetype_Skeleton'")


def find_sequence(path: str) -> Any:
    """Return the Level Sequence at an asset path, or the one open in Sequencer."""
    if path:
        sequence = unreal.load_asset(path)
    else:
        sequence = unreal.LevelSequenceEditorBlueprintLibrary.get_current_level_sequence()
    if sequence is None:
        raise DeitalkError("open a Level Sequence in Sequencer, or give its asset path")
    return sequence


def find_rig(sequence: Any, name: str) -> Any:
    """Return the control rig of a sequence whose name begins with `name`."""
    proxies = unreal.ControlRigSequencerLibrary.get_control_rigs(sequence)
    found = [proxy.control_rig for proxy in proxies]
    for rig in found:
        if rig.get_name().startswith(name):
            return rig
    names = ", ".join(rig.get_name() for rig in found) or "none"
    raise DeitalkError(f"the sequence has no control rig {name} (it has: {names}); add the track")


def _describe(values: Any) -> str:
    if isinstance(values, list):
        return f"{len(values)} keys, {min(values):g} to {max(values):g}"
    return f"constant {values:g}"


def need_unreal() -> None:
    """Raise an error outside the editor."""
    if unreal is None:
        raise DeitalkError("this runs inside the Unreal editor; outside only dry runs work")


def say(text: str) -> None:
    """Print a line in Unreal's log, or on stdout outside the editor."""
    if unreal is None:
        sys.stdout.write(text + "\n")
    else:
        unreal.log(text)


def _warn(text: str) -> None:
    unreal.log_warning(text)


def main(arguments: list[str] | None = None) -> None:
    """Run from a command line, inside Unreal or (dry) outside."""
    parser = argparse.ArgumentParser(description="Bring deitalk animation into Unreal Engine.")
    parser.add_argument("route", choices=("anim", "rig", "livelink"))
    parser.add_argument("path", help="a *.unreal.json, or a Live Link Face CSV for livelink")
    parser.add_argument("--skeleton", default="", help="asset path of the face skeleton (anim)")
    parser.add_argument("--sequence", default="", help="asset path of the Level Sequence (rig)")
    parser.add_argument("--start-frame", type=int, default=0, help="first frame (rig)")
    parser.add_argument("--folder", default=FOLDER, help="folder of new assets")
    parser.add_argument("--dry-run", action="store_true", help="print what would be done")
    options = parser.parse_args(arguments)
    dry = options.dry_run
    if options.route == "anim":
        anim_sequence(options.path, options.skeleton, folder=options.folder, dry_run=dry)
    elif options.route == "rig":
        control_rig(options.path, options.sequence, start_frame=options.start_frame, dry_run=dry)
    else:
        live_link_csv(options.path, options.folder, dry_run=dry)


if __name__ == "__main__":
    main()
