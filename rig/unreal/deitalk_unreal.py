"""Import of deitalk animation into Unreal Engine (5.3 to 5.8), run inside the editor.

Needs nothing but Unreal's own Python (3.9 or later) and a ``*.unreal.json`` that
``deitalk convert take/curves.json speech.unreal.json`` writes. In the editor's Python console::

    import sys; sys.path.append(r"C:/folder/of/this/file")
    import deitalk_unreal as d
    d.anim_sequence(r"C:/take/speech.unreal.json")              # raw curves, one AnimSequence
    d.control_rig(r"C:/take/speech.unreal.json")                # keys on the open Level Sequence
    d.live_link_csv(r"C:/take/speech_take_1_anna.csv")          # Live Link take

or from the command field: ``py "C:/…/deitalk_unreal.py" anim "C:/take/speech.unreal.json"``.
With ``dry_run=True`` (``--dry-run``) every step is printed and nothing is changed; that also works
outside Unreal. Plugins to enable: Python Editor Script Plugin; for ``live_link_csv`` also Live Link
Face Importer.
"""

from __future__ import annotations

import argparse
import os
import sys
from fractions import Fraction
from typing import Any

sys.path.append(os.path.dirname(os.path.abspath(__file__)))
from deitalk_clip import (  # type: ignore[import-not-found]
    DeitalkError,
    asset_name,
    curve_keys,
    describe,
    frame_count,
    key_frames,
    load,
    rate_steps,
    resampled,
    standard_rate,
    subject_of,
)

try:
    import unreal  # type: ignore[import-not-found]
except ImportError:  # outside the editor: dry runs only
    unreal = None

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
    rate = standard_rate(data)
    n_frames = frame_count(data, rate)
    raw = {curve: resampled(data, values, rate) for curve, values in data["raw"].items()}
    say(f"AnimSequence {folder}/{name}: {len(raw)} curves, {n_frames} frames at {rate} fps")
    if dry_run:
        for curve, values in raw.items():
            say(f"  {curve}: {describe(values)}")
        return None
    need_unreal()
    sequence = _new_sequence(name, folder, _skeleton(skeleton))
    try:
        _fill(sequence, raw, rate, n_frames)
    except BaseException:
        unreal.EditorAssetLibrary.delete_asset(f"{folder}/{name}")
        raise
    unreal.EditorAssetLibrary.save_loaded_asset(sequence)
    say(f"saved {folder}/{name}; drag it onto the Face track, then Bake to Control Rig to edit it")
    return sequence


def control_rig(
    path: str,
    sequence: str = "",
    rig: str = BOARD,
    start_frame: int = 0,
    dry_run: bool = False,
    tolerance: float = 0.0,
    still: bool = True,
) -> list[str]:
    """Key the face board in a Level Sequence; one that never moves gets one key.

    Keys are written to the channels of the rig's section. Unreal's setters of controls take about
    35 ms a key, and change nothing unless Sequencer has the sequence open. Keys that lie within the
    clip are replaced; the last one of the channel that moves most is read back.

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
    tolerance : float
        Leave keys out where cubic curves through the others stay this near: 0.01 leaves an eighth.
    still : bool
        Key controls that move less than the tolerance, once.

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
            keys = ", ".join(f"{axis} {describe(values)}" for axis, values in channels.items())
            say(f"  {control} ({kind}): {keys}")
        return []
    need_unreal()
    level_sequence = find_sequence(sequence)
    proxy = find_proxy(level_sequence, rig)
    display = level_sequence.get_display_rate()
    fps = Fraction(display.numerator, display.denominator)
    last = start_frame + frame_count(data, fps) - 1
    resolution = level_sequence.get_tick_resolution()
    ticks = float(Fraction(resolution.numerator, resolution.denominator) / fps)
    section, skipped, written = channels_of_rig(proxy), [], []
    title = "deitalk: keys on the face board"
    with unreal.ScopedEditorTransaction(title):
        with unreal.ScopedSlowTask(len(data["board"]), title) as task:
            task.make_dialog(True)
            for control, axes in data["board"].items():
                if task.should_cancel():
                    raise DeitalkError("cancelled; undo to remove the keys written so far")
                task.enter_progress_frame(1, control)
                channels = _channels_of(proxy.control_rig, section, control, axes)
                if not channels:
                    skipped.append(control)
                for axis, channel in channels.items():
                    values = resampled(data, axes[axis], fps)
                    if not still and max(values) - min(values) <= tolerance:
                        continue
                    n_keys = write_channel(channel, values, start_frame, last, tolerance, ticks)
                    written.append((max(values) - min(values), n_keys, channel, values[-1]))
    unreal.LevelSequenceEditorBlueprintLibrary.refresh_current_level_sequence()
    if skipped:
        unreal.log_warning(f"this board has no {', '.join(skipped)}; left out")
    _check_written(written, rig)
    n_keys = sum(n for _, n, _, _ in written)
    n_controls = len(data["board"]) - len(skipped)
    say(f"wrote {n_keys} keys of {n_controls} controls of {rig}, frames {start_frame} to {last}")
    return skipped


def live_link_csv(path: str, folder: str = FOLDER, dry_run: bool = False) -> Any:
    """Import a Live Link Face CSV as a Level Sequence with a Live Link track.

    Parameters
    ----------
    path : str
        Live Link Face CSV; its subject, see `subject_of`, is chosen as ARKit Face Subject.
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
    say(f"import {path} into {folder}, Live Link subject {subject_of(path)!r}")
    if dry_run:
        return []
    need_unreal()
    if unreal.EditorAssetLibrary.does_asset_exist(f"{folder}/{asset_name(path)}"):
        raise DeitalkError(f"{folder}/{asset_name(path)} exists; rename the file or the asset")
    factory = getattr(unreal, "LiveLinkFaceImporterFactory", None)
    if factory is None:
        raise DeitalkError("enable the plugin Live Link Face Importer, then restart the editor")
    task = import_file(path, folder, factory=factory())
    if task.imported_object_paths:
        return list(task.imported_object_paths)
    raise DeitalkError(f"Unreal refuses {path}; run: deitalk validate {path}")


