"""The menu against the strict imitation of the editor: one call from a sound to Sequencer."""

import ast
import http.server
import importlib
import json
import os
import re
import sys
import threading
import wave
from pathlib import Path

import numpy as np
import pytest

from rig import read_curves, write_curves
from tests import fake_unreal, fake_unreal_editor
from tests.fake_unreal_editor import make_editor, metahuman
from tests.rig.unreal.test_unreal import SCRIPT, SKELETON, controls_of_the_board, run_inside, speech

MODULES = ("deitalk_call", "deitalk_place", "deitalk_menu", "init_unreal")
NEW_SKELETON = "/MetaHumanCharacter/Face/Face_Archetype_Skeleton"
STAND_IN = """
import json, pathlib, sys
words = sys.argv[1:]
folder = pathlib.Path(words[words.index("-o") + 1])
if "angry" in words:
    sys.exit("reading\\nerror: speech.wav is silent; record again")
folder.mkdir(parents=True, exist_ok=True)
(folder / "words.json").write_text(json.dumps(words))
(folder / "line.unreal.json").write_bytes(pathlib.Path(sys.argv[0]).with_name("ready").read_bytes())
"""
"""A program that is called as deitalk and writes what it was called with."""


@pytest.fixture
def sound(tmp_path):
    with wave.open(str(tmp_path / "line.wav"), "wb") as stream:
        stream.setparams((1, 2, 16000, 0, "NONE", ""))
        stream.writeframes(np.zeros(16000 * 2, np.int16).tobytes())
    return str(tmp_path / "line.wav")


@pytest.fixture
def stand_in(tmp_path):
    """Settings that call the stand-in, whose clip has 61 frames."""
    write_curves(tmp_path / "c.unreal.json", speech(61))
    (tmp_path / "c.unreal.json").rename(tmp_path / "ready")
    (tmp_path / "program.py").write_text(STAND_IN)
    command = [sys.executable, str(tmp_path / "program.py")]
    return {"command": command, "service": "", "key": ""}


def menu_inside(module, monkeypatch, settings):
    """The scripts as inside Unreal, with settings."""
    run_inside(module, monkeypatch)
    for name in MODULES:
        monkeypatch.delitem(sys.modules, name, raising=False)
    menu = importlib.import_module("deitalk_menu")
    monkeypatch.setattr(menu.deitalk_call, "read_settings", lambda: settings)
    return menu


def editor(tmp_path, *actors, **options):
    return make_editor(actors=actors, saved=tmp_path / "Saved", skeletons=[SKELETON], **options)


def words_of(tmp_path):
    return json.loads(next((tmp_path / "Saved/deitalk").glob("*/words.json")).read_text())


def test_recording_is_animated_imported_and_placed(tmp_path, monkeypatch, sound, stand_in):
    anna = metahuman("BP_Anna")
    module = editor(tmp_path, fake_unreal_editor.Actor("Lamp"), anna)
    menu = menu_inside(module, monkeypatch, stand_in)
    animation = menu.animate_audio(sound, "happy", 1.5)
    words = words_of(tmp_path)
    assert words[:2] == ["animate", sound] and words[words.index("-e") + 1] == "happy"
    assert float(words[words.index("--intensity") + 1]) == 1.5
    assert module.assets["/Game/deitalk/line_happy"] is animation
    assert sum(name.startswith("CTRL_") for name in animation.curves) == 251
    sequence = module.opened
    assert sequence is module.assets["/Game/deitalk/LS_line"]
    assert (sequence.playback_start, sequence.playback_end) == (0, 60)
    parent, face = sequence.bindings
    assert (parent.target, face.target, face.parent) == (anna, anna.components[1], parent)
    (section,) = face.tracks[0].sections
    assert section.params.animation is animation and (section.start, section.stop) == (0, 60)
    (there,) = [s for track in sequence.audio for s in track.sections]
    assert (there.sound.path, there.start, there.stop) == (sound, 0, 60)
    assert not fake_unreal.ScopedEditorTransaction.n_open


