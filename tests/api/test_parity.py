"""One acting through every door: the same curves to 1e-5, the same settings in take.json."""

import functools
import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile

from deitalk import animate, suggest_emotion
from deitalk.acting import Acting
from deitalk.audio.load import load_audio
from deitalk.audio.original import ZERO, start_of
from deitalk.data.captures.columns import read_mapping
from deitalk.data.dub import dub
from deitalk.data.edited import changes_of_take
from deitalk.research.corpus.engines import espeak
from rig import read_curves, write_curves
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID
from rig.curves.edit import clamp
from rig.curves.layer_files import read_layers
from rig.face import build_head
from tests.api.case_files import FILES
from tests.api.doors import (
    Made,
    batch_line,
    command_line,
    http,
    live_line,
    live_python,
    manifest,
    mesh,
    only_curves,
    options,
    post,
    run,
    sound,
    take_of,
    websocket,
)
from tests.deitalk.batch.conftest import InProcess
from tests.deitalk.live.conftest import RATE
from tests.media import movie

CASES = {
    "nothing": {},
    "label": {"emotion": "sad", "seed": str(2**40), "look_at": "10,-5", "listen": "1.5", "rest": ".2"},
    "weights": {"emotion": "happy=0.7,surprised=0.3", "intensity": "1.5", "gain": "jaw=1.2,brow=.5"},
    "moods": {"emotion": "fear=.6,sad=.4", "life": "brows=.8,head=2", "style": "eve"},
    "keys": {"emotion": "keys.csv", "edit": "fixes.edit.json", "into": "edge.json"},
    "intensity": {"emotion": "angry", "intensity_curve": "intensity.csv", "voice": "anna.json",
                  "life": "off", "variant": "cold"},
    "transcript": {"words": "My promise is big.", "language": "de", "listen_to": "other.wav",
                   "listen": "1"},
    "timed words": {"words": "said.srt", "after": "edge.json"},
    "script": {"script": "[happily] My promise is *big*.", "after": "edge.json", "into": "edge.json"},
    "script of a role": {"script": "spoken.srt", "role": "anna"},
    "words of a role": {"words": "spoken.srt", "role": "bob"},
    "network alone": {"rules": "false"},
}  # fmt: skip
"""Fields of an acting as text, several in a case: a door that loses one gives other curves."""
LIVE = {
    "label": {"emotion": "sad", "intensity": "1.5", "life": "brows=.8,head=2", "look_at": "10,-5",
              "seed": str(2**40), "variant": "plain"},
    "weights": {"emotion": "happy=0.7,surprised=0.3", "gain": "jaw=1.2,brow=.5", "rest": ".2",
                "style": "eve", "life": "off"},
    "keys": {"emotion": "keys.csv", "rules": "false"},
}  # fmt: skip
WRITTEN = {
    "early": {"delay": "-2", "fps": "24"},
    "handles": {"handles": "8", "fps": "24", "timecode": "01:00:00:00", "edit": "fixes.edit.json"},
    "both": {"delay": "3", "handles": "5", "fps": "60", "edit": "fixes.edit.json"},
}
"""How a take is written; edits have steps, which the rate of the take shows as they are."""
SIGNALS = {
    "pair.pcm": {"channel": "right", "raw": f"f32le,{RATE},2"},
    "tracks.mka": {"track": "2"},
}
"""Which signal of each file is the sound of line.wav."""


