"""Menu *deitalk* of the Unreal editor (5.3 to 5.8): a recording on a MetaHuman in one step.

``deitalk install unreal C:/Projects/MyGame`` lays this file and the others into the project, once;
the editor then has a menu *deitalk* with *Animate audio…*, also in the context menu of sounds.
From the editor's Python console::

    import deitalk_menu as m
    m.animate_audio(r"C:/audio/line_12.wav", emotion="happy", intensity=1.2)

The sound is animated by the deitalk of this computer (`deitalk_call`), imported as an AnimSequence
(`deitalk_unreal`) and placed with its sound on the MetaHuman (`deitalk_place`).
"""

from __future__ import annotations

import os
from typing import Any

import deitalk_call  # type: ignore[import-not-found]
import deitalk_place as placing  # type: ignore[import-not-found]
import deitalk_unreal as importer  # type: ignore[import-not-found]

unreal = importer.unreal
DeitalkError = importer.DeitalkError
TITLE = "deitalk"
MAIN_MENU = "LevelEditor.MainMenu"
SOUND_MENU = "ContentBrowser.AssetContextMenu.SoundWave"
SECTION = "deitalk"
CALL = "import deitalk_menu; deitalk_menu."
EASING = 0.03
"""Share of the remaining progress bar that is filled at each tick."""
_kept: dict[str, Any] = {}
"""Types and objects that the garbage collection of Unreal must not remove."""


def animate_audio(
    sound: Any,
    emotion: str = "neutral",
    intensity: float = 1.0,
    actor: str = "",
    start_frame: int | None = None,
    on_board: bool = False,
    at_timecode: bool = False,
    folder: str = importer.FOLDER,
) -> Any:
    """Animate a sound and place both on a MetaHuman in the open or a new Level Sequence.

    Parameters
    ----------
    sound : unreal.SoundWave or str
        An asset, its path (``/Game/…``), or a sound file.
    emotion : str
        As of ``deitalk animate``: neutral, angry, happy, sad, surprised, auto, or weights.
    intensity : float
        Factor on the intensity predicted from the voice, 0 to 4.
    actor : str
        Label of the MetaHuman; by default the selected or the only one of the level.
    start_frame : int, optional
        In the display rate of the sequence; by default the start of its playback.
    on_board : bool
        Keys on the face board, whose track must be in the sequence, instead of an AnimSequence.
    at_timecode : bool
        Start at the time code of the recording (chunk ``bext`` of a WAV) instead.
    folder : str
        Of new assets.

    Returns
    -------
    unreal.AnimSequence, or None with `on_board`
    """
    importer.need_unreal()
    face = None if on_board else placing.find_face(actor)
    recording, asset = _recording(sound)
    name = importer.asset_name(asset.get_name() if asset is not None else recording)
    data = _animated(recording, name, emotion, intensity, at_timecode)
    asset = asset or placing.import_sound(recording, folder)
    animation = None
    if not on_board:
        free = placing.free_name(f"{name}_{importer.asset_name(emotion)}", folder)
        skeleton = placing.skeleton_of(face)
        animation = importer.anim_sequence(data, skeleton, name=free, folder=folder)
    clip = importer.load(data)
    rate = importer.standard_rate(clip)
    frame_rate = unreal.FrameRate(rate.numerator, rate.denominator)
    sequence = placing.open_sequence(name, frame_rate, folder)
    if at_timecode:
        start_frame = placing.frame_of(clip.get("start", 0.0), sequence)
    start, stop = placing.place(animation, asset, face, sequence, start_frame, folder)
    if on_board:
        importer.control_rig(data, start_frame=start)
    importer.say(f"{name}, {emotion}: placed on frames {start} to {stop}")
    return animation


def animate_selected(emotion: str = "neutral") -> Any:
    """Animate the sound that is selected in the Content Browser, with intensity 1."""
    return _guarded(lambda: animate_audio(_selected_sound(needed=True), emotion))


def open_dialog() -> Any:
    """Ask for sound, emotion and intensity in a window, then `animate_audio`."""
    return _guarded(_asked)


def register() -> bool:
    """Add the menus; False while the editor's main menu does not exist yet."""
    importer.need_unreal()
    menus = unreal.ToolMenus.get()
    main = menus.find_menu(MAIN_MENU)
    if main is None:
        return False
    sounds = menus.extend_menu(SOUND_MENU)  # it is built when it is first opened
    own = main.add_sub_menu(MAIN_MENU, "", TITLE, TITLE, "Facial animation from speech")
    of_sounds = sounds.add_sub_menu(SOUND_MENU, "GetAssetActions", TITLE, TITLE, "")
    for menu in (own, of_sounds):
        _add(menu, "animate", "Animate audio…", "open_dialog()", "Choose sound and emotion")
        for emotion in deitalk_call.EMOTIONS:
            label = f"Animate the selected sound: {emotion}"
            _add(menu, emotion, label, f"animate_selected({emotion!r})", "With intensity 1")
    menus.refresh_all_widgets()
    return True