def test_recording_is_placed_at_its_time_code(tmp_path, monkeypatch, sound, stand_in):
    write_curves(tmp_path / "c.unreal.json", speech(61), start=3723.5)  # 01:02:03.5
    (tmp_path / "c.unreal.json").replace(tmp_path / "ready")
    sequence = fake_unreal_editor.SceneSequence([], rate=(24, 1))
    module = editor(tmp_path, metahuman("A"), level_sequence=sequence)
    menu = menu_inside(module, monkeypatch, stand_in)
    menu.animate_audio(sound, at_timecode=True)
    words = words_of(tmp_path)
    assert words[words.index("--timecode") + 1] == "recording"
    first = round(3723.5 * 24)
    (section,) = sequence.bindings[1].tracks[0].sections
    assert section.start == first and sequence.audio[0].sections[0].start == first


def test_second_emotion_replaces_the_first_at_the_same_place(
    tmp_path, monkeypatch, sound, stand_in
):
    module = editor(tmp_path, metahuman("BP_Anna"))
    menu = menu_inside(module, monkeypatch, stand_in)
    menu.animate_audio(sound, "happy")
    second = menu.animate_audio(sound, "sad")
    again = menu.animate_audio(sound, "sad", start_frame=100)
    face = module.opened.bindings[1]
    placed = [(s.start, s.params.animation) for s in face.tracks[0].sections]
    assert placed == [(0, second), (100, again)] and len(module.opened.bindings) == 2
    assert (module.opened.playback_start, module.opened.playback_end) == (0, 160)
    starts = [s.start for track in module.opened.audio for s in track.sections]
    assert starts == [0, 100]  # one sound at each place
    assert {"/Game/deitalk/line_sad", "/Game/deitalk/line_sad_2"} <= set(module.assets)


def test_animation_of_others_is_never_blended_or_removed(tmp_path, monkeypatch, sound, stand_in):
    anna = metahuman("BP_Anna")
    sequence = fake_unreal_editor.SceneSequence([], rate=(24, 1), playback=(10, 20))
    module = editor(tmp_path, anna, level_sequence=sequence)
    menu = menu_inside(module, monkeypatch, stand_in)
    theirs = fake_unreal.AnimSequence()
    theirs.path_name, theirs.controller.n_frames = "/Game/Mocap/AS_1.AS_1", 30
    menu.placing.place(theirs, None, anna.components[1], sequence, 30)
    with pytest.raises(menu.DeitalkError, match=r"has /Game/Mocap/AS_1\.AS_1 from frame 30 to 54"):
        menu.animate_audio(sound, start_frame=20)
    endless = sequence.bindings[1].tracks[0].add_section()  # as one that was added by hand
    endless.set_editor_property("params", menu.unreal.MovieSceneSkeletalAnimationParams())
    with pytest.raises(menu.DeitalkError, match="has a section from frame -inf to inf"):
        menu.animate_audio(sound, start_frame=54)
    sequence.bindings[1].tracks[0].remove_section(endless)
    menu.animate_audio(sound, start_frame=54)  # two seconds at 24 frames a second
    sections = sequence.bindings[1].tracks[0].sections
    assert [(s.start, s.stop) for s in sections] == [(30, 54), (54, 102)]


def test_right_metahuman_is_chosen(tmp_path, monkeypatch, sound, stand_in):
    anna, bea = metahuman("BP_Anna"), metahuman("BP_Bea", NEW_SKELETON)
    module = editor(tmp_path, anna, bea)
    module.assets[NEW_SKELETON] = object()
    menu = menu_inside(module, monkeypatch, stand_in)
    with pytest.raises(menu.DeitalkError, match="select one MetaHuman: BP_Anna, BP_Bea"):
        menu.animate_audio(sound)
    assert not (tmp_path / "Saved").exists()  # before anything was computed
    menu.animate_audio(sound, actor="BP_Bea")
    assert module.opened.bindings[1].target is bea.components[1]
    with pytest.raises(menu.DeitalkError, match="no actor BP_Cara with a component Face"):
        menu.animate_audio(sound, actor="BP_Cara")
    chosen = editor(tmp_path, anna, bea, selected=[anna])
    menu = menu_inside(chosen, monkeypatch, stand_in)
    menu.animate_audio(sound)
    assert chosen.opened.bindings[1].target is anna.components[1]


