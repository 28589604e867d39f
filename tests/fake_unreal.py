"""A substitute for Unreal's Python module with the checks of Unreal.

Signatures and types follow Unreal's generated API pages: AnimationDataController's bracket, frame
rate and number of frames; AnimationLibrary's curves; channels of a control rig's section;
ControlRigSequencerLibrary; AssetImportTask. It keeps the written values for tests. It shows that the
script calls the documented interfaces, not that the script runs in Unreal.

Rules of the editor that it keeps: a new AnimSequence has 30 fps, and a rate that is neither a
multiple nor a factor of the present one is logged and ignored; a bracket opened with a transaction
leaves it open unless it is closed with one; setters and getters of controls do nothing unless
Sequencer has the sequence open; an object of a channel is called as the channel with a number of its
own behind.
"""

import wave
from bisect import bisect_right
from fractions import Fraction
from types import ModuleType
from typing import ClassVar

from tests.unreal_live_link import import_csv


def check(value, kind, what):
    if type(value) is not kind:
        raise TypeError(f"{what}: {kind.__name__} expected, got {type(value).__name__}")


def check_list(values, kind, what):
    check(values, list, what)
    for value in values:
        check(value, kind, what)


class Accessors:
    """An object of Unreal's: ``get_x()`` gives its attribute x, a property has a type."""

    properties: ClassVar = {}
    """Types of what `set_editor_property` may set."""

    def __getattr__(self, name):
        attribute = name.removeprefix("get_")
        if attribute == name or attribute not in vars(self):
            raise AttributeError(f"{type(self).__name__} has no {name}")
        return lambda: vars(self)[attribute]

    def set_editor_property(self, name, value):
        check(value, self.properties[name], name)
        setattr(self, name, value)

    def get_editor_property(self, name):
        assert name in self.properties
        return getattr(self, name)


class FrameRate:
    def __init__(self, numerator, denominator):
        check(numerator, int, "numerator")
        check(denominator, int, "denominator")
        self.numerator, self.denominator = numerator, denominator


class FrameNumber:
    def __init__(self, value):
        check(value, int, "FrameNumber")
        self.value = value


class Vector2D:
    def __init__(self, x, y):
        check(x, float, "x")
        check(y, float, "y")
        self.x, self.y = x, y


class EulerTransform:
    """Kind of a control with a place and a rotation."""


class RawCurveTrackTypes:
    RCT_FLOAT = "RCT_FLOAT"


class RigElementType:
    CONTROL = "CONTROL"


class RigControlType:
    FLOAT, VECTOR2D, TRANSFORM = "FLOAT", "VECTOR2D", "TRANSFORM"


class RigControlSettings:
    def __init__(self, control_type):
        self.control_type = control_type


class RigElementKey:
    def __init__(self, type, name):
        self.type, self.name = type, name


class Controller(Accessors):
    def __init__(self):
        self.depth = self.n_brackets = self.n_transactions = 0
        self.frame_rate, self.n_frames = FrameRate(30, 1), 1
        self.errors, self.model_interface = [], self

    def open_bracket(self, title, should_transact=True):
        check(title, str, "title")
        self.depth += 1
        self.n_brackets += 1
        self.n_transactions += should_transact

    def close_bracket(self, should_transact=True):
        assert self.depth > 0
        self.depth -= 1
        self.n_transactions -= should_transact

    def set_frame_rate(self, frame_rate, should_transact=True):
        check(frame_rate, FrameRate, "frame_rate")
        assert max(frame_rate.numerator, frame_rate.denominator) < 2**31
        ratio = Fraction(frame_rate.numerator, frame_rate.denominator)
        ratio /= Fraction(self.frame_rate.numerator, self.frame_rate.denominator)
        if 1 in (ratio.numerator, ratio.denominator):
            self.frame_rate = frame_rate
        else:
            self.errors.append("Incompatible frame rate provided: not a multiple or factor")

    def set_number_of_frames(self, new_length_in_frames, should_transact=True):
        check(new_length_in_frames, FrameNumber, "new_length_in_frames")
        assert new_length_in_frames.value > 0, "has to be positive and non-zero"
        self.n_frames = new_length_in_frames.value


