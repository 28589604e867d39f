"""A substitute for Unreal's Python module with the checks of Unreal.

Signatures and types follow Unreal's generated API pages: AnimationDataController's bracket, frame
rate and number of frames; AnimationLibrary's curves; ControlRigSequencerLibrary's plural setters;
AssetImportTask. It keeps the written values for tests. It shows that the script calls the documented
interfaces, not that the script runs in Unreal.
"""

from types import ModuleType


def check(value, kind, what):
    if type(value) is not kind:
        raise TypeError(f"{what}: {kind.__name__} expected, got {type(value).__name__}")


def check_list(values, kind, what):
    check(values, list, what)
    for value in values:
        check(value, kind, what)


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


class Controller:
    def __init__(self):
        self.depth = self.n_brackets = 0
        self.rate = self.n_frames = None

    def open_bracket(self, title, should_transact=True):
        check(title, str, "title")
        self.depth += 1
        self.n_brackets += 1

    def close_bracket(self, should_transact=True):
        assert self.depth > 0
        self.depth -= 1

    def set_frame_rate(self, frame_rate, should_transact=True):
        check(frame_rate, FrameRate, "frame_rate")
        self.rate = frame_rate

    def set_number_of_frames(self, new_length_in_frames, should_transact=True):
        check(new_length_in_frames, FrameNumber, "new_length_in_frames")
        assert new_length_in_frames.value > 0, "has to be positive and non-zero"
        assert self.rate is not None, "the frame rate comes first"
        self.n_frames = new_length_in_frames.value


class AnimSequence:
    def __init__(self):
        self.controller = Controller()
        self.curves = {}


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
        end = sequence.controller.n_frames * (
            sequence.controller.rate.denominator / sequence.controller.rate.numerator
        )
        assert max(times) <= end + 1e-6, "a key after the end"
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
        rate = animation_sequence_base.controller.rate
        return animation_sequence_base.controller.n_frames * rate.denominator / rate.numerator


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
        self.automated = self.save = False
        self.imported_object_paths = []


class AssetTools:
    def __init__(self, module):
        self.module = module

    def create_asset(self, asset_name, package_path, asset_class, factory):
        assert asset_class is AnimSequence and factory.properties["target_skeleton"] is not None
        assert package_path.startswith("/Game/")
        self.module.assets[f"{package_path}/{asset_name}"] = asset = AnimSequence()
        return asset

    def import_asset_tasks(self, import_tasks):
        for task in import_tasks:
            assert type(task.factory) is LiveLinkFaceImporterFactory and task.automated
            task.imported_object_paths = [f"{task.destination_path}/imported"]


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


class ControlRig:
    def __init__(self, name, controls):
        self.name, self.controls, self.keys = name, controls, {}

    def get_name(self):
        return self.name

    def get_hierarchy(self):
        return Hierarchy(self.controls)


class Proxy:
    def __init__(self, rig):
        self.control_rig = rig


class AssetImportData:
    def __init__(self, path):
        self.path = path

    def get_first_filename(self):
        return self.path


class SoundWave:
    def __init__(self, name, path=None):
        self.name, self.path = name, path

    def get_name(self):
        return self.name

    def get_editor_property(self, name):
        assert name == "asset_import_data"
        return None if self.path is None else AssetImportData(self.path)


class MovieSceneAudioSection:
    def __init__(self, sound, start):
        self.sound, self.start = sound, start

    def get_editor_property(self, name):
        assert name == "sound"
        return self.sound

    def get_start_frame(self):
        return self.start


class MovieSceneAudioTrack:
    def __init__(self, sections):
        self.sections = sections

    def get_sections(self):
        return self.sections


class LevelSequence:
    def __init__(self, rigs, rate=(30, 1), *, name="LS_take", audio=(), playback=(0, 0)):
        self.rigs, self.rate, self.name = rigs, FrameRate(*rate), name
        self.audio, self.playback = list(audio), playback

    def get_display_rate(self):
        return self.rate

    def get_name(self):
        return self.name

    def get_playback_start(self):
        return self.playback[0]

    def get_playback_end(self):
        return self.playback[1]

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


class AssetListing:
    assets = ()

    @classmethod
    def list_assets(cls, directory_path, recursive=True, include_folder=False):
        check(directory_path, str, "directory_path")
        return [path for path in cls.assets if path.startswith(directory_path)]


class ControlRigReading:
    display_rate = None

    @classmethod
    def _get(cls, kind, sequence, rig, name, frames, time_unit):
        check(sequence, LevelSequence, "level_sequence")
        check(rig, ControlRig, "control_rig")
        check(name, str, "control_name")
        check_list(frames, FrameNumber, "frames")
        assert time_unit == cls.display_rate and rig.controls[name] is kind
        keyed, values = rig.keys.get(name, ([], []))
        rest = 0.0 if kind is float else Vector2D(0.0, 0.0)
        by_frame = dict(zip(keyed, values, strict=True))
        return [by_frame.get(f.value, values[-1] if values else rest) for f in frames]

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
    module.saved, module.messages = [], []
    tools = AssetTools(module)

    class ControlRigSequencerLibrary(ControlRigReading):
        display_rate = unit.DISPLAY_RATE

        @classmethod
        def get_control_rigs(cls, level_sequence):
            check(level_sequence, LevelSequence, "level_sequence")
            return [Proxy(rig) for rig in level_sequence.rigs]

        @classmethod
        def _set(cls, kind, sequence, rig, name, frames, values, time_unit):
            check(sequence, LevelSequence, "level_sequence")
            check(rig, ControlRig, "control_rig")
            check(name, str, "control_name")
            check_list(frames, FrameNumber, "frames")
            check_list(values, kind, "values")
            assert time_unit == unit.DISPLAY_RATE
            assert len(frames) == len(values), "Unreal logs an error and sets nothing"
            assert rig.controls[name] is kind, f"{name} is no {kind.__name__} control"
            rig.keys[name] = ([f.value for f in frames], values)

        @classmethod
        def set_local_control_rig_floats(
            cls, level_sequence, control_rig, control_name, frames, values, time_unit
        ):
            cls._set(float, level_sequence, control_rig, control_name, frames, values, time_unit)

        @classmethod
        def set_local_control_rig_vector2_ds(
            cls, level_sequence, control_rig, control_name, frames, values, time_unit
        ):
            cls._set(Vector2D, level_sequence, control_rig, control_name, frames, values, time_unit)

    class EditorAssetLibrary(AssetListing):
        assets = module.assets

        @classmethod
        def does_asset_exist(cls, asset_path):
            return asset_path in module.assets

        @classmethod
        def save_loaded_asset(cls, asset_to_save, only_if_is_dirty=True):
            assert asset_to_save.controller.depth == 0, "saved inside a bracket"
            module.saved.append(asset_to_save)
            return True

    class LevelSequenceEditorBlueprintLibrary:
        @classmethod
        def get_current_level_sequence(cls):
            return level_sequence

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
        }
    )
    for kind in (
        AnimSequence,
        AnimSequenceFactory,
        AnimationLibrary,
        AssetImportTask,
        FrameNumber,
        FrameRate,
        LiveLinkFaceImporterFactory,
        MovieSceneAudioTrack,
        RawCurveTrackTypes,
        RigControlType,
        RigElementKey,
        RigElementType,
        ScopedSlowTask,
        Vector2D,
    ):
        setattr(module, kind.__name__, kind)
    return module
