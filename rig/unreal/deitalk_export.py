"""Export of captured animation from Unreal Engine (5.3 to 5.8) for deitalk, run inside the editor.

Lies beside ``deitalk_unreal.py`` and needs nothing else. In the editor's Python console::

    import sys; sys.path.append(r"C:/folder/of/this/file")
    import deitalk_export as e
    e.anim_sequence("/Game/Capture/AS_anna_happy_1", r"C:/captures", audio="anna_happy_1.wav")
    e.anim_folder("/Game/Capture", r"C:/captures")       # every AnimSequence with face curves
    e.level_sequence(r"C:/captures")                     # the board in the open Level Sequence

Each writes a ``<name>.unreal.json`` with the rate, the curves and the name of the sound; lay the
recording beside it, then ``deitalk data import C:/captures -o data/``. Plugin to enable: Python
Editor Script Plugin.
"""

from __future__ import annotations

import json
import os
from typing import Any

import deitalk_clip  # type: ignore[import-not-found]
import deitalk_unreal as importer  # type: ignore[import-not-found]

RAW_PREFIX = "ctrl_expressions_"
"""Lower case: some versions give names of curves as they were first spelt in the editor."""
RATES: list[tuple[int, int]] = [rate.as_integer_ratio() for rate in deitalk_clip.RATES]
DECIMALS = 6
STILL = 5e-7


def anim_sequence(
    asset: str, folder: str, audio: str = "", frame_rate: tuple[int, int] | None = None
) -> str:
    """Write the raw face curves of an AnimSequence, such as MetaHuman Animator exports.

    Parameters
    ----------
    asset : str
        Asset path.
    folder : str
        Folder on disk; it is made if it is missing.
    audio : str
        File name of the recording; empty: it is called as the asset.
    frame_rate : (int, int), optional
        Numerator and denominator; by default that of the keys.

    Returns
    -------
    str
        Path of the file.
    """
    importer.need_unreal()
    sequence = importer.unreal.load_asset(asset)
    if sequence is None:
        raise importer.DeitalkError(f"no asset at {asset}; copy its reference path")
    library = importer.unreal.AnimationLibrary
    names = [name for name in _curve_names(sequence) if name.lower().startswith(RAW_PREFIX)]
    if not names:
        raise importer.DeitalkError(
            f"{asset} has no CTRL_expressions curves; export the performance with face curves"
        )
    times = {name: _keys(sequence, name)[0] for name in names}
    rate = frame_rate or _rate_of(max(times.values(), key=len), asset)
    n_frames = round(float(library.get_sequence_length(sequence)) * rate[0] / rate[1]) + 1
    grid = [i * rate[1] / rate[0] for i in range(n_frames)]
    raw = {name: _sampled(sequence, name, grid) for name in names if times[name]}
    head = _head(sequence, grid)
    name = str(importer.asset_name(asset.rsplit("/", 1)[-1]))
    return _write(folder, name, rate, n_frames, raw=raw, head=head, audio=audio)


def anim_folder(content: str, folder: str) -> list[str]:
    """Write every AnimSequence with raw face curves below a content folder.

    Returns
    -------
    list of str
        Paths of the files.
    """
    importer.need_unreal()
    written = []
    for path in importer.unreal.EditorAssetLibrary.list_assets(content, recursive=True):
        asset = importer.unreal.load_asset(str(path))
        if not isinstance(asset, importer.unreal.AnimSequence):
            continue
        if any(name.lower().startswith(RAW_PREFIX) for name in _curve_names(asset)):
            written.append(anim_sequence(str(path), folder))
    if not written:
        raise importer.DeitalkError(f"no AnimSequence with face curves below {content}")
    return written


def level_sequence(
    folder: str, sequence: str = "", rig: str = importer.BOARD, audio: str = ""
) -> str:
    """Write the face board of a Level Sequence, from the start of its sound to the end of playback.

    Parameters
    ----------
    folder : str
        Folder on disk; it is made if it is missing.
    sequence : str
        Asset path; the one open in Sequencer if it is empty.
    rig : str
        Name of the control rig.
    audio : str
        File name of the recording; empty: that of the sequence's audio track, if it has one.

    Returns
    -------
    str
        Path of the file.
    """
    importer.need_unreal()
    unreal = importer.unreal
    opened = importer.find_sequence(sequence)
    board = importer.find_proxy(opened, rig).control_rig
    display = opened.get_display_rate()
    sound, start = _sound(opened)
    stop = int(opened.get_playback_end())
    if stop <= start:
        raise importer.DeitalkError(f"playback ends at frame {stop}, sound starts at {start}")
    frames = [unreal.FrameNumber(i) for i in range(start, stop)]
    library, unit = unreal.ControlRigSequencerLibrary, importer.display_rate()
    channels: dict[str, dict[str, Any]] = {}
    is_older = not importer.has_control(board, "CTRL_C_tongue_move")
    present = {old: new for new, old in importer.OLDER_NAMES.items()} if is_older else {}
    for name, kind in _controls(board):
        spelling = present.get(name, name)
        if kind == "float":
            values = library.get_local_control_rig_floats(opened, board, name, frames, unit)
            channels[spelling] = {"value": _rounded(values)}
        else:
            pairs = library.get_local_control_rig_vector2_ds(opened, board, name, frames, unit)
            channels[spelling] = {
                "x": _rounded([pair.x for pair in pairs]),
                "y": _rounded([pair.y for pair in pairs]),
            }
    rate = (int(display.numerator), int(display.denominator))
    return _write(
        folder, opened.get_name(), rate, len(frames), board=channels, audio=audio or sound
    )