def import_file(path: str, folder: str, **options: Any) -> Any:
    """Import a file into a folder without questions; return the task, whose properties are set."""
    task = unreal.AssetImportTask()
    wanted = {"filename": path, "destination_path": folder, "automated": True, "save": True}
    for name, value in {**wanted, **options}.items():
        setattr(task, name, value)
    unreal.AssetToolsHelpers.get_asset_tools().import_asset_tasks([task])
    return task


def _fill(sequence: Any, raw: dict[str, list[float]], rate: Fraction, n_frames: int) -> None:
    """Set rate and length of a new AnimSequence and add its curves, without an undo step."""
    controller = sequence.controller
    controller.open_bracket("deitalk", False)
    try:
        for step in rate_steps(_rate_of(controller), rate):
            controller.set_frame_rate(unreal.FrameRate(step.numerator, step.denominator), False)
        if _rate_of(controller) != rate:
            raise DeitalkError(f"Unreal keeps {_rate_of(controller)} fps and refuses {rate}")
        # a sequence has one key more than frames
        controller.set_number_of_frames(unreal.FrameNumber(max(n_frames - 1, 1)), False)
        times = [float(i / rate) for i in range(n_frames)]
        library = unreal.AnimationLibrary
        for name, values in raw.items():
            at = times if len(values) == n_frames else [times[0], times[-1]]
            numbers = values if len(values) == n_frames else [values[0]] * 2
            library.add_curve(sequence, name, unreal.RawCurveTrackTypes.RCT_FLOAT, False)
            library.add_float_curve_keys(sequence, name, at, numbers)
    finally:
        controller.close_bracket(False)


def _rate_of(controller: Any) -> Fraction:
    rate = controller.get_model_interface().get_frame_rate()
    return Fraction(rate.numerator, rate.denominator)


def channels_of_rig(proxy: Any) -> dict[str, Any]:
    """Return the channels of a rig's section by lower-case name, ``ctrl_c_jaw.x``.

    Names of the objects end in a number of their own, ``CTRL_C_jaw.X_41``.
    """
    sections = proxy.track.get_sections()
    section = sections[0] if sections else proxy.track.add_section()
    channels = {}
    for channel in section.get_all_channels():
        name = str(channel.get_name()).lower()
        stem, _, number = name.rpartition("_")
        channels[stem if number.isdigit() else name] = channel
    return channels


def _channels_of(board: Any, section: dict[str, Any], control: str, axes: Any) -> dict[str, Any]:
    """Return the channels of one control by axis; none if this board has no such control."""
    name = _name_on(board, control).lower()
    names = {axis: name if axis == "value" else f"{name}.{axis}" for axis in axes}
    has_all = all(full in section for full in names.values())
    return {axis: section[full] for axis, full in names.items()} if name and has_all else {}


