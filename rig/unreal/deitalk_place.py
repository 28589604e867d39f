"""Place an animation and its sound on a MetaHuman in a Level Sequence, run inside the editor.

Used by ``deitalk_menu.py``; alone in the editor's Python console::

    import deitalk_place as p
    p.place(p.unreal.load_asset("/Game/deitalk/speech"), p.import_sound(r"C:/take/speech.wav"))
"""

from __future__ import annotations

import math
import os
from typing import Any

import deitalk_clip  # type: ignore[import-not-found]
import deitalk_unreal as importer  # type: ignore[import-not-found]

unreal = importer.unreal
DeitalkError = importer.DeitalkError
LIVE_LINK = (
    "/MetaHumanCharacter/Animation/ABP_MH_LiveLink",
    "/Game/MetaHumans/Common/Animation/ABP_MH_LiveLink",
)
"""Epic's animation blueprint of a face that shows a subject, since 5.6 and before."""
SUBJECT, SUBJECT_CLASS = "LLink_Face_Subj", "ABP_MH_LiveLink_C"
FACE = "Face"
"""Name of the component of a MetaHuman's face; 5.6's assembled characters have it too."""


def faces() -> dict[str, Any]:
    """Return the face components of the level by the label of their actor, the selected first.

    With MetaHumans selected, only they are returned.
    """
    importer.need_unreal()
    actors = unreal.get_editor_subsystem(unreal.EditorActorSubsystem)
    for chosen in (actors.get_selected_level_actors(), actors.get_all_level_actors()):
        found = {str(actor.get_actor_label()): face_of(actor) for actor in chosen}
        found = {label: face for label, face in found.items() if face is not None}
        if found:
            return found
    return {}


def face_of(actor: Any) -> Any:
    """Return the face component of an actor, or None."""
    for component in actor.get_components_by_class(unreal.SkeletalMeshComponent):
        if str(component.get_name()) == FACE:
            return component
    return None


def find_face(actor: str = "") -> Any:
    """Return the face of the actor with a label; by default of the selected or the only MetaHuman.

    Raises
    ------
    DeitalkError
        If there is none, or more than one to choose from.
    """
    found = faces()
    if actor:
        everything = unreal.get_editor_subsystem(unreal.EditorActorSubsystem).get_all_level_actors()
        named = [a for a in everything if str(a.get_actor_label()) == actor]
        found = {actor: face_of(named[0])} if named and face_of(named[0]) else {}
    if not found:
        raise DeitalkError(
            f"no actor {actor + ' ' if actor else ''}with a component {FACE}: drag a MetaHuman "
            "into the level and select it"
        )
    if len(found) > 1:
        raise DeitalkError(f"select one MetaHuman: {', '.join(sorted(found))}")
    return next(iter(found.values()))


def skeleton_of(face: Any) -> str:
    """Return the asset path of the skeleton of a face component; empty if it has no mesh."""
    mesh = face.get_skeletal_mesh_asset()
    skeleton = mesh.get_editor_property("skeleton") if mesh is not None else None
    return str(skeleton.get_path_name()).split(".")[0] if skeleton is not None else ""


def import_sound(path: str, folder: str = importer.FOLDER, name: str = "") -> Any:
    """Import a sound file as a SoundWave; one of the same file is imported again.

    A SoundWave of another file that has the name stays: the new one gets a free name.

    Raises
    ------
    DeitalkError
        If Unreal does not import the file.
    """
    importer.need_unreal()
    name = name or f"{importer.asset_name(path)}_sound"
    there = unreal.load_asset(f"{folder}/{name}")
    if there is not None and not _is_sound_of(there, path):
        name = free_name(name, folder)
    importer.import_file(path, folder, destination_name=name, replace_existing=True)
    sound = unreal.load_asset(f"{folder}/{name}")
    if not isinstance(sound, unreal.SoundWave):
        raise DeitalkError(f"Unreal does not import {path}; it takes wav, ogg, flac and aiff")
    return sound


def _is_sound_of(asset: Any, path: str) -> bool:
    """Whether an asset is a SoundWave that was imported from a file."""
    first = importer.file_of(asset) if isinstance(asset, unreal.SoundWave) else ""
    ours, theirs = (os.path.normcase(os.path.abspath(name)) for name in (path, first))
    return bool(first) and ours == theirs


def export_sound(sound: Any, folder: str) -> str:
    """Return the file of a SoundWave: the one it was imported from, or a WAV written to a folder.

    Raises
    ------
    DeitalkError
        If there is no such file and Unreal does not write one.
    """
    path: str = importer.file_of(sound)
    if path and os.path.isfile(path):
        return path
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, f"{sound.get_name()}.wav")
    task = unreal.AssetExportTask()
    task.object = sound
    task.exporter = unreal.SoundExporterWAV()
    task.filename = path
    task.automated = True
    task.prompt = False
    task.replace_identical = True
    if not unreal.Exporter.run_asset_export_task(task) or not os.path.isfile(path):
        raise DeitalkError(f"Unreal does not write {sound.get_name()} as WAV; choose its file")
    return path