def _head(sequence: Any, grid: list[float]) -> dict[str, Any] | None:
    """Return the head track of an AnimSequence; None without one, or with its switch at 0."""
    spelt = {name.lower(): name for name in _curve_names(sequence)}
    keys = {}
    for name in ("HeadControlSwitch", *deitalk_clip.TURNS, *deitalk_clip.SHIFTS):
        if name.lower() in spelt:
            keys[name] = _sampled(sequence, spelt[name.lower()], grid)
    switch = keys.pop("HeadControlSwitch", 1.0)
    if "HeadYaw" not in keys or switch == 0:
        return None
    track: dict[str, Any] = deitalk_clip.head_of_curves(keys)
    return track


def _curve_names(sequence: Any) -> list[str]:
    unreal = importer.unreal
    kind = unreal.RawCurveTrackTypes.RCT_FLOAT
    return [str(n) for n in unreal.AnimationLibrary.get_animation_curve_names(sequence, kind)]


def _rate_of(times: list[float], asset: str) -> tuple[int, int]:
    """Return the rate of a curve's keys: a standard one."""
    if len(times) < 2 or times[-1] <= times[0]:
        raise importer.DeitalkError(f"{asset} has too few keys; give frame_rate=(30, 1)")
    steps = sorted(b - a for a, b in zip(times, times[1:]) if b > a)  # noqa: B905, RUF007
    step = steps[len(steps) // 2]
    # the mean is finer than one step, where no key was removed
    mean = (times[-1] - times[0]) / (len(times) - 1) if steps[-1] < 1.5 * step else step
    rate = min(RATES, key=lambda r: abs(r[0] / r[1] * mean - 1))
    if abs(rate[0] / rate[1] * step - 1) > 0.02:
        raise importer.DeitalkError(f"{asset}: keys {step:g} s apart; give frame_rate=(30, 1)")
    return rate


def _sampled(sequence: Any, name: str, grid: list[float]) -> Any:
    """Return a curve's values at the times of a grid; one number if they are equal."""
    times, values = _keys(sequence, name)
    return _rounded([deitalk_clip.interpolated(times, values, t) for t in grid])


def _keys(sequence: Any, name: str) -> tuple[list[float], list[float]]:
    times, values = importer.unreal.AnimationLibrary.get_float_keys(sequence, name)
    return [float(t) for t in times], [float(v) for v in values]


def _rounded(values: Any) -> Any:
    numbers = [float(value) for value in values]
    if max(numbers) - min(numbers) < STILL:
        return round(numbers[0], DECIMALS)
    return [round(number, DECIMALS) for number in numbers]


def _controls(board: Any) -> list[tuple[str, str]]:
    """Return the names of the float and Vector2D controls and their kind."""
    unreal = importer.unreal
    kinds = {unreal.RigControlType.FLOAT: "float", unreal.RigControlType.VECTOR2D: "Vector2D"}
    hierarchy = board.get_hierarchy()
    found = []
    for key in hierarchy.get_all_keys(True):
        if key.type == unreal.RigElementType.CONTROL:
            kind = kinds.get(hierarchy.get_control_settings(key).control_type)
            if kind:
                found.append((str(key.name), kind))
    return found


def _sound(sequence: Any) -> tuple[str, int]:
    """Return the file name of the first sound, and the frame at which it starts."""
    unreal = importer.unreal
    for track in sequence.find_tracks_by_type(unreal.MovieSceneAudioTrack):
        for section in track.get_sections():
            sound = section.get_editor_property("sound")
            if sound is None:
                continue
            path = importer.file_of(sound)
            name = path.replace("\\", "/").rsplit("/", 1)[-1] or str(sound.get_name())
            return name, int(section.get_start_frame())
    return "", int(sequence.get_playback_start())


def _write(
    folder: str,
    name: str,
    rate: tuple[int, int],
    n_frames: int,
    *,
    raw: dict[str, Any] | None = None,
    board: dict[str, Any] | None = None,
    head: dict[str, Any] | None = None,
    audio: str = "",
) -> str:
    """Write the file beside its place, then rename it."""
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, f"{name}.unreal.json")
    data = {
        "schema": deitalk_clip.SCHEMA,
        "frame_rate": list(rate),
        "n_frames": n_frames,
        "audio": audio,
        "raw": raw or {},
        "board": board or {},
    }
    data.update({"head": head} if head else {})
    with open(path + ".part", "w", encoding="utf-8") as stream:
        json.dump(data, stream)
    os.replace(path + ".part", path)
    count = len(raw or board or {})
    importer.say(f"{path}: {count} curves, {n_frames} frames, sound {audio or 'not named'}")
    return path