def write_channel(
    channel: Any,
    values: list[float],
    start: int,
    last: int,
    tolerance: float = 0.0,
    ticks: float = 800.0,
) -> int:
    """Replace the keys from start to last; return how many there are now.

    With a tolerance they are cubic, with slopes per tick, as the channel evaluates them: `ticks`
    is their number in a frame of the display rate.
    """
    for key in channel.get_keys():
        if start <= key.get_time(display_rate()).frame_number.value <= last:
            channel.remove_key(key)
    if not tolerance:
        linear, keyed = unreal.MovieSceneKeyInterpolation.LINEAR, key_frames(values)
        for i in keyed:
            channel.add_key(unreal.FrameNumber(start + i), values[i], 0.0, display_rate(), linear)
        return len(keyed)
    keys = curve_keys(values, tolerance)
    for i, arrive, leave in keys:
        broken = unreal.MovieSceneKeyInterpolation.BREAK
        key = channel.add_key(unreal.FrameNumber(start + i), values[i], 0.0, display_rate(), broken)
        key.set_interpolation_mode(unreal.RichCurveInterpMode.RCIM_CUBIC)
        key.set_tangent_mode(unreal.RichCurveTangentMode.RCTM_BREAK)
        key.set_tangent_weight_mode(unreal.RichCurveTangentWeightMode.RCTWM_WEIGHTED_NONE)
        key.set_arrive_tangent(arrive / ticks)
        key.set_leave_tangent(leave / ticks)
    return len(keys)


def _check_written(written: list[Any], rig: str) -> None:
    """Read the last key of the channel that moves most."""
    if not written:
        raise DeitalkError(f"the section of {rig} has none of the channels; add the track again")
    _, _, channel, value = max(written, key=lambda entry: entry[0])
    keys = sorted(channel.get_keys(), key=lambda k: k.get_time(display_rate()).frame_number.value)
    if not any(abs(key.get_value() - value) < 1e-4 for key in keys):
        raise DeitalkError(f"{channel.get_name()} of {rig} does not hold the key just written")


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


def file_of(sound: Any) -> str:
    """Return the file that a SoundWave was imported from; empty if none is known."""
    source = sound.get_editor_property("asset_import_data")
    return str(source.get_first_filename()) if source is not None else ""


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
    tried = path or " or ".join(SKELETONS)
    raise DeitalkError(f"no skeleton at {tried}; give the face's: skeleton='/Game/…'")


def find_sequence(path: str) -> Any:
    """Return the Level Sequence at an asset path, opened, or the one open in Sequencer."""
    library = unreal.LevelSequenceEditorBlueprintLibrary
    current = library.get_current_level_sequence()
    sequence = unreal.load_asset(path) if path else current
    if not isinstance(sequence, unreal.LevelSequence):
        raise DeitalkError("open a Level Sequence in Sequencer, or give its asset path")
    if sequence != current and not library.open_level_sequence(sequence):
        raise DeitalkError(f"Sequencer does not open {path}; open it there, then try again")
    return sequence


def find_proxy(sequence: Any, name: str) -> Any:
    """Return the control rig whose name begins with `name`, with its track."""
    found = unreal.ControlRigSequencerLibrary.get_control_rigs(sequence)
    for proxy in found:
        if proxy.control_rig.get_name().startswith(name):
            return proxy
    names = ", ".join(proxy.control_rig.get_name() for proxy in found) or "none"
    raise DeitalkError(f"the sequence has no control rig {name} (it has: {names}); add the track")


def need_unreal() -> None:
    """Raise an error outside the editor."""
    if unreal is None:
        raise DeitalkError("this runs inside the Unreal editor; outside only dry runs work")


def say(text: str) -> None:
    """Print a line in Unreal's log, or on stdout outside the editor."""
    write = unreal.log if unreal else lambda line: sys.stdout.write(line + "\n")
    write(text)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> Any:
        raise DeitalkError(f"{message}; such as: py deitalk_unreal.py anim C:/take/x.unreal.json")


def main(arguments: list[str] | None = None) -> None:
    """Run from a command line, inside Unreal or (dry) outside; a mistake is one line."""
    parser = _Parser(description="Bring deitalk animation into Unreal Engine.")
    parser.add_argument("route", choices=("anim", "rig", "livelink"))
    parser.add_argument("path", help="a *.unreal.json, or a Live Link Face CSV for livelink")
    parser.add_argument("--skeleton", default="", help="asset path of the face skeleton (anim)")
    parser.add_argument("--sequence", default="", help="asset path of the Level Sequence (rig)")
    parser.add_argument("--start-frame", type=int, default=0, help="first frame (rig)")
    parser.add_argument("--folder", default=FOLDER, help="folder of new assets")
    parser.add_argument("--dry-run", action="store_true", help="print what would be done")
    try:
        given = parser.parse_args(arguments)
        dry = given.dry_run
        if given.route == "anim":
            anim_sequence(given.path, given.skeleton, folder=given.folder, dry_run=dry)
        elif given.route == "rig":
            control_rig(given.path, given.sequence, start_frame=given.start_frame, dry_run=dry)
        else:
            live_link_csv(given.path, given.folder, dry_run=dry)
    except DeitalkError as error:
        if unreal is None:
            raise SystemExit(f"error: {error}") from None
        unreal.log_error(f"deitalk: {error}")


if __name__ == "__main__":
    main()