def choose_subject(subject: str, actor: str = "") -> None:
    """Let the face of a MetaHuman show a Live Link subject, as its *Live Link* details would.

    The face gets Epic's animation blueprint for Live Link, whose variable holds the subject.

    Parameters
    ----------
    subject : str
        Name in the Live Link window.
    actor : str
        Label; by default the selected or the only MetaHuman.

    Raises
    ------
    DeitalkError
        If there is no such blueprint, or it does not take the name.
    """
    face = find_face(actor)
    paths = [path for path in LIVE_LINK if unreal.EditorAssetLibrary.does_asset_exist(path)]
    if not paths:
        raise DeitalkError(f"no blueprint at {' or '.join(LIVE_LINK)}; enable the plugin Live Link")
    face.set_anim_instance_class(unreal.load_class(None, f"{paths[0]}.{SUBJECT_CLASS}"))
    face.set_update_animation_in_editor(True)
    instance = face.get_anim_instance()
    instance.set_editor_property(SUBJECT, unreal.LiveLinkSubjectName(subject))
    kept = instance.get_editor_property(SUBJECT).get_editor_property("name")
    if str(kept) != subject:
        raise DeitalkError(f"{paths[0]} keeps the subject {kept}; choose {subject} by hand")
    importer.say(f"{face.get_owner().get_actor_label()} shows the Live Link subject {subject}")


def live_link_take(path: str, sound: str = "", folder: str = importer.FOLDER) -> Any:
    """Import a Live Link Face CSV, put its sound on the take's frames, and choose its subject.

    The subject is chosen if one MetaHuman is selected, or the only one.

    Parameters
    ----------
    path : str
        The CSV; see `deitalk_unreal.live_link_csv`.
    sound : str
        Sound file; by default ``audio_48k.wav`` or ``audio.wav`` beside the CSV, if there is one.
    folder : str
        Of the assets.

    Returns
    -------
    unreal.LevelSequence
        Opened in Sequencer.
    """
    start = deitalk_clip.start_of_take(path)
    beside = os.path.dirname(os.path.abspath(path))
    found = [os.path.join(beside, name) for name in ("audio_48k.wav", "audio.wav")]
    sound = sound or next((name for name in found if os.path.isfile(name)), "")
    assets = [unreal.load_asset(name) for name in importer.live_link_csv(path, folder)]
    sequences = [asset for asset in assets if isinstance(asset, unreal.LevelSequence)]
    if not sequences:
        raise DeitalkError(f"Unreal made no Level Sequence of {path}")
    unreal.LevelSequenceEditorBlueprintLibrary.open_level_sequence(sequences[0])
    if sound:
        stem = importer.asset_name(path)
        wave = import_sound(sound, folder, name=f"{stem}_sound")
        place(None, wave, sequence=sequences[0], start_frame=frame_of(start, sequences[0]))
    if len(faces()) == 1:
        choose_subject(deitalk_clip.subject_of(path))
    importer.say(f"{path}: from {start:g} s, sound {sound or 'none'}")
    return sequences[0]


def open_sequence(name: str, rate: Any, folder: str = importer.FOLDER) -> Any:
    """Return the Level Sequence open in Sequencer, or a new one of a rate, opened."""
    library = unreal.LevelSequenceEditorBlueprintLibrary
    current = library.get_current_level_sequence()
    if current is not None:
        return current
    tools = unreal.AssetToolsHelpers.get_asset_tools()
    factory = unreal.LevelSequenceFactoryNew()
    name = free_name(f"LS_{name}", folder)
    sequence = tools.create_asset(name, folder, unreal.LevelSequence, factory)
    if sequence is None:
        raise DeitalkError(f"Unreal did not create {folder}/{name}; is the folder writable?")
    sequence.set_display_rate(rate)
    sequence.set_playback_start(0)
    sequence.set_playback_end(1)
    library.open_level_sequence(sequence)
    return sequence


def frame_of(seconds: float, sequence: Any) -> int:
    """Return the frame of a time of day in the display rate of a sequence."""
    display = sequence.get_display_rate()
    frames: float = float(seconds) * display.numerator / display.denominator
    return round(frames)


def free_name(name: str, folder: str) -> str:
    """Return a name that no asset of a folder has: ``speech``, then ``speech_2``."""
    number, free = 1, name
    while unreal.EditorAssetLibrary.does_asset_exist(f"{folder}/{free}"):
        number += 1
        free = f"{name}_{number}"
    return free