class AnimSequence(Accessors):
    def __init__(self, path_name=""):
        self.controller = Controller()
        self.curves, self.path_name = {}, path_name

    def get_play_length(self):
        rate = self.controller.frame_rate
        return self.controller.n_frames * rate.denominator / rate.numerator


class AnimationLibrary:
    @classmethod
    def add_curve(cls, sequence, curve_name, curve_type, meta_data_curve):
        check(sequence, AnimSequence, "sequence")
        check(curve_name, str, "curve_name")
        check(meta_data_curve, bool, "meta_data_curve")
        assert curve_type == RawCurveTrackTypes.RCT_FLOAT
        assert sequence.controller.depth == 1, "outside the bracket each curve takes seconds"
        sequence.curves[curve_name] = None

    @classmethod
    def add_float_curve_keys(cls, sequence, curve_name, times, values):
        check_list(times, float, "times")
        check_list(values, float, "values")
        assert len(times) == len(values) and curve_name in sequence.curves
        assert max(times) <= sequence.get_play_length() + 1e-6, "a key after the end"
        sequence.curves[curve_name] = (times, values)

    @classmethod
    def get_animation_curve_names(cls, animation_sequence_base, curve_type):
        check(animation_sequence_base, AnimSequence, "animation_sequence_base")
        assert curve_type == RawCurveTrackTypes.RCT_FLOAT
        return list(animation_sequence_base.curves)

    @classmethod
    def get_float_keys(cls, animation_sequence_base, curve_name):
        check(curve_name, str, "curve_name")
        return animation_sequence_base.curves[curve_name]

    @classmethod
    def get_sequence_length(cls, animation_sequence_base):
        return animation_sequence_base.get_play_length()


class AnimSequenceFactory:
    def __init__(self):
        self.properties = {}

    def set_editor_property(self, name, value):
        assert name in ("target_skeleton", "preview_skeletal_mesh")
        self.properties[name] = value


class LiveLinkFaceImporterFactory:
    pass


class AssetImportTask:
    def __init__(self):
        self.filename = self.destination_path = self.factory = None
        self.destination_name = ""
        self.automated = self.save = self.replace_existing = False
        self.imported_object_paths = []


class AssetTools:
    def __init__(self, module):
        self.module = module

    def create_asset(self, asset_name, package_path, asset_class, factory):
        assert package_path.startswith("/Game/")
        path = f"{package_path}/{asset_name}"
        assert path not in self.module.assets, "the editor asks whether to replace it"
        if issubclass(asset_class, LevelSequence):
            assert type(factory).__name__ == "LevelSequenceFactoryNew"
            asset = asset_class([], name=asset_name)
        else:
            assert asset_class is AnimSequence
            assert factory.properties["target_skeleton"] is not None
            asset = AnimSequence(f"{path}.{asset_name}")
        self.module.assets[path] = asset
        return asset

    def import_asset_tasks(self, import_tasks):
        for task in import_tasks:
            if task.factory is None and task.filename.endswith(".wav"):
                path = f"{task.destination_path}/{task.destination_name}"
                if path in self.module.assets and not task.replace_existing:
                    continue
                new = SoundWave(task.destination_name, task.filename)
                sound = self.module.assets.setdefault(path, new)  # a reimport keeps the object
                with wave.open(task.filename) as stream:
                    sound.duration = stream.getnframes() / stream.getframerate()
                continue
            assert type(task.factory) is LiveLinkFaceImporterFactory and task.automated
            try:
                imported = import_csv(task.filename)
            except AssertionError as error:
                self.module.messages.append(str(error))  # logged, and nothing is imported
                continue
            self.module.imported.append(imported)
            path = f"{task.destination_path}/imported"
            kind = getattr(self.module, "LevelSequence", LevelSequence)
            first, last = (round(imported.times[i] * imported.rate) for i in (0, -1))
            rate = (imported.rate, 1)
            self.module.assets[path] = kind([], rate, name="imported", playback=(first, last))
            task.imported_object_paths = [path]


