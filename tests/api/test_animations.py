"""Animations, meshes, retargets, conversions and checks over HTTP."""

import io
import json

import numpy as np
import pytest
import soundfile

from api.messages.formats import ANIMATION_FORMATS
from deitalk import animate
from deitalk.audio.load import write_wav
from deitalk.research.corpus.engines import espeak
from rig import read_curves, write_curves
from rig.conversion.convert import convert
from tests.api.conftest import wav

SPEECH = wav(1.5)


def post(client, path="/v1/animations", files=None, **given):
    return client.post(path, files=files or {"recording": ("speech.wav", SPEECH)}, **given)


@pytest.fixture(scope="module")
def spoken():
    """A line of espeak-ng as WAV, and its words."""
    said = "Bob may bring my map."
    buffer = io.BytesIO()
    sound = espeak.synthesise(said).waveform
    soundfile.write(buffer, sound, 16_000, format="WAV", subtype="FLOAT")
    return buffer.getvalue(), said


def test_words_are_met_as_by_the_library_and_their_fit_is_a_note(client, spoken, tmp_path):
    sound, said = spoken
    files = {"recording": ("a.wav", sound)}
    answer = post(client, files=files, data={"words": said, "format": "npz"})
    assert answer.status_code == 200, answer.text
    assert "the words fit the sound" in json.loads(answer.headers["deitalk-notes"])[-1]
    (tmp_path / "curves.npz").write_bytes(answer.content)
    expected = animate(sound, words=said).curves.values
    np.testing.assert_allclose(read_curves(tmp_path / "curves.npz").values, expected, atol=1e-5)
    timed = b"1\n00:00:00,000 --> 00:00:00,300\nBob\n"
    answer = post(client, files=files | {"words": ("w.SRT", timed)})
    assert answer.status_code == 200, answer.text
    wrong = post(client, files=files, data={"words": "See, see, two necessary cars."})
    assert "do not fit" in json.loads(wrong.headers["deitalk-notes"])[-1]


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ({"words": "w.csv"}, "a file of words is one of .txt"),
        ({"words": "a", "language": "xx"}, "no voice of espeak-ng"),
        ({"words": "?!"}, "no word"),
        ({"words": "a", "rules": "false"}, "rules"),
    ],
)
def test_wrong_words_are_problems(client, data, text):
    answer = post(client, data=data)
    assert answer.status_code == 422 and text in answer.json()["message"], answer.text


def test_raw_body_and_form_give_the_same(client):
    form = post(client, params={"emotion": "sad"})
    raw = client.post(
        "/v1/animations?emotion=sad", content=SPEECH, headers={"Content-Type": "audio/wav"}
    )
    assert form.status_code == raw.status_code == 200
    assert form.json() == raw.json()


def test_cues_end_with_the_sound(client):
    """1.01 s are 31 frames, of 1.03 s."""
    answer = post(
        client, files={"recording": ("a.wav", wav(1.01))}, data={"format": "rhubarb-json"}
    )
    assert answer.json()["metadata"] == {"soundFile": "", "duration": 1.01}


@pytest.mark.parametrize("name", sorted(set(ANIMATION_FORMATS) - {"usd"}))
def test_every_format_is_answered_and_not_empty(client, name):
    if name == "page":
        from deitalk.preview.page import BUNDLE

        if not BUNDLE.is_file():
            pytest.skip("the preview page is not built")
    small = {"recording": ("a.wav", wav(0.5))}
    answer = post(client, files=small, params={"format": name, "name": "my line"})
    assert answer.status_code == 200, answer.text
    known = ANIMATION_FORMATS[name]
    assert answer.headers["content-type"].startswith(known.media_type.partition(";")[0])
    expected = f'attachment; filename="my line{known.suffix}"'
    assert answer.headers["content-disposition"] == expected
    assert len(answer.content) > 20


def test_time_code_is_the_recordings_or_the_given_one(client, tmp_path):
    write_wav(tmp_path / "a.wav", np.zeros(16_000), start=3600.0)
    timed = {"recording": ("a.wav", (tmp_path / "a.wav").read_bytes())}
    starts = [
        post(client, files=files, data={"format": "unreal", "timecode": timecode})
        for files, timecode in ((timed, "recording"), (None, "00:00:02:15"), (None, "recording"))
    ]
    assert [answer.json()["start"] for answer in starts] == [3600.0, 2.5, 0.0]
    assert "no time code" in starts[2].headers["deitalk-notes"]


@pytest.mark.parametrize(
    ("data", "status", "code"),
    [
        ({"emotion": "hapy"}, 422, "emotion_invalid"),
        ({"emotion": "moods.csv"}, 422, "emotion_invalid"),
        ({"emotion": "../../etc/passwd.json"}, 422, "emotion_invalid"),
        ({"emotion": "[{]"}, 422, "emotion_invalid"),
        ({"intensity": "5"}, 422, "option_invalid"),
        ({"intensity": "nan"}, 422, "option_invalid"),
        ({"fps": "0"}, 422, "option_invalid"),
        ({"unknown": "1"}, 422, "option_invalid"),
        ({"model": "sdfa"}, 422, "model_unfit"),
        ({"model": "../../weights"}, 404, "model_unknown"),
        ({"format": "fbx"}, 400, "format_unknown"),
        ({"name": "../x"}, 422, "option_invalid"),
        ({"timecode": "noon"}, 422, "option_invalid"),
        ({"timecode": "10:61:00:00"}, 422, "request_invalid"),
    ],
)
def test_wrong_options_are_problems(client, data, status, code):
    answer = post(client, data=data)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert set(answer.json()) == {"code", "message", "detail"}
    assert "Value error" not in answer.text and len(answer.json()["message"]) < 350