def register_when_ready() -> None:
    """Add the menus at the first tick that has a main menu, which start scripts precede."""

    def on_tick(_seconds: float) -> None:
        if register():
            unreal.unregister_slate_post_tick_callback(_kept.pop("tick"))

    _kept["tick"] = unreal.register_slate_post_tick_callback(on_tick)


def _add(menu: Any, name: str, label: str, call: str, tip: str) -> None:
    entry = unreal.ToolMenuEntry(name=f"deitalk_{name}", type=unreal.MultiBlockType.MENU_ENTRY)
    entry.set_label(label)
    entry.set_tool_tip(tip)
    entry.set_string_command(unreal.ToolMenuStringCommandType.PYTHON, "", CALL + call)
    menu.add_menu_entry(SECTION, entry)


def _recording(sound: Any) -> tuple[str, Any]:
    """Return the file of a sound, and its asset if it is one already."""
    if isinstance(sound, str) and sound.startswith("/"):
        loaded = unreal.load_asset(sound)
        if loaded is not None:
            sound = loaded
    if isinstance(sound, str):
        if not os.path.isfile(sound):
            raise DeitalkError(f"no sound at {sound!r}; give a file or an asset path (/Game/…)")
        return sound, None
    if not isinstance(sound, unreal.SoundWave):
        raise DeitalkError(f"{sound} is no SoundWave; choose a sound")
    return placing.export_sound(sound, _saved("sounds")), sound


def _saved(name: str) -> str:
    """Return a folder below ``Saved/deitalk`` of the project."""
    saved = unreal.Paths.convert_relative_path_to_full(unreal.Paths.project_saved_dir())
    return os.path.join(str(saved), "deitalk", name)


def _animated(recording: str, name: str, emotion: str, intensity: float, at_timecode: bool) -> str:
    """Return the file for Unreal, with a bar of progress that can be cancelled."""
    title = f"deitalk animates {os.path.basename(recording)}"
    with unreal.ScopedSlowTask(1.0, title) as task:
        task.make_dialog(True)
        left = [1.0]

        def tick() -> None:
            if task.should_cancel():
                raise DeitalkError("cancelled; nothing was changed")
            task.enter_progress_frame(EASING * left[0], title)
            left[0] *= 1 - EASING

        more = {"timecode": "recording" if at_timecode else "zero", "tick": tick}
        return str(deitalk_call.animate(recording, _saved(name), emotion, intensity, **more))


def _selected_sound(needed: bool) -> Any:
    assets = unreal.EditorUtilityLibrary.get_selected_assets()
    sounds = [asset for asset in assets if isinstance(asset, unreal.SoundWave)]
    if needed and len(sounds) != 1:
        raise DeitalkError(f"select one sound in the Content Browser; {len(sounds)} are selected")
    return sounds[0] if sounds else None


def _asked() -> Any:
    options = unreal.new_object(_options_type())
    options.set_editor_property("sound", _selected_sound(needed=False))
    options.set_editor_property("intensity", 1.0)
    _kept["options"] = options
    if not unreal.EditorDialog.show_object_details_view("Animate audio", options):
        return None
    chosen = options.get_editor_property("sound")
    path = options.get_editor_property("file").get_editor_property("file_path")
    if chosen is None and not path:
        raise DeitalkError("choose a sound asset or a sound file")
    emotion = str(options.get_editor_property("emotion").name).lower()
    intensity = float(options.get_editor_property("intensity"))
    on_board = bool(options.get_editor_property("on_board"))
    return animate_audio(chosen or str(path), emotion, intensity, on_board=on_board)


def _options_type() -> Any:
    """Return the class whose properties the window shows, made once per session."""
    if "type" in _kept:
        return _kept["type"]
    names = {name.upper(): unreal.uvalue(i) for i, name in enumerate(deitalk_call.EMOTIONS)}
    kind = unreal.uenum()(type("DeitalkEmotion", (unreal.EnumBase,), names))
    most = {"ClampMin": "0", "ClampMax": "4"}
    tips = {"ToolTip": "Keys on the face board, whose track is in the sequence, to edit by hand"}

    class DeitalkAudio(unreal.Object):  # type: ignore[misc, name-defined]
        sound = unreal.uproperty(unreal.SoundWave)
        file = unreal.uproperty(unreal.FilePath, meta={"FilePathFilter": "wav"})
        emotion = unreal.uproperty(kind)
        intensity = unreal.uproperty(float, meta=most)
        on_board = unreal.uproperty(bool, meta=tips)

    _kept["type"] = unreal.uclass()(DeitalkAudio)
    return _kept["type"]


def _guarded(action: Any) -> Any:
    """Run an action of the menu; a mistake is one line in the log and in a message."""
    try:
        return action()
    except DeitalkError as error:
        unreal.log_error(f"deitalk: {error}")
        unreal.EditorDialog.show_message(TITLE, str(error), unreal.AppMsgType.OK)
        return None