class Hierarchy:
    def __init__(self, controls):
        self.controls = controls

    def contains(self, key):
        check(key, RigElementKey, "key")
        return key.name in self.controls

    def get_all_keys(self, traverse):
        check(traverse, bool, "traverse")
        return [
            RigElementKey("BONE", "head"),
            *(RigElementKey("CONTROL", n) for n in self.controls),
        ]

    def get_control_settings(self, key):
        assert key.type == RigElementType.CONTROL and key.name in self.controls
        kinds = {float: RigControlType.FLOAT, Vector2D: RigControlType.VECTOR2D}
        return RigControlSettings(kinds.get(self.controls[key.name], RigControlType.TRANSFORM))


class FrameTime:
    def __init__(self, frame):
        self.frame_number = FrameNumber(frame)


class MovieSceneKeyInterpolation:
    LINEAR, BREAK = "LINEAR", "BREAK"


class RichCurveInterpMode:
    RCIM_CUBIC = "cubic"


class RichCurveTangentMode:
    RCTM_BREAK = "break"


class RichCurveTangentWeightMode:
    RCTWM_WEIGHTED_NONE = "none"


class Key(Accessors):
    """Slopes are per tick of the sequence's resolution, as its channels evaluate them."""

    def __init__(self, frame, value):
        self.frame, self.value = frame, value
        self.arrive = self.leave = None

    def set_interpolation_mode(self, mode):
        assert mode == RichCurveInterpMode.RCIM_CUBIC

    def set_tangent_mode(self, mode):
        assert mode == RichCurveTangentMode.RCTM_BREAK

    def set_tangent_weight_mode(self, mode):
        assert mode == RichCurveTangentWeightMode.RCTWM_WEIGHTED_NONE

    def set_arrive_tangent(self, slope):
        check(slope, float, "slope")
        self.arrive = slope

    def set_leave_tangent(self, slope):
        check(slope, float, "slope")
        self.leave = slope

    def get_time(self, time_unit):
        assert time_unit.endswith(".DISPLAY_RATE")
        return FrameTime(self.frame)


class Channel(Accessors):
    def __init__(self, name):
        self.name, self.keys, self.n_calls = name, [], 0

    def get_keys(self):
        return list(self.keys)

    def remove_key(self, key):
        self.keys.remove(key)

    def add_key(self, time, new_value, sub_frame, time_unit, interpolation):
        check(time, FrameNumber, "time")
        check(new_value, float, "new_value")
        check(sub_frame, float, "sub_frame")
        assert time_unit.endswith(".DISPLAY_RATE")
        assert interpolation in ("LINEAR", "BREAK")
        assert all(key.frame != time.value for key in self.keys), "two keys on one frame"
        self.n_calls += 1
        key = Key(time.value, new_value)
        self.keys.append(key)
        self.keys.sort(key=lambda key: key.frame)
        return key

    def at(self, frame):
        frames = [key.frame for key in self.keys]
        after = bisect_right(frames, frame)
        if not frames or after in (0, len(frames)):
            return self.keys[0 if after == 0 else -1].value if frames else 0.0
        low, high = self.keys[after - 1], self.keys[after]
        return low.value + (high.value - low.value) * (frame - low.frame) / (high.frame - low.frame)


class ControlRigSection:
    """Channels of the float, Vector2D and transform controls, as objects with a number behind their name."""

    def __init__(self, controls):
        names = []
        for name, kind in controls.items():
            parts = [f"{name}.{part}.{axis}" for part in ("Location", "Rotation") for axis in "XYZ"]
            kinds = {float: [name], Vector2D: [f"{name}.X", f"{name}.Y"], EulerTransform: parts}
            names += kinds.get(kind, [])
        self.channels = {name: Channel(f"{name}_{i}") for i, name in enumerate(names)}

    def get_all_channels(self):
        return list(self.channels.values())


class ControlRigTrack:
    def __init__(self, rig):
        self.rig = rig

    def get_sections(self):
        return [self.rig.section]

    def add_section(self):
        raise AssertionError("the track has a section")