@pytest.fixture(scope="module")
def place(tmp_path_factory, tiny_model):
    """A folder with the recording, the files of the cases, and the small model."""
    folder = tmp_path_factory.mktemp("parity")
    shutil.copytree(tiny_model, folder / "tiny")
    rng, t = np.random.default_rng(1), np.arange(3 * RATE // 2) / RATE
    phase = 2 * np.pi * np.cumsum(120 + 40 * np.sin(2 * np.pi * 0.7 * t)) / RATE
    tone = sum(np.sin(k * phase) / k for k in range(1, 12))
    loud = np.clip(np.sin(2 * np.pi * 2.5 * t), 0, 1) * (t > 0.1)
    sound = 0.08 * tone * loud + 2e-4 * rng.standard_normal(len(t))
    soundfile.write(folder / "line.wav", sound, RATE, subtype="FLOAT")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    other = np.roll(sound, RATE // 2)
    soundfile.write(folder / "other.wav", other, RATE, subtype="FLOAT")
    pair = np.stack([other, sound], axis=1)
    soundfile.write(folder / "pair.pcm", pair, RATE, "FLOAT", "LITTLE", "RAW")
    (folder / "tracks.mka").write_bytes(movie("matroska", [other, sound], RATE, codec="pcm_f32le"))
    return folder


@pytest.fixture(scope="module")
def here(place):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        yield place


def test_every_field_is_in_a_case():
    assert {name for fields in CASES.values() for name in fields} == {*Acting.model_fields}


def fields_of(case):
    if {"words", "script"} & CASES[case].keys() and espeak.missing():
        pytest.skip("needs espeak-ng")
    return CASES[case]


def close(found, wanted):
    """Within what steep contacts make of the last bits of another number of threads."""
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() < 3e-5


def same(found, wanted):
    close(found.values, wanted.values)
    assert (found.settings, found.signal) == (wanted.settings, wanted.signal)


@pytest.fixture(scope="module")
def wanted(here, tmp_path_factory):
    """The reference: Python, and its take."""

    @functools.cache
    def make(case) -> Made:
        performance = animate("line.wav", model="tiny", **fields_of(case))
        take = performance.save(tmp_path_factory.mktemp("python") / "take")
        kept = take_of(take)
        return Made(performance.curves.values, kept.settings, kept.signal, kept.written)

    return make


every_case = pytest.mark.parametrize("case", CASES)
every_live_case = pytest.mark.parametrize("case", LIVE)


@every_case
@pytest.mark.parametrize("door", [command_line, batch_line, manifest])
def test_commands_give_the_curves_and_keep_the_settings(wanted, door, case, tmp_path, monkeypatch):
    only_curves(monkeypatch)
    same(door(fields_of(case), tmp_path, monkeypatch), wanted(case))


@every_case
def test_http_gives_the_curves_and_keeps_the_settings(wanted, case, server):
    same(http(fields_of(case), server), wanted(case))


@every_case
def test_mesh_poses_the_same_curves(wanted, case, tmp_path, monkeypatch):
    curves, found = mesh(fields_of(case), tmp_path, monkeypatch)
    close(curves, wanted(case).values)
    posed = build_head(0).pose(wanted(case).values[::10])
    assert found.shape == posed.shape
    assert np.abs(found - posed).max() < 1e-5 * np.ptp(posed[0], axis=0).max()


@every_live_case
def test_live_command_gives_the_curves(here, case, monkeypatch):
    read = load_audio("line.wav").waveform  # without its mean
    close(live_line(LIVE[case], monkeypatch), live_python(LIVE[case], read))


@every_live_case
def test_websocket_gives_the_curves(here, case, server):
    close(websocket(LIVE[case], server), live_python(LIVE[case], sound()))


@every_case
def test_settings_of_a_take_give_the_same_take(wanted, case):
    first = wanted(case)
    again = animate("line.wav", model="tiny", **first.settings)
    close(again.curves.values, first.values)
    assert again.acting.settings == first.settings
    assert first.settings.keys() == CASES[case].keys()


@pytest.mark.parametrize("audio", SIGNALS)
@pytest.mark.parametrize("door", [command_line, batch_line, manifest])
def test_commands_read_the_signal_that_is_chosen(wanted, door, audio, tmp_path, monkeypatch):
    only_curves(monkeypatch)
    check_signal(door(SIGNALS[audio], tmp_path, monkeypatch, audio), audio, wanted)


@pytest.mark.parametrize("audio", SIGNALS)
def test_http_reads_the_signal_that_is_chosen(wanted, audio, server):
    check_signal(http(SIGNALS[audio], server, audio), audio, wanted)


@pytest.mark.parametrize("case", WRITTEN)
def test_every_door_writes_the_same_shift(here, case, tmp_path, server, monkeypatch):
    given, fps = WRITTEN[case], float(WRITTEN[case].get("fps", 30))
    whole = {name: int(given[name]) for name in ("delay", "handles") if name in given}
    start, _ = start_of(given.get("timecode", ZERO), fps, None)
    acted = animate("line.wav", model="tiny", edit=given.get("edit", ()))
    saved = acted.save(tmp_path / "line", fps=fps, start=start, **whole)
    wanted = take_of(saved)
    assert len(wanted.values) == round(1.5 * fps) + 2 * whole.get("handles", 0)
    assert {wanted.written[f"{name}_frames"] for name in whole} == set(whole.values())
    for door in (command_line, batch_line, manifest):
        (tmp_path / door.__name__).mkdir()
        made = door(given, tmp_path / door.__name__, monkeypatch)
        same_shift(made, wanted)
    same_shift(http(given | {"name": "line"}, server), wanted)


def same_shift(found, wanted):
    close(found.values, wanted.values)
    assert found.written == wanted.written and found.settings == wanted.settings


DUBS = {
    "take": {"performance": "face.zip", "stretch": "1.2", "gain": "brow=.5,jaw=1.2"},
    "curves and sound": {"performance": "face.csv", "sound": "other.wav", "edit": "fixes.edit.json"},
    "own rig": {"performance": "rig.csv", "mapping": "map.csv", "source_fps": "25",
                "after": "edge.json", "fps": "24", "delay": "2", "handles": "4"},
}  # fmt: skip


@pytest.fixture(scope="module")
def face(here):
    """A performance as a zipped take, as curves, and as curves of another rig."""
    acted = animate("other.wav", "surprised", model="tiny")
    shutil.make_archive("face", "zip", acted.save(here / "face"))
    write_curves("face.csv", acted.curves)
    rows = ["frame,up,open", *(f"{k},{k % 9 / 10},{k % 5 / 5}" for k in range(40))]
    Path("rig.csv").write_text("\n".join(rows) + "\n")
    Path("map.csv").write_text("target,source\nCTRL_L_brow_raiseOut.ty,up\nCTRL_C_jaw.ty,open\n")


@pytest.mark.parametrize("case", DUBS)
def test_every_door_dubs_alike(face, case, tmp_path, server, monkeypatch):
    given = DUBS[case]
    acting = {name: value for name, value in given.items() if name in Acting.model_fields}
    python = {name: given[name] for name in ("performance", "sound") if name in given}
    if "mapping" in given:
        python["mapping"] = read_mapping(Path(given["mapping"]))
    numbers = {"stretch": "stretch", "source_fps": "fps"}
    python |= {to: float(given[name]) for name, to in numbers.items() if name in given}
    found = dub(
        python.pop("performance"), "line.wav", acting=Acting.of(**acting), model="tiny", **python
    )
    form = {name: int(given[name]) for name in ("fps", "delay", "handles") if name in given}
    wanted = take_of(found.performance.save(tmp_path / "line", **form))
    only_curves(monkeypatch)
    rest = {name: value for name, value in given.items() if name != "performance"}
    run("dub", given["performance"], "line.wav", "-o", tmp_path / "take", "--model", "tiny",
        *options(rest))  # fmt: skip
    monkeypatch.setattr("deitalk.batch.run.Workers", InProcess)
    row = {"audio": "line.wav", "output": "line", "formats": "take"} | given
    table = Path(f"dub-{tmp_path.name}.csv")
    table.write_text(f"{','.join(row)}\n" + ",".join(f'"{cell}"' for cell in row.values()) + "\n")
    for status in ("1 done", "1 unchanged"):
        assert status in run("batch", table, "-o", tmp_path / "out", "--model", "tiny")
    sent = {("curves_fps" if n == "source_fps" else n): v for n, v in given.items()}
    sent |= {"recording": "line.wav", "name": "line"}
    for made in (tmp_path / "take", tmp_path / "out/line", post("/v1/dubs", sent, server)):
        same(take_of(made), wanted)
        told = json.loads((made / "dub.json").read_text())
        assert told["summary"] == found.line and told["kept"] == list(found.kept)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({}, "part `performance`"),
        ({"performance": "line.wav"}, "must end with one of"),
        ({"performance": "keys.csv"}, "performance.csv: data row 1"),
        ({"performance": "face.csv", "stretch": "4"}, "stretch"),
        ({"performance": "face.csv", "sound": "keys.csv"}, "sound"),
        ({"performance": "face.csv", "sound": "/etc/nothing"}, "text where a file is needed"),
        ({"listen_to": "/etc/nothing"}, "was not sent"),
    ],
)
def test_http_refuses_a_dub_that_cannot_be(here, face, fields, words, server):
    is_file = {name: (here / value).is_file() for name, value in fields.items()}
    files = {n: (v, (here / v).read_bytes()) for n, v in fields.items() if is_file[n]}
    data = {name: value for name, value in fields.items() if not is_file[name]}
    files["recording"] = ("line.wav", Path("line.wav").read_bytes())
    with server.client() as client:
        answer = client.post("/v1/dubs", files=files, data=data | {"model": "tiny"})
    assert answer.status_code in (415, 422) and words in answer.json()["message"], answer.text


