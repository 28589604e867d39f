"""`Acting`: text forms, ranges, files that may be named, the schema."""

import json
from pathlib import Path

import pytest
from hypothesis import given, strategies

from deitalk import LiveAnimator, animate, animate_batch, animate_mesh
from deitalk.acting import LIVE_FIELDS, Acting
from deitalk.acting_fields import Words
from deitalk.emotions import LABELS
from deitalk.errors import ConfigError
from rig.errors import UserError
from rig.limits import SEED
from tests.errors import one_line

FIXES = '{"schema": "deitalk.edit/1", "edits": [{"target": "brow", "keys": [[0, 0.5]]}]}'
KEYS = "time,emotion,strength\n0,happy,0.2\n1,angry,1\n"
NUMBERS = {"intensity": (0.0, 4.0), "listen": (0.0, 600.0)}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ({"life": "brows=.8"}, {"life": {"brows": 0.8}}),
        ({"life": "off"}, {"life": {"brows": 0, "head": 0, "gaze": 0, "blinks": 0}}),
        ({"look_at": "10,-5"}, {"look_at": (10, -5)}),
        ({"gain": "jaw=1.2,brow=.5"}, {"gain": {"jaw": 1.2, "brow": 0.5}}),
        ({"intensity": "1,5"}, {"intensity": 1.5}),
        ({"intensity": "150%"}, {"intensity": 1.5}),
        ({"rest": "50 %"}, {"rest": 0.5}),
        ({"emotion": "happy=50%"}, {"emotion": {"happy": 0.5}}),
        ({"emotion": {"happy": "50%"}}, {"emotion": {"happy": 0.5}}),
        ({"emotion": KEYS.replace("0.2", "20%")}, {"emotion": KEYS}),
        ({"emotion": "time;happy\n0;12,5%\n"}, {"emotion": "happy=0.125"}),
        (
            {"intensity_curve": "time,intensity\n0,50%\n"},
            {"intensity_curve": "time,intensity\n0,.5\n"},
        ),
        ({"variant": "hot=50%"}, {"variant": {"hot": 0.5}}),
        ({"gain": "jaw=120%"}, {"gain": {"jaw": 1.2}}),
        ({"life": "brows=80%"}, {"life": {"brows": 0.8}}),
        ({"emotion": "happy=0.7"}, {"emotion": {"happy": 0.7}}),
        ({"emotion": '{"happy": 0.7}'}, {"emotion": "happy=.7"}),
        ({"rules": "no"}, {"rules": False}),
        ({"seed": "12"}, {"seed": 12}),
        ({"edit": f"[{FIXES}]"}, {"edit": json.loads(FIXES)}),
        ({}, {"emotion": "neutral", "life": "on", "gain": "", "voice": None, "words": None}),
    ],
)
def test_text_and_value_are_one_acting(text, value):
    assert Acting.of(**text) == Acting.of(**value)
    assert Acting.of(**Acting.of(**text).settings) == Acting.of(**text)


@pytest.mark.parametrize(
    "fields",
    [
        {"listen": "50%"},
        {"look_at": "50%,0"},
        {"seed": "50%"},
        {"rest": "120%"},
        {"rest": "%"},
        {"emotion": "happy=150%"},
        {"emotion": "time,emotion,strength\n50%,happy,1\n"},
    ],
)
def test_seconds_degrees_and_shares_above_all_are_no_percentages(fields):
    with one_line(UserError, match="%|150"):
        Acting.of(**fields)


finite = strategies.floats(0, 2)
actings = strategies.fixed_dictionaries(
    {},
    optional={
        "emotion": strategies.sampled_from([*LABELS, "happy=0.25,sad=0.5", KEYS, "auto"]),
        "intensity": strategies.floats(0, 4),
        "intensity_curve": strategies.just("time,intensity\n0,0.5\n1,2\n"),
        "style": strategies.text(min_size=1, max_size=20),
        "words": strategies.sampled_from(
            ["Bob's map.", "1\n00:01,0 --> 00:02,0\na\n", "two\nlines"]
        ),
        "life": strategies.dictionaries(strategies.sampled_from(["blinks", "head"]), finite),
        "look_at": strategies.tuples(strategies.integers(-35, 35), strategies.integers(-35, 35)),
        "edit": strategies.sampled_from([FIXES, f"[{FIXES}, {FIXES}]", [FIXES, FIXES]]),
        "gain": strategies.dictionaries(strategies.sampled_from(["jaw", "brow"]), finite),
        "listen": strategies.floats(0, 600),
        "rules": strategies.booleans(),
        "seed": strategies.integers(0, SEED),
    },
)


@given(actings)
def test_settings_are_json_that_gives_the_acting_again(fields):
    acting = Acting.of(**fields)
    settings = json.loads(json.dumps(acting.settings))
    again = Acting.of(files={}, **settings)
    assert again.settings == acting.settings
    assert settings.keys() <= fields.keys()  # nothing but what was given


@given(strategies.floats(), strategies.sampled_from(sorted(NUMBERS)))
def test_numbers_are_within_their_range_or_refused_in_one_line(value, name):
    low, high = NUMBERS[name]
    for given_value in (value, repr(value)):
        if low <= value <= high:
            assert getattr(Acting.of(**{name: given_value}), name) == value
            continue
        with one_line(ConfigError, f"{high:g}", match=name):
            Acting.of(**{name: given_value})


@pytest.mark.parametrize("seed", [-1, SEED + 1, 1.5, "1.5", True, "x", str(10**30)])
def test_seeds_are_whole_numbers_up_to_one_largest(seed):
    assert Acting.of(seed=SEED).seed == SEED
    with pytest.raises(ConfigError, match="seed"):
        Acting.of(seed=seed)