class ControlRig(Accessors):
    def __init__(self, name, controls):
        self.name, self.controls, self.hierarchy = name, controls, Hierarchy(controls)
        self.section = ControlRigSection(controls)

    def keys(self, channel):
        """Keys of a channel for tests, as (frames, values)."""
        keys = self.section.channels[channel].keys
        return [key.frame for key in keys], [key.value for key in keys]


class Proxy:
    def __init__(self, rig):
        self.control_rig, self.track = rig, ControlRigTrack(rig)


class AssetImportData(Accessors):
    def __init__(self, first_filename):
        self.first_filename = first_filename


class SoundWave(Accessors):
    properties: ClassVar = {"duration": float, "asset_import_data": AssetImportData}

    def __init__(self, name, path=None, duration=1.0):
        self.name, self.path, self.duration = name, path, duration
        self.asset_import_data = None if path is None else AssetImportData(path)


class Section(Accessors):
    """A section with a range in frames of the display rate, its end exclusive."""

    start = stop = None

    def set_range(self, start_frame, end_frame):
        check(start_frame, int, "start_frame")
        check(end_frame, int, "end_frame")
        assert start_frame < end_frame
        self.start, self.stop = start_frame, end_frame

    def has_start_frame(self):
        return self.start is not None

    def has_end_frame(self):
        return self.stop is not None

    def get_start_frame(self):
        assert self.start is not None, "the section has no lower bound"
        return self.start

    def get_end_frame(self):
        assert self.stop is not None, "the section has no upper bound"
        return self.stop


class MovieSceneAudioSection(Section):
    properties: ClassVar = {"sound": SoundWave}

    def __init__(self, sound=None, start=None):
        self.sound, self.start = sound, start

    def set_sound(self, sound):
        check(sound, SoundWave, "sound")
        self.sound = sound


class Track:
    kind = Section

    def __init__(self, sections=()):
        self.sections = list(sections)

    def get_sections(self):
        return list(self.sections)

    def add_section(self):
        self.sections.append(self.kind())
        return self.sections[-1]

    def remove_section(self, section):
        self.sections.remove(section)


class MovieSceneAudioTrack(Track):
    kind = MovieSceneAudioSection


class LevelSequence(Accessors):
    def __init__(self, rigs, rate=(30, 1), *, name="LS_take", audio=(), playback=(0, 0)):
        self.rigs, self.display_rate, self.name = rigs, FrameRate(*rate), name
        self.audio, self.bindings, self.tick_resolution = list(audio), [], FrameRate(24000, 1)
        self.playback_start, self.playback_end = playback

    def add_track(self, track_type):
        assert track_type is MovieSceneAudioTrack
        self.audio.append(MovieSceneAudioTrack())
        return self.audio[-1]

    def set_display_rate(self, display_rate):
        check(display_rate, FrameRate, "display_rate")
        self.display_rate = display_rate

    def set_playback_start(self, start_frame):
        check(start_frame, int, "start_frame")
        self.playback_start = start_frame

    def set_playback_end(self, end_frame):
        check(end_frame, int, "end_frame")
        self.playback_end = end_frame

    def find_tracks_by_type(self, track_type):
        assert track_type is MovieSceneAudioTrack
        return self.audio


class ScopedSlowTask:
    def __init__(self, work, text):
        check(text, str, "text")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return False

    def make_dialog(self, can_cancel):
        check(can_cancel, bool, "can_cancel")

    def should_cancel(self):
        return False

    def enter_progress_frame(self, work, text):
        check(text, str, "text")


class ScopedEditorTransaction:
    n_open = 0

    def __init__(self, desc):
        check(desc, str, "desc")

    def __enter__(self):
        ScopedEditorTransaction.n_open += 1
        return self

    def __exit__(self, *_):
        ScopedEditorTransaction.n_open -= 1
        return False


class AssetListing:
    assets = ()

    @classmethod
    def list_assets(cls, directory_path, recursive=True, include_folder=False):
        check(directory_path, str, "directory_path")
        return [path for path in cls.assets if path.startswith(directory_path)]