DIFFS = {
    "csv": ("edited.csv", {}),
    "raw curves": ("Shot 7.raw.csv", {"tolerance": "0.03", "name": "anna"}),
    "rows, late, with handles": ("late.csv", {"fps": "30", "delay": "2", "handles": "8"}),
}
"""An edited file, and the options of its comparison."""
TITLES = {"csv": "edited", "raw curves": "anna", "rows, late, with handles": "late"}


@pytest.fixture(scope="module")
def edits(face):
    """The take `face` edited by hand, in files of several programs."""
    base = read_curves("face/curves.json")
    values = base.values.copy()
    for name, change in (("CTRL_L_brow_raiseOut.ty", 0.3), ("CTRL_R_nose.ty", 0.5)):
        values[10:30, base.index(name)] += change * np.hanning(20)
    edited, _ = clamp(replace(base, values=values))
    write_curves("edited.csv", edited)
    write_curves("Shot 7.raw.csv", convert(edited, RAW_ID))
    write_curves("held.csv", edited, delay=2, handles=8)
    rows = read_curves("held.csv").values
    np.savetxt("late.csv", rows, "%.5f", ",", header=",".join(edited.names), comments="")
    write_curves("same.csv", base)


@pytest.mark.parametrize("case", DIFFS)
def test_every_door_finds_the_same_edits(edits, case, tmp_path, server):
    edited, given = DIFFS[case]
    kinds = {"fps": float, "tolerance": float, "delay": int, "handles": int}
    numbers = {name: kinds[name](value) for name, value in given.items() if name != "name"}
    found = changes_of_take(edited, "face", name=TITLES[case], **numbers)
    assert {edit.target for edit in found.layer.edits} >= {"CTRL_L_brow_raiseOut.ty"}
    assert found.layer.sound is not None
    flags = options({name: value for name, value in given.items() if name != "name"})
    for take in ("face", "face.zip"):
        out = tmp_path / take / f"{TITLES[case]}.edit.json"
        out.parent.mkdir()
        run("diff", edited, take, "-o", out, *flags)
        assert out.read_text() == found.layer.text
    with server.client() as client:
        answer = client.post("/v1/diffs", files=parts(edited, "face.zip"), data=given)
    assert answer.content == out.read_bytes(), answer.text
    assert answer.headers["content-type"] == "application/json"
    assert f'"{out.name}"' in answer.headers["content-disposition"]
    assert json.loads(answer.headers.get("deitalk-notes", "[]")) == list(found.notes)
    again = animate("other.wav", "surprised", model="tiny", edit=read_layers(out)[0]).curves
    if edited == "edited.csv":
        assert np.abs(again.values - read_curves(edited).values).max() < 0.011