def place(
    animation: Any,
    sound: Any,
    face: Any = None,
    sequence: Any = None,
    start_frame: int | None = None,
    folder: str = importer.FOLDER,
) -> tuple[int, int]:
    """Put an AnimSequence on the Face track of a MetaHuman, and its sound beside it.

    Parameters
    ----------
    animation : unreal.AnimSequence or None
        None places the sound only.
    sound : unreal.SoundWave or None
        None places the animation only.
    face : unreal.SkeletalMeshComponent, optional
        By default that of the selected or the only MetaHuman.
    sequence : unreal.LevelSequence, optional
        By default the one open in Sequencer, or a new one.
    start_frame : int, optional
        In the display rate; by default the start of playback.
    folder : str
        Animations of this folder that lie where the new one goes are taken off the track.

    Returns
    -------
    (int, int)
        First frame, and the one after the last.

    Raises
    ------
    DeitalkError
        If another animation lies there: two on one track are blended, at half strength.
    """
    importer.need_unreal()
    sequence = sequence or open_sequence("deitalk", unreal.FrameRate(30, 1), folder)
    start = int(sequence.get_playback_start()) if start_frame is None else start_frame
    display = sequence.get_display_rate()
    seconds = animation.get_play_length() if animation is not None else _duration(sound)
    stop = start + max(1, round(seconds * display.numerator / display.denominator))
    with unreal.ScopedEditorTransaction("deitalk: animation and sound"):
        if animation is not None:
            _add_animation(sequence, face or find_face(), animation, (start, stop), folder)
        if sound is not None:
            _add_sound(sequence, sound, start)
        if sequence.get_playback_end() < stop:
            sequence.set_playback_end(stop)
    unreal.LevelSequenceEditorBlueprintLibrary.refresh_current_level_sequence()
    return start, stop


def _add_animation(
    sequence: Any, face: Any, animation: Any, span: tuple[int, int], folder: str
) -> None:
    binding = bind(sequence, face)
    tracks = binding.find_tracks_by_type(unreal.MovieSceneSkeletalAnimationTrack)
    track = tracks[0] if tracks else binding.add_track(unreal.MovieSceneSkeletalAnimationTrack)
    for section in track.get_sections():
        first, end = _span(section)
        if first >= span[1] or end <= span[0]:
            continue
        there = section.get_editor_property("params").get_editor_property("animation")
        path = str(there.get_path_name()) if there is not None else ""
        if not path.startswith(f"{folder}/"):
            raise DeitalkError(
                f"the Face track has {path or 'a section'} from frame {first:g} to {end:g}: "
                f"move it, or start elsewhere; the new animation is {animation.get_path_name()}"
            )
        track.remove_section(section)
    section = track.add_section()
    parameters = unreal.MovieSceneSkeletalAnimationParams()
    parameters.set_editor_property("animation", animation)
    section.set_editor_property("params", parameters)
    section.set_range(*span)


def _span(section: Any) -> tuple[float, float]:
    """Return first frame and the one after the last; a section without a bound has none."""
    first = section.get_start_frame() if section.has_start_frame() else -math.inf
    return first, section.get_end_frame() if section.has_end_frame() else math.inf


def bind(sequence: Any, face: Any) -> Any:
    """Return the binding of a face component in a sequence, made if it has none."""
    actor = face.get_owner()
    label = str(actor.get_actor_label())
    for binding in sequence.get_bindings():
        for child in binding.get_child_possessables():
            if str(child.get_display_name()) == FACE and _is_of(sequence, binding, actor, label):
                return child
    parents = [b for b in sequence.get_bindings() if _is_of(sequence, b, actor, label)]
    parent = parents[0] if parents else sequence.add_possessable(actor)
    child = sequence.add_possessable(face)
    child.set_parent(parent)
    return child


def _is_of(sequence: Any, binding: Any, actor: Any, label: str) -> bool:
    """Return whether a binding is that of an actor: by the bound objects, else by its name."""
    locate = getattr(sequence, "locate_bound_objects", None)
    world = actor.get_world()
    if locate is not None:
        return any(found == actor for found in locate(binding, world))
    return str(binding.get_display_name()) == label


def _add_sound(sequence: Any, sound: Any, start: int) -> None:
    """Add a sound to a track of its own, unless it is there from that frame already."""
    for track in sequence.find_tracks_by_type(unreal.MovieSceneAudioTrack):
        for section in track.get_sections():
            is_same = section.get_editor_property("sound") == sound
            if is_same and _span(section)[0] == start:
                return
    section = sequence.add_track(unreal.MovieSceneAudioTrack).add_section()
    section.set_sound(sound)
    display = sequence.get_display_rate()
    n_frames = round(_duration(sound) * display.numerator / display.denominator)
    section.set_range(start, start + max(1, n_frames))


def _duration(sound: Any) -> float:
    return float(sound.get_editor_property("duration"))