def test_sound_asset_is_read_from_its_file_or_written(tmp_path, monkeypatch, sound, stand_in):
    module = editor(tmp_path, metahuman("BP_Anna"))
    module.assets["/Game/Audio/L1"] = fake_unreal.SoundWave("L1", sound, 2.0)
    recorded = fake_unreal.SoundWave("L2", r"D:\gone\L2.wav", 2.0)
    recorded.content = Path(sound).read_bytes()
    menu = menu_inside(module, monkeypatch, stand_in)
    menu.animate_audio("/Game/Audio/L1")
    assert words_of(tmp_path)[1] == sound
    menu.animate_audio(recorded, start_frame=200)
    written = tmp_path / "Saved/deitalk/sounds/L2.wav"
    assert written.read_bytes() == recorded.content
    assert not any(path.endswith("_sound") for path in module.assets)  # none is imported again
    with pytest.raises(menu.DeitalkError, match="no sound at 'x"):
        menu.animate_audio("x.wav")


def test_board_gets_keys_instead_of_an_animation(tmp_path, monkeypatch, sound, stand_in):
    rig = fake_unreal.ControlRig("Face_ControlBoard_CtrlRig", controls_of_the_board())
    sequence = fake_unreal_editor.SceneSequence([rig], playback=(50, 60))
    module = editor(tmp_path, level_sequence=sequence)
    menu = menu_inside(module, monkeypatch, stand_in)
    assert menu.animate_audio(sound, on_board=True) is None
    frames, values = rig.keys("CTRL_C_jaw.Y")
    assert frames == list(range(50, 111)) and values[-1] == pytest.approx(60 / 61)
    assert [s.start for t in sequence.audio for s in t.sections] == [50]


def test_start_script_adds_the_menu_when_the_editor_has_one(tmp_path, monkeypatch, sound, stand_in):
    module = editor(
        tmp_path, metahuman("A"), assets=[fake_unreal.SoundWave("L1", sound, 2.0), object()]
    )
    menu_inside(module, monkeypatch, stand_in)
    importlib.import_module("init_unreal")
    assert module.menus == {} and len(module.ticks) == 1
    module.start()
    assert module.ticks == {}  # it waits no longer
    for place in ("LevelEditor.MainMenu", "ContentBrowser.AssetContextMenu.SoundWave"):
        own = module.menus[place].menus["deitalk"]
        labels = [entry.label for entry in own.entries.values()]
        assert labels[0] == "Animate audio…" and len(labels) == 11
    exec(own.entries["deitalk_sad"].command, {})
    words = words_of(tmp_path)
    assert words[words.index("-e") + 1] == "sad" and module.shown == []
    assert "/Game/deitalk/L1_sad" in module.assets


def test_window_gives_sound_emotion_and_intensity(tmp_path, monkeypatch, sound, stand_in):
    module = editor(tmp_path, metahuman("A"))
    menu = menu_inside(module, monkeypatch, stand_in)

    def fill_in(options):
        assert options.get_editor_property("intensity") == 1.0
        options.get_editor_property("file").file_path = sound
        kind = options.types["emotion"]
        options.values["emotion"] = kind.SURPRISED
        options.set_editor_property("intensity", 0.5)

    module.answers += [fill_in, None, lambda options: None]
    menu.open_dialog()
    words = words_of(tmp_path)
    assert words[words.index("-e") + 1] == "surprised"
    assert float(words[words.index("--intensity") + 1]) == 0.5
    assert menu.open_dialog() is None and module.shown == []  # cancelled
    assert menu.open_dialog() is None
    assert module.shown == ["choose a sound asset or a sound file"]


def test_mistakes_of_the_menu_are_one_line_in_a_message(tmp_path, monkeypatch, sound, stand_in):
    module = editor(tmp_path, metahuman("A"))
    menu = menu_inside(module, monkeypatch, stand_in)
    assert menu.animate_selected("happy") is None
    assert module.shown == ["select one sound in the Content Browser; 0 are selected"]
    with pytest.raises(menu.DeitalkError, match=r"deitalk: error: speech.wav is silent; .*\.log"):
        menu.animate_audio(sound, "angry")
    with pytest.raises(menu.DeitalkError, match="intensity 9 is outside 0 to 4"):
        menu.animate_audio(sound, intensity=9)
    stand_in["command"] = ["/nowhere/deitalk"]
    with pytest.raises(
        menu.DeitalkError, match=r"cannot start /nowhere/deitalk: .*deitalk install unreal"
    ):
        menu.animate_audio(sound)
    assert set(module.assets) == {SKELETON} and module.opened is None