def parts(edited, take):
    sent = {"edited": edited, "take": take}
    return {name: (path, Path(path).read_bytes()) for name, path in sent.items() if path}


@pytest.mark.parametrize(
    ("edited", "take", "data", "words"),
    [
        (None, "face.zip", {}, "part `edited`"),
        ("edited.csv", None, {}, "part `take`"),
        ("edited.csv", None, {"take": "/etc/passwd"}, "text where a file is needed"),
        (None, "face.zip", {"edited": "/etc/passwd"}, "text where a file is needed"),
        ("line.wav", "face.zip", {}, "must end with one of"),
        ("edited.csv", "edited.csv", {}, "must end with one of"),
        ("keys.csv", "face.zip", {}, "edited.csv"),
        ("edited.csv", "bare.zip", {}, "take.zip has no curves.json"),
        ("edited.csv", "broken.zip", {}, "no zipped take"),
        ("edited.csv", "spoken.zip", {}, "was not sent"),
        ("same.csv", "face.zip", {}, "no more than noise"),
        ("edited.csv", "face.zip", {"tolerance": "0.5"}, "tolerance"),
        ("edited.csv", "face.zip", {"name": "../x"}, "name"),
        ("edited.csv", "face.zip", {"out": "x.edit.json"}, "out"),
    ],
)
def test_http_refuses_what_cannot_be_compared(edits, edited, take, data, words, server):
    with zipfile.ZipFile("bare.zip", "w") as bare:
        bare.writestr("readme.txt", "no curves")
    Path("broken.zip").write_bytes(b"PK no archive")
    with zipfile.ZipFile("spoken.zip", "w") as spoken:  # its settings name a file of the server
        for name in ("curves.json", "audio.wav"):
            spoken.write(f"face/{name}", name)
        spoken.writestr("take.json", json.dumps({"settings": {"words": "/etc/hosts.txt"}}))
    with server.client() as client:
        answer = client.post("/v1/diffs", files=parts(edited, take), data=data)
    message = answer.json()["message"]
    assert answer.status_code in (415, 422) and words in message, answer.text
    assert "\n" not in message and "/etc/passwd" not in message


