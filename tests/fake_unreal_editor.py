"""The part of the substitute for Unreal that the menu needs: level, Sequencer, menus, windows.

Signatures and types follow Unreal's generated API pages (docs/unreal-menu.md lists them). Rules of
the editor that it keeps: there is no main menu while start scripts run, and menus of the Content
Browser exist when they are first opened or extended; a class that a window shows
derives from Object and has properties of Unreal's types; a binding of a component has a parent, and
its objects are found in the context of the parent's actor.
"""

from typing import ClassVar

from tests import fake_unreal
from tests.fake_unreal import Accessors, LevelSequence, Section, Track, check


class Object:
    def get_editor_property(self, name):
        return self.values[name]

    def set_editor_property(self, name, value):
        kind = self.types[name]
        if value is not None:
            check(value, kind, name)
        self.values[name] = value


class EnumBase:
    pass


class EnumValue:
    def __init__(self, name=""):
        self.name = name


class FilePath(Accessors):
    properties: ClassVar = {"file_path": str}
    file_path = ""


class Property:
    def __init__(self, kind):
        self.kind = kind


def uproperty(type, meta=None):
    assert meta is None or all(isinstance(v, str) for v in meta.values())
    return Property(type)


def uvalue(val, meta=None):
    check(val, int, "val")
    return EnumValue()


def uenum():
    def made(kind):
        assert issubclass(kind, EnumBase)
        for name, value in vars(kind).items():
            if isinstance(value, EnumValue):
                value.name = name
        return kind

    return made


def uclass():
    def made(kind):
        assert issubclass(kind, Object)
        kind.types = {n: p.kind for n, p in vars(kind).items() if isinstance(p, Property)}
        assert len(kind.types) > 0
        return kind

    return made


def new_object(type, outer=None, name="None"):
    made = type()
    zero = {float: 0.0, bool: False, FilePath: FilePath()}
    made.values = {}
    for key, kind in type.types.items():
        first = [v for v in vars(kind).values() if isinstance(v, EnumValue)]
        made.values[key] = first[0] if first else zero.get(kind)
    return made


class Asset(Accessors):
    properties: ClassVar = {"skeleton": object}

    def __init__(self, path, skeleton=None):
        self.path_name, self.skeleton = f"{path}.{path.rsplit('/', 1)[-1]}", skeleton


class SkeletalMeshComponent(Accessors):
    def __init__(self, name, skeleton="/Game/MetaHumans/Common/Face/Face_Archetype_Skeleton"):
        self.name, self.owner = name, None
        self.skeletal_mesh_asset = Asset("/Game/Face", Asset(skeleton))

    def set_anim_instance_class(self, new_class):
        self.anim_instance = new_class()

    def set_update_animation_in_editor(self, new_update_state):
        self.updates = new_update_state


class LiveLinkSubjectName(Accessors):
    properties: ClassVar = {"name": str}

    def __init__(self, name="None"):
        check(name, str, "name")
        self.name = name


class LiveLinkBlueprint(Accessors):
    """An instance of ABP_MH_LiveLink, with the one variable that its users set."""

    properties: ClassVar = {"LLink_Face_Subj": LiveLinkSubjectName}
    LLink_Face_Subj = LiveLinkSubjectName()


WORLD = object()


class Actor(Accessors):
    def __init__(self, label, *components):
        self.actor_label, self.components, self.world = label, components, WORLD
        for component in components:
            component.owner = self

    def get_components_by_class(self, component_class):
        return [c for c in self.components if isinstance(c, component_class)]


def metahuman(label, skeleton="/Game/MetaHumans/Common/Face/Face_Archetype_Skeleton"):
    body = SkeletalMeshComponent("Body")
    return Actor(label, body, SkeletalMeshComponent("Face", skeleton))


class MovieSceneSkeletalAnimationParams(Accessors):
    properties: ClassVar = {"animation": fake_unreal.AnimSequence}
    animation = None


class AnimationSection(Section):
    properties: ClassVar = {"params": MovieSceneSkeletalAnimationParams}

    def __init__(self):
        self.params = MovieSceneSkeletalAnimationParams()


class MovieSceneSkeletalAnimationTrack(Track):
    kind = AnimationSection


class Binding(Accessors):
    def __init__(self, target):
        self.target, self.parent, self.tracks, self.child_possessables = target, None, [], []

    def get_display_name(self):
        is_actor = isinstance(self.target, Actor)
        return self.target.actor_label if is_actor else self.target.name

    def set_parent(self, parent_binding):
        check(parent_binding, Binding, "parent_binding")
        self.parent = parent_binding
        parent_binding.child_possessables.append(self)

    def find_tracks_by_type(self, track_type):
        return [track for track in self.tracks if isinstance(track, track_type)]

    def add_track(self, track_type):
        assert track_type is MovieSceneSkeletalAnimationTrack
        assert isinstance(self.target, SkeletalMeshComponent)
        self.tracks.append(track_type())
        return self.tracks[-1]


class SceneSequence(LevelSequence):
    """A Level Sequence with bindings."""

    def add_possessable(self, object_to_possess):
        self.bindings.append(Binding(object_to_possess))
        return self.bindings[-1]

    def locate_bound_objects(self, binding, context):
        check(binding, Binding, "binding")
        expected = WORLD if binding.parent is None else binding.parent.target
        return [binding.target] if context is expected else []