def test_recording_that_is_sent_as_text_is_told(client):
    answer = client.post("/v1/animations", files={"recording": (None, "speech.wav")})
    assert answer.status_code == 422 and "recording=@FILE" in answer.json()["message"]


def test_wrong_bodies_are_problems(client):
    statuses = {
        "noise": post(client, files={"recording": ("a.wav", b"no audio" * 50)}).status_code,
        "none": post(client, files={"emotion": ("a.csv", b"time,emotion,strength")}).status_code,
        "type": client.post("/v1/animations", json={"a": 1}).status_code,
        "empty": client.post("/v1/animations", content=b"").status_code,
        "route": client.get("/v1/nothing").status_code,
        "method": client.get("/v1/animations").status_code,
    }
    assert statuses == {
        "noise": 422, "none": 422, "type": 415, "empty": 422, "route": 404, "method": 405
    }  # fmt: skip


def test_mesh_of_a_recording(client):
    files = {"recording": ("a.wav", wav(0.4))}
    answer = post(client, "/v1/meshes", files, data={"emotion": "happy", "format": "npz"})
    arrays = np.load(io.BytesIO(answer.content))
    frames, vertices, axes = arrays["vertices"].shape
    assert (frames, axes) == (12, 3) and arrays["triangles"].max() == vertices - 1


def test_retarget_drives_the_shapes_of_the_mesh(client):
    neutral = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    deltas = np.zeros((2, 4, 3), np.float32)
    deltas[0, :, 1], deltas[1, :, 0] = -1, 0.5
    buffer = io.BytesIO()
    triangles = np.array([[0, 1, 2], [1, 3, 2]], np.int32)
    names = np.array(["jawOpen", "mouthFunnel"])
    np.savez(buffer, neutral=neutral, triangles=triangles, names=names, deltas=deltas)
    mesh = ("face.npz", buffer.getvalue())
    curves = post(client, params={"format": "csv"}).content
    files = {"mesh": mesh, "curves": ("curves.csv", curves)}
    answer = post(client, "/v1/retargets", files)
    assert answer.status_code == 200, answer.text
    assert answer.content[:4] == b"glTF"
    missing = post(client, "/v1/retargets", {"mesh": mesh})
    assert (missing.status_code, missing.json()["code"]) == (422, "curves_missing")


def test_validation_finds_what_the_command_finds(client, tmp_path):
    good = post(client, params={"format": "csv"}).content
    (tmp_path / "good.csv").write_bytes(good)
    bad = good.replace(b"CTRL_C_jaw.ty", b"CTRL_C_jaw.tz")
    first = client.post("/v1/validate", files={"curves": ("curves.csv", good)}).json()
    second = client.post("/v1/validate", files={"curves": ("curves.csv", bad)}).json()
    assert first["ok"] and not second["ok"]
    assert any("CTRL_C_jaw.tz" in finding["text"] for finding in second["findings"])
    for name in ("a.anim", "a.a2f.json", "a.maya.py", "a.vrma"):  # as it answers them
        write_curves(tmp_path / name, read_curves(tmp_path / "good.csv"))
        files = {"curves": (name, (tmp_path / name).read_bytes())}
        assert client.post("/v1/validate", files=files).json()["ok"], name
    other = client.post("/v1/validate", files={"curves": ("curves.exe", good)})
    assert other.status_code == 415


def test_catalogue(client):
    models = {model["name"]: model["product"] for model in client.get("/v1/models").json()}
    assert models["default"] == "curves" and models["sdfa"] == "mesh"
    emotions = client.get("/v1/emotions").json()
    assert emotions["emotions"][0] == "neutral"
    assert set(emotions["procedural"]) == {"fear", "disgust", "contempt", "calm"}
    assert {*emotions["procedural"]} < {*emotions["emotions"]}
    sets = {known["id"]: known["controls"] for known in client.get("/v1/control-sets").json()}
    assert sets["metahuman-185@mh4"] == 185
    assert len(client.get("/v1/control-sets/metahuman-185@mh4").json()) == 185
    assert client.get("/v1/control-sets/none").status_code == 404
    assert "take" in {known["name"] for known in client.get("/v1/formats").json()["animations"]}


def test_state_and_counts(client):
    post(client)
    assert client.get("/healthz").json()["status"] == "ok"
    assert client.get("/readyz").json()["status"] == "ready"
    text = client.get("/metrics").text
    line = 'deitalk_requests_total{method="POST",route="/v1/animations",status="200"}'
    assert line in text and "deitalk_audio_seconds_total" in text


def test_page_of_the_routes_names_each_and_loads_nothing(client):
    page = client.get("/docs").text
    for path in client.get("/openapi.json").json()["paths"]:
        assert path in page
    assert "<script" not in page and "src=" not in page


def test_conversion_gives_what_the_library_writes(client, tmp_path):
    curves = client.post("/v1/animations", files={"recording": SPEECH}).content
    (tmp_path / "curves.json").write_bytes(curves)
    write_curves(tmp_path / "Phone.csv", read_curves(tmp_path / "curves.json"), format="livelink")
    files = {"curves": ("Phone.csv", (tmp_path / "Phone.csv").read_bytes())}
    form = {"format": "npz", "gain": "jaw=0.5", "name": "mine"}
    answer = client.post("/v1/conversions", files=files, data=form)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-disposition"] == 'attachment; filename="mine.npz"'
    (tmp_path / "mine.npz").write_bytes(answer.content)
    board = convert(read_curves(tmp_path / "Phone.csv", control_set=None), "metahuman-185@mh4")
    found = read_curves(tmp_path / "mine.npz")["CTRL_C_jaw.ty"]
    assert np.abs(found - 0.5 * board["CTRL_C_jaw.ty"]).max() < 1e-6