def check_signal(made, audio, wanted):
    close(made.values, wanted("nothing").values)
    given = SIGNALS[audio]
    assert made.signal == {n: int(v) if n == "track" else v for n, v in given.items()}


@pytest.mark.parametrize("audio", SIGNALS)
def test_python_and_the_mesh_read_the_signal_that_is_chosen(wanted, audio, tmp_path, monkeypatch):
    made = animate(audio, model="tiny", **SIGNALS[audio])
    close(made.curves.values, wanted("nothing").values)
    assert suggest_emotion(audio, **SIGNALS[audio]) == suggest_emotion("line.wav")
    curves, _ = mesh(SIGNALS[audio], tmp_path, monkeypatch, audio)
    close(curves, wanted("nothing").values)


@pytest.mark.parametrize("audio", SIGNALS)
def test_live_command_reads_the_signal_that_is_chosen(here, audio, monkeypatch):
    read = load_audio("line.wav").waveform
    close(live_line(SIGNALS[audio], monkeypatch, audio), live_python({}, read))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"track": "0"}, "track"),
        ({"track": "2"}, "1 sound track"),
        ({"channel": "middle"}, "left, right, centre, loudest, mix"),
        ({"channel": "3"}, "no channel 3"),
        ({"raw": "mp3"}, "s16le,24000,1"),
        ({"raw": "s16le,24000"}, "has a header"),
    ],
)
def test_http_refuses_a_signal_that_is_not_there(here, data, words, server):
    files = {"recording": ("line.wav", Path("line.wav").read_bytes())}
    with server.client() as client:
        answer = client.post("/v1/animations", files=files, data=data | {"model": "tiny"})
    assert answer.status_code == 422 and words in answer.text, answer.text