class ToolMenuEntry:
    def __init__(self, name, type):
        check(name, str, "name")
        assert type == "MENU_ENTRY"
        self.name = name

    def set_label(self, label):
        self.label = label

    def set_tool_tip(self, tool_tip):
        self.tool_tip = tool_tip

    def set_string_command(self, type, custom_type, string):
        assert type == "PYTHON" and custom_type == ""
        self.command = string


class Menu:
    def __init__(self):
        self.entries, self.menus = {}, {}

    def add_sub_menu(self, owner, section_name, name, label, tool_tip=""):
        for text in (owner, section_name, name, label, tool_tip):
            check(text, str, "text")
        assert name not in self.menus, "registered twice"
        self.menus[name] = Menu()
        return self.menus[name]

    def add_menu_entry(self, section_name, args):
        check(args, ToolMenuEntry, "args")
        assert args.name not in self.entries, "registered twice"
        self.entries[args.name] = args


class Exporter:
    @classmethod
    def run_asset_export_task(cls, task):
        check(task.object, fake_unreal.SoundWave, "object")
        assert type(task.exporter).__name__ == "SoundExporterWAV"
        assert task.automated and not task.prompt and task.replace_identical
        with open(task.filename, "wb") as stream:
            stream.write(task.object.content)
        return True


def tool_menus(module):
    class ToolMenus:
        @classmethod
        def get(cls):
            return cls()

        def find_menu(self, name):
            return module.menus.get(name)

        def extend_menu(self, name):
            return module.menus.setdefault(name, Menu())

        def refresh_all_widgets(self):
            pass

    return ToolMenus


def editor_dialog(module):
    class EditorDialog:
        @classmethod
        def show_object_details_view(cls, title, out_object, options=None):
            check(title, str, "title")
            assert isinstance(out_object, Object)
            answer = module.answers.pop(0)
            if answer is not None:
                answer(out_object)
            return answer is not None

        @classmethod
        def show_message(cls, title, message, message_type):
            check(message, str, "message")
            assert message_type == "OK"
            module.shown.append(message)

    return EditorDialog


def make_editor(*, actors=(), selected=(), assets=(), saved, **options):
    """Return the module of `make_unreal` with a level, menus and windows.

    `saved` is the folder of the project's ``Saved``. ``module.start()`` builds the main menu and
    ticks once; ``module.answers`` are functions that fill in the windows in turn, None cancels.
    """
    module = fake_unreal.make_unreal(**options)
    module.menus, module.ticks, module.answers, module.shown = {}, {}, [], []
    level = type("Level", (), {})()
    level.get_selected_level_actors = lambda: list(selected)
    level.get_all_level_actors = lambda: list(actors)

    class LevelSequenceFactoryNew:
        pass

    def start():
        module.menus["LevelEditor.MainMenu"] = Menu()
        for tick in list(module.ticks.values()):
            tick(0.01)

    def register_tick(callable):
        module.ticks[len(module.ticks)] = callable
        return len(module.ticks) - 1

    fake_path = {
        "project_saved_dir": staticmethod(lambda: "../../Saved/"),
        "convert_relative_path_to_full": staticmethod(lambda path: str(saved)),
    }
    library = {"get_selected_assets": staticmethod(lambda: list(assets))}
    module.start = start
    module.__dict__.update(
        ToolMenus=tool_menus(module),
        EditorDialog=editor_dialog(module),
        LevelSequence=SceneSequence,
        LevelSequenceFactoryNew=LevelSequenceFactoryNew,
        EditorActorSubsystem=type(level),
        get_editor_subsystem=lambda kind: level,
        register_slate_post_tick_callback=register_tick,
        unregister_slate_post_tick_callback=module.ticks.pop,
        Paths=type("Paths", (), fake_path),
        EditorUtilityLibrary=type("EditorUtilityLibrary", (), library),
        AppMsgType=type("AppMsgType", (), {"OK": "OK"}),
        MultiBlockType=type("MultiBlockType", (), {"MENU_ENTRY": "MENU_ENTRY"}),
        ToolMenuStringCommandType=type("T", (), {"PYTHON": "PYTHON"}),
        AssetExportTask=type("AssetExportTask", (), {}),
        SoundExporterWAV=type("SoundExporterWAV", (), {}),
        Object=Object,
        EnumBase=EnumBase,
        FilePath=FilePath,
        uproperty=uproperty,
        uvalue=uvalue,
        uenum=uenum,
        uclass=uclass,
        new_object=new_object,
        ToolMenuEntry=ToolMenuEntry,
        Exporter=Exporter,
        LiveLinkSubjectName=LiveLinkSubjectName,
        load_class=lambda outer, name: module.assets[name.rpartition(".")[0]],
        SkeletalMeshComponent=SkeletalMeshComponent,
        MovieSceneSkeletalAnimationTrack=MovieSceneSkeletalAnimationTrack,
        MovieSceneSkeletalAnimationParams=MovieSceneSkeletalAnimationParams,
    )
    return module