def test_cancelled_process_is_ended(tmp_path, monkeypatch, sound, stand_in):
    (tmp_path / "program.py").write_text("import time\ntime.sleep(60)")
    menu = menu_inside(editor(tmp_path, metahuman("A")), monkeypatch, stand_in)
    monkeypatch.setattr(fake_unreal.ScopedSlowTask, "should_cancel", lambda self: True)
    ended = []
    wait = menu.deitalk_call.subprocess.Popen.wait
    monkeypatch.setattr(
        menu.deitalk_call.subprocess.Popen, "wait", lambda p, *a: ended.append(wait(p, *a))
    )
    with pytest.raises(menu.DeitalkError, match="cancelled"):
        menu.animate_audio(sound)
    assert ended and ended[0] != 0


class Service(http.server.BaseHTTPRequestHandler):
    """Answers of the service as docs/service.md states them: 202 and a job for a long recording."""

    calls, polls, result, refuses = [], 0, b"", False

    def do_POST(self):
        self.calls.append((self.path, dict(self.headers)))
        self.rfile.read(int(self.headers["Content-Length"]))
        if self.refuses:
            return self.answer(422, {"detail": "the recording is silent", "status": 422})
        return self.answer(202, {"id": "j1", "status": "queued"})

    def do_GET(self):
        assert self.path.startswith("/v1/jobs/j1")
        if self.path.endswith("/result"):
            return self.answer(200, self.result)
        type(self).polls += 1
        return self.answer(200, {"id": "j1", "status": "running" if self.polls < 2 else "done"})

    def answer(self, status, content):
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_):
        pass


def test_service_is_called_instead_of_the_command(tmp_path, monkeypatch, sound, stand_in):
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Service)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    Service.result = (tmp_path / "ready").read_bytes()
    address = f"http://127.0.0.1:{server.server_port}"
    settings = stand_in | {"service": address, "key": "k1"}
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("mine")
    module = editor(tmp_path, metahuman("A"))
    menu = menu_inside(module, monkeypatch, settings)
    monkeypatch.setattr(menu.deitalk_call, "JOB_POLL_SECONDS", 0.01)
    try:
        menu.animate_audio(sound, "happy", 2)
        path, headers = Service.calls[0]
        assert path == "/v1/animations?emotion=happy&intensity=2.0&timecode=zero&format=unreal"
        assert headers["Authorization"] == "Bearer k1" and Service.polls == 2
        assert "/Game/deitalk/line_happy" in module.assets
        call = menu.deitalk_call
        found = call.animate(sound, str(mine), timecode="recording", settings=settings)
        assert "timecode=recording" in Service.calls[-1][0]
        assert found == f"{mine}.unreal.json" and os.listdir(mine) == ["notes.txt"]
        monkeypatch.setattr(Service, "refuses", True)
        with pytest.raises(menu.DeitalkError, match="the service refuses: the recording is silent"):
            menu.animate_audio(sound)
    finally:
        server.shutdown()
        server.server_close()
    with pytest.raises(menu.DeitalkError, match=f"no service at {address}"):
        menu.animate_audio(sound)


@pytest.mark.parametrize(
    ("text", "message"),
    [("{", "cannot read"), ("[]", "no object"), ('{"command": "x"}', "must be a list")],
)
def test_damaged_settings_are_one_line(tmp_path, monkeypatch, text, message):
    run_inside(None, monkeypatch)
    call = importlib.import_module("deitalk_call")
    (tmp_path / "s.json").write_text(text)
    with pytest.raises(RuntimeError, match=message):
        call.read_settings(str(tmp_path / "s.json"))
    assert call.read_settings(str(tmp_path / "absent.json"))["command"] == ["deitalk"]


def test_page_lists_every_class_and_function_of_unreal_that_the_scripts_call():
    page = (SCRIPT.parents[2] / "docs" / "unreal-menu.md").read_text()
    used = set()
    for name in MODULES[:3]:
        tree = ast.parse(SCRIPT.with_name(f"{name}.py").read_text(), feature_version=(3, 9))
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                if node.value.id == "unreal":
                    used.add(node.attr)
    listed = set(re.findall(r"`(\w+)[`.(]", page))
    assert used <= listed, sorted(used - listed)