@pytest.mark.parametrize(
    ("field", "name", "content"),
    [
        ("emotion", "keys.csv", KEYS),
        ("emotion", "keys.json", '[{"time": 0, "emotion": "sad", "strength": 1}]'),
        ("intensity_curve", "intensity.csv", "time,intensity\n0,1\n"),
        ("edit", "fixes.edit.json", FIXES),
        ("words", "said.txt", "Bob may bring my map."),
        ("words", "said.srt", "1\n00:00:01,000 --> 00:00:02,000\nBob\n"),
        (
            "voice",
            "anna.json",
            '{"format": "deitalk-actor", "version": 1, "strength": 1, '
            '"recordings": 3, "seconds": 4}',
        ),
    ],
)
def test_requests_read_the_files_that_came_with_them_and_no_others(
    field, name, content, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(content)
    here = Acting.of(**{field: name})
    assert Acting.of(**{field: content}) == here
    for named in (name, str(tmp_path / name), f"../{name}"):
        with one_line(UserError, match="was not sent"):
            Acting.of(files={}, **{field: named})
    with pytest.raises(UserError):
        Acting.of(files={}, **{field: Path(name)})
    if field == "voice":  # a file of several lines that is no actor's
        with one_line(UserError, match="no JSON"):
            Acting.of(files={}, voice="time,value\n0,1\n")
    sent = Path(name).rename(f"sent{Path(name).suffix}")
    assert Acting.of(files={name: sent}, **{field: name}) == here


@pytest.mark.parametrize(
    "text", ["../happy.csv", "happy=1/x.csv", "happy=0.5.json", "", "happy=", "a" * 500, "a\n.csv"]
)
def test_no_text_of_a_request_opens_a_path(text, tmp_path, monkeypatch):
    def opened(*_, **__):
        raise AssertionError("a file was opened")

    monkeypatch.setattr("rig.files.reading.read_bytes", opened)
    monkeypatch.setattr("deitalk.emotions.tracks.read_table", opened)
    for field in ("emotion", "intensity_curve", "voice", *(("edit",) if text else ())):
        with pytest.raises(UserError) as caught:
            Acting.of(files={}, **{field: text})
        told = str(caught.value)
        assert "\n" not in told and ("../" not in text or "was not sent" in told)


def test_partial_updates_keep_the_rest():
    first = Acting.of(emotion="sad", gain="jaw=2", look_at="3,4")
    second = Acting.of(first, emotion="happy", gain=None)
    with one_line(ConfigError, match="acting 'happy' must be an Acting"):
        Acting.of("happy")  # type: ignore[arg-type]
    assert second.settings == {"emotion": "happy", "gain": "jaw=2", "look_at": "3,4"}
    assert first.settings["emotion"] == "sad"


def test_several_layers_are_named_in_one_text_or_a_list(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.edit.json", "b.edit.json"):
        Path(name).write_text(FIXES.replace('"edits"', f'"name": "{name[0]}", "edits"'))
    for given_edit in ("a.edit.json; b.edit.json", ["a.edit.json", Path("b.edit.json")]):
        assert [layer.name for layer in Acting.of(edit=given_edit).edit] == ["a", "b"]
    assert len(Acting.of(edit=tmp_path).edit) == 2  # as of a take folder
    with one_line(ConfigError, match="edit 3 is a int"):
        Acting.of(edit=3)


def test_live_voices_refuse_what_needs_the_whole_recording():
    assert Acting.of(emotion="happy", life="off", seed=3).check_live().seed == 3
    for fields in ({"words": "a"}, {"listen": 2}, {"emotion": "auto"}, {"edit": FIXES}):
        with pytest.raises(ConfigError, match="whole recording"):
            Acting.of(**fields).check_live()
    assert {name for name, when in LIVE_FIELDS.items() if when == "change"} == {
        "emotion", "intensity", "rest", "look_at", "gain", "rules"
    }  # fmt: skip


def test_schema_describes_every_field_with_its_default_as_text():
    properties = Acting.model_json_schema()["properties"]
    assert list(properties) == list(Acting.model_fields)
    for name, schema in properties.items():
        assert schema["description"].endswith((".", "…")), name
        default = schema["default"]
        assert Acting.of(**{name: default}) == Acting(), name
    assert all(name in properties["emotion"]["description"] for name in LABELS)


def test_words_know_their_kind():
    grid = 'File type = "ooTextFile"\nObject class = "TextGrid"\n'
    assert Words.of("One day.").kind == "text"
    assert Words.of("1\n00:00:01,000 --> 00:00:02,000\na\n").kind == "subtitles"
    assert Words.of("WEBVTT\n\n00:01.000 --> 00:02.000\na\n").kind == "subtitles"
    assert Words.of(grid).kind == "grid"
    assert Words.of("Start --> end, word\nfor word").kind == "text"


@pytest.mark.parametrize(
    ("call", "known"),
    [
        (lambda **given: animate(b"", **given), "emotion, acting, model, backend, device"),
        (
            lambda **given: animate_mesh(b"", **given),
            "emotion, acting, model, sample_rate",
        ),
        (lambda **given: animate_batch("a", "b", **given), "emotion, acting, actor, formats"),
        (LiveAnimator, "model, emotion, acting, streams, sample_rate, backend"),
    ],
)
def test_an_unknown_argument_names_all_that_are_known(call, known):
    with one_line(ConfigError, match=f"no argument 'devise'; known are {known}.*, words, .*seed$"):
        call(devise="cuda")