class ControlRigReading:
    display_rate = opened = None

    @classmethod
    def _get(cls, kind, sequence, rig, name, frames, time_unit):
        check(sequence, LevelSequence, "level_sequence")
        check(rig, ControlRig, "control_rig")
        check(name, str, "control_name")
        check_list(frames, FrameNumber, "frames")
        assert time_unit == cls.display_rate and rig.controls[name] is kind
        if cls.opened() is not sequence:
            return []
        channels = rig.section.channels
        if kind is float:
            return [channels[name].at(f.value) for f in frames]
        pair = channels[f"{name}.X"], channels[f"{name}.Y"]
        return [Vector2D(*(channel.at(f.value) for channel in pair)) for f in frames]

    @classmethod
    def get_local_control_rig_floats(
        cls, level_sequence, control_rig, control_name, frames, time_unit
    ):
        return cls._get(float, level_sequence, control_rig, control_name, frames, time_unit)

    @classmethod
    def get_local_control_rig_vector2_ds(
        cls, level_sequence, control_rig, control_name, frames, time_unit
    ):
        return cls._get(Vector2D, level_sequence, control_rig, control_name, frames, time_unit)


def make_unreal(*, level_sequence=None, skeletons=(), time_unit="MovieSceneTimeUnit"):
    """Return a module with one open level sequence and some assets."""
    module = ModuleType("unreal")
    unit = type(time_unit, (), {"DISPLAY_RATE": f"{time_unit}.DISPLAY_RATE"})
    module.assets = {path: object() for path in skeletons}
    module.saved, module.messages, module.opened = [], [], level_sequence
    module.imported = []
    tools = AssetTools(module)

    class ControlRigSequencerLibrary(ControlRigReading):
        display_rate = unit.DISPLAY_RATE

        @staticmethod
        def opened():
            return module.opened

        @classmethod
        def get_control_rigs(cls, level_sequence):
            assert isinstance(level_sequence, LevelSequence)
            return [Proxy(rig) for rig in level_sequence.rigs]

    class EditorAssetLibrary(AssetListing):
        assets = module.assets

        @classmethod
        def does_asset_exist(cls, asset_path):
            return asset_path in module.assets

        @classmethod
        def delete_asset(cls, asset_path_to_delete):
            return module.assets.pop(asset_path_to_delete, None) is not None

        @classmethod
        def save_loaded_asset(cls, asset_to_save, only_if_is_dirty=True):
            controller = asset_to_save.controller
            assert controller.depth == 0, "saved inside a bracket"
            assert controller.n_transactions == 0, "an undo transaction stays open"
            module.saved.append(asset_to_save)
            return True

    class LevelSequenceEditorBlueprintLibrary:
        @classmethod
        def get_current_level_sequence(cls):
            return module.opened

        @classmethod
        def open_level_sequence(cls, level_sequence):
            assert isinstance(level_sequence, LevelSequence)
            module.opened = level_sequence
            return True

        @classmethod
        def refresh_current_level_sequence(cls):
            pass

    helpers = type("AssetToolsHelpers", (), {"get_asset_tools": staticmethod(lambda: tools)})
    module.__dict__.update(
        {
            time_unit: unit,
            "AssetToolsHelpers": helpers,
            "ControlRigSequencerLibrary": ControlRigSequencerLibrary,
            "EditorAssetLibrary": EditorAssetLibrary,
            "LevelSequenceEditorBlueprintLibrary": LevelSequenceEditorBlueprintLibrary,
            "load_asset": module.assets.get,
            "log": module.messages.append,
            "log_warning": module.messages.append,
            "log_error": module.messages.append,
        }
    )
    for kind in (
        AnimSequence,
        AnimSequenceFactory,
        AnimationLibrary,
        AssetImportTask,
        FrameNumber,
        FrameRate,
        LevelSequence,
        LiveLinkFaceImporterFactory,
        MovieSceneAudioTrack,
        MovieSceneKeyInterpolation,
        RichCurveInterpMode,
        RichCurveTangentMode,
        RichCurveTangentWeightMode,
        SoundWave,
        RawCurveTrackTypes,
        RigControlType,
        RigElementKey,
        RigElementType,
        ScopedEditorTransaction,
        ScopedSlowTask,
        Vector2D,
    ):
        setattr(module, kind.__name__, kind)
    return module