@pytest.mark.slow
def test_deitalk_itself_is_started(tmp_path, monkeypatch):
    recording = str(SCRIPT.parents[2] / "docs" / "samples" / "promise.flac")
    run_inside(None, monkeypatch)
    call = importlib.import_module("deitalk_call")
    settings = {"command": [sys.executable, "-m", "deitalk"], "service": "", "key": ""}
    path = call.animate(recording, str(tmp_path / "take"), "happy", 1.0, settings=settings)
    assert read_curves(path).fps == 30 and Path(path).name == "promise.unreal.json"


@pytest.mark.parametrize("start", [0.0, 36672.5])
def test_live_link_take_gets_its_sound_at_its_time_code(tmp_path, monkeypatch, stand_in, start):
    take = tmp_path / "take"
    take.mkdir()
    write_curves(take / "line_take_1_anna.csv", speech(61), format="livelink", start=start)
    for name, seconds in (("audio.wav", 1), ("audio_48k.wav", 2)):
        with wave.open(str(take / name), "wb") as stream:
            stream.setparams((1, 2, 16000, 0, "NONE", ""))
            stream.writeframes(bytes(32000 * seconds))
    module = editor(tmp_path)
    menu = menu_inside(module, monkeypatch, stand_in)
    sequence = menu.placing.live_link_take(str(take / "line_take_1_anna.csv"))
    assert module.opened is sequence and module.imported[0].subject == "anna"
    (section,) = [s for track in sequence.audio for s in track.sections]
    first = round(start * 60)  # the importer shows files in sixtieths at 60 frames a second
    assert (section.start, section.stop) == (first, first + 120)
    assert section.sound.path == str(take / "audio_48k.wav")


@pytest.mark.parametrize("version", [0, 1])
def test_live_link_take_chooses_its_subject_on_the_only_face(
    tmp_path, monkeypatch, stand_in, version
):
    write_curves(tmp_path / "line_take_1_anna.csv", speech(61), format="livelink")
    anna, lamp = metahuman("BP_Anna"), fake_unreal_editor.Actor("Lamp")
    module = editor(tmp_path, lamp, anna)
    placing = menu_inside(module, monkeypatch, stand_in).placing
    with pytest.raises(
        placing.DeitalkError, match=r"no blueprint at .*enable the plugin Live Link"
    ):
        placing.choose_subject("anna")
    module.assets[placing.LIVE_LINK[version]] = fake_unreal_editor.LiveLinkBlueprint
    placing.live_link_take(str(tmp_path / "line_take_1_anna.csv"))
    face = anna.components[1]
    assert face.anim_instance.LLink_Face_Subj.name == "anna" and face.updates
    assert "BP_Anna shows the Live Link subject anna" in module.messages
    monkeypatch.setattr(
        fake_unreal_editor.LiveLinkBlueprint, "set_editor_property", lambda *given: None
    )
    with pytest.raises(placing.DeitalkError, match="keeps the subject None; choose ben by hand"):
        placing.choose_subject("ben", "BP_Anna")


def test_take_without_time_codes_is_an_error_of_one_line(tmp_path, monkeypatch, stand_in):
    menu = menu_inside(editor(tmp_path), monkeypatch, stand_in)
    for text in ("", "a,b\n1,2\n"):
        (tmp_path / "a.csv").write_text(text)
        with pytest.raises(menu.DeitalkError, match="has no time codes"):
            menu.placing.live_link_take(str(tmp_path / "a.csv"))


def test_changed_recording_is_imported_again_and_sounds_of_others_stay(
    tmp_path, monkeypatch, sound, stand_in
):
    module = editor(tmp_path, metahuman("A"))
    placing = menu_inside(module, monkeypatch, stand_in).placing
    first = placing.import_sound(sound).duration
    shorter = Path(sound).read_bytes()
    with wave.open(sound, "wb") as stream:
        stream.setparams((1, 2, 16_000, 0, "NONE", ""))
        stream.writeframes(bytes(2 * 48_000))
    assert placing.import_sound(sound).duration == 3.0 != first
    other = tmp_path / "other" / Path(sound).name
    other.parent.mkdir()
    other.write_bytes(shorter)
    names = {path for path in module.assets if "_sound" in path}
    assert placing.import_sound(str(other)).duration == first
    assert {path for path in module.assets if "_sound" in path} == names | {
        f"{next(iter(names))}_2"
    }
