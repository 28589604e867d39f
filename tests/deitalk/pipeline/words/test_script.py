"""Scripts: notations to words and marks, their times, and what they change of a take."""

import json
import re

import numpy as np
import pytest

from deitalk import animate
from deitalk.acting import Acting
from deitalk.emotions import LABELS, parse_emotion
from deitalk.errors import DataError, DeitalkError
from deitalk.pipeline.words.align import FittedWord
from deitalk.pipeline.words.espeak import missing
from deitalk.pipeline.words.marks import (
    RAMP_SECONDS,
    Mark,
    TimedMark,
    levels,
    timed_mark,
    with_accents,
    with_emotions,
)
from deitalk.pipeline.words.script import Script
from deitalk.pipeline.words.ssml import DEEPEST
from deitalk.pipeline.words.tags import known_tags
from deitalk.postprocess.life.voice import Accent, Voice
from rig.errors import UserError
from tests.errors import one_line

pytestmark = [
    pytest.mark.skipif(missing() is not None, reason=f"words need espeak-ng: {missing()}"),
    pytest.mark.usefixtures("one_analysis"),
]
TIMES = np.arange(90) / 30


def script(text, **options):
    return Script.of(text, "en-us", **options)


def said(text, **options):
    return [word.text for word in script(text, **options).transcript.words]


def spans(text, *kinds):
    """Name and words of each mark of some kinds."""
    found = script(text)
    words = [word.text for word in found.transcript.words]
    return [
        (mark.name, words[mark.first : mark.stop]) for mark in found.marks if mark.kind in kinds
    ]


@pytest.mark.parametrize(
    ("kind", "place", "misfits", "span"),
    [
        ("sound", 1, (), (1.25, 1.75)),  # a pause shorter than a sound
        ("sound", 1, (1,), (1.4, 3.0)),
        ("sound", 1, (0,), (0.0, 1.6)),
        ("sound", 0, (0,), (0.0, 1.6)),
        ("sound", 2, (1,), (1.4, 3.0)),
        ("sound", 3, (2,), (2.8, 4.8)),  # at most two seconds
        ("pause", 1, (1,), (1.4, 1.6)),
    ],
)
def test_sound_that_is_no_word_lies_between_words_that_fit(kind, place, misfits, span):
    """The aligner lays a laugh over a word beside it, which then does not fit."""
    times = ((0.4, 1.4), (1.6, 2.6), (3.0, 3.6))
    words = [FittedWord(f"w{k}", *t, -9.0 if k in misfits else 0.0) for k, t in enumerate(times)]
    found = timed_mark(Mark(kind, "laughs", "happy=0.9", place, place), words, 5.0)
    assert (found.start, found.end) == pytest.approx(span)


@pytest.mark.parametrize("tag", known_tags())
def test_every_tag_of_the_table_means_something(tag):
    kind, value = known_tags()[tag]
    assert tag == tag.lower().strip()
    found = script(f"One [{tag}] two three.")
    assert [word.text for word in found.transcript.words] == ["One", "two", "three"]
    (mark,) = found.marks
    assert not found.unknown and (mark.kind, mark.value, mark.first) == (kind, value, 1)
    if kind in ("emotion", "sound"):
        assert parse_emotion(value).weights.shape == (1, len(LABELS))
    elif kind in ("voice", "pause"):
        assert 0 < float(value) <= 2


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("[angrily] One two. three", [("angrily", ["One", "two", "three"])]),
        ("One [Angrily] two [HAPPY] three", [("angrily", ["two"]), ("happy", ["three"])]),
        ("[sad] One\ntwo", [("sad", ["One"])]),
        ("[sad] One [/sad] two", [("sad", ["One"])]),
        ("[sad tone] One", [("sad", ["One"])]),
        ("(sadly) One", [("sadly", ["One"])]),
        ("One two [sad]", []),
        ("[whispers] [sad] One [neutral] two",
         [("whispers", ["One"]), ("sad", ["One"]), ("neutral", ["two"])]),
        ("[whispers] One [angrily] two [shouts] three",
         [("whispers", ["One"]), ("angrily", ["two"]), ("shouts", ["three"])]),
    ],
)  # fmt: skip
def test_a_tag_holds_to_the_next_one_or_the_end_of_its_line(text, found):
    assert sorted(spans(text, "emotion", "voice")) == sorted(found)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("One *two* three", [("two", ["two"])]),
        ("One TWO three", [("TWO", ["TWO"])]),
        ("One *two three* four", [("two three", ["two", "three"])]),
        ("ALL OF IT IS LOUD", []),
        ("I say a thing", []),
    ],
)
def test_stressed_words(text, found):
    assert spans(text, "accent") == found


@pytest.mark.parametrize(
    "text", ["[zorbs] One", "One (door slams)", "One [laughs like a drain] two", "One [2x] two"]
)
def test_unknown_tags_are_listed_and_not_spoken(text):
    found = script(text)
    (tag,) = found.unknown
    assert tag in text and tag in " ".join(found.notes())
    assert all(word.text in ("One", "two") for word in found.transcript.words)
    assert not found.marks


@pytest.mark.parametrize(
    "text", ["It is 1984 [angrily] now.", "a a a [sad] now", "1984 1984 -- [sad] now", "I [sad] now", "and a [sad] now",
             "1984 is a number, 7 too, and 12345 [sad] now then"],
)  # fmt: skip
def test_words_that_are_pronounced_as_more_or_fewer_keep_the_places(text):
    found = script(text)
    (mark,) = found.marks
    assert found.transcript.words[mark.first].text == "now"


@pytest.mark.parametrize(
    ("text", "kind", "found"),
    [
        ("<emphasis>two</emphasis>", "accent", ("emphasis moderate", "0.7", ["two"])),
        ("<emphasis level='strong'>two</emphasis>", "accent", ("emphasis strong", "1.0", ["two"])),
        ("<emphasis level='none'>two</emphasis>", "accent", ("emphasis none", "0.0", ["two"])),
        ("<break time='250ms'/>two", "pause", ("break 250ms", "0.25", [])),
        ("<break time='1.5s'/>two", "pause", ("break 1.5s", "1.5", [])),
        ("<break strength='strong'/>two", "pause", ("break strong", "0.7", [])),
        ("<break/>two", "pause", ("break medium", "0.4", [])),
        ("<prosody volume='loud' rate='fast'>two</prosody>", "voice",
         ("volume loud", "1.25", ["two"])),
        ("<prosody volume='+12dB'>two</prosody>", "voice", ("volume +12dB", "2", ["two"])),
        ("<mstts:express-as style='angry'>two</mstts:express-as>", "emotion",
         ("angry", "angry=0.9", ["two"])),
        ("<amazon:effect name='whispered'>two</amazon:effect>", "voice",
         ("whispered", "0.5", ["two"])),
    ],
)  # fmt: skip
def test_elements_of_ssml(text, kind, found):
    read = script(f"<speak>One {text} three</speak>")
    words = [word.text for word in read.transcript.words]
    assert words == ["One", "two", "three"] and not read.unknown
    (mark,) = read.marks
    assert (mark.kind, mark.first) == (kind, 1)
    assert (mark.name, mark.value, words[mark.first : mark.stop]) == found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<sub alias='doctor'>Dr.</sub> Who", ["doctor", "Who"]),
        ("<sub alias='doctor'><s>Dr.</s></sub> Who", ["doctor", "Who"]),
        ("<p>One</p><p>two &amp; three</p>", ["One", "two", "three"]),
        ("<say-as interpret-as='ordinal'>two</say-as>", ["two"]),
        ("<?xml version='1.0'?><speak>One</speak>", ["One"]),
    ],
)
def test_text_of_ssml(text, words):
    assert said(text if text.startswith("<?") else f"<speak>{text}</speak>") == words


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("<emphasis level='huge'>a</emphasis>", "emphasis level=huge"),
        ("<break time='soon'/>a", "break time=soon"),
        ("<break strength='x'/>a", "break strength=x"),
        ("<prosody volume='11'>a</prosody>", "prosody volume=11"),
        ("<prosody colour='red'>a</prosody>", "prosody colour"),
        ("<mstts:express-as style='zorb'>a</mstts:express-as>", "mstts:express-as zorb"),
        ("<dance>a</dance>", "<dance>"),
    ],
)
def test_unknown_ssml_is_listed(text, name):
    found = script(f"<speak>word {text}</speak>")
    assert found.unknown == (name,) and not found.marks


BOMB = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 9))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<speak>One", "cannot be parsed"),
        ("<speak>One</speek>", "cannot be parsed"),
        ("<speak>&nbsp;</speak>", "cannot be parsed"),
        (f'<!DOCTYPE x [<!ENTITY a0 "x">{BOMB}]><speak>&a8;</speak>', "DOCTYPE"),
        ('<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><speak>&a;</speak>', "DOCTYPE"),
        ('<!DOCTYPE speak SYSTEM "http://x/y.dtd"><speak>a</speak>', "DOCTYPE"),
        ("<speak>" + "<s>" * DEEPEST + "a" + "</s>" * DEEPEST + "</speak>", "within one another"),
        ("<speak></speak>", "no word"),
        ("[laughs]", "no word"),
    ],
)
def test_hostile_and_empty_scripts_are_one_line(text, words):
    with one_line(DataError, match=words):
        script(text)


DIALOGUE = """1
00:00:00,000 --> 00:00:02,000
ANNA: [angrily] One two.

2
00:00:02,500 --> 00:00:04,000
BOB: Three four.

3
00:00:03,500 --> 00:00:06,000
ANNA: Five.
"""
VOICES = """WEBVTT

00:00.000 --> 00:02.000
<v Anna>[angrily] One two.

00:02.500 --> 00:04.000
<v.loud Bob>Three four.</v>

00:03.500 --> 00:06.000
<v Anna>Five.
"""


@pytest.mark.parametrize("text", [DIALOGUE, VOICES])
@pytest.mark.parametrize(
    ("role", "words"),
    [(None, "One two Three four Five"), ("anna", "One two Five"), ("BOB", "Three four")],
)
def test_lines_of_a_role(text, role, words):
    assert said(text, role=role) == words.split()
    found = script(text, role=role).transcript.words
    assert all(word.start is not None for word in found)


def test_two_speakers_in_one_subtitle():
    text = "1\n00:00:00,000 --> 00:00:02,000\nANNA: One\ntwo\nBOB: Three\n"
    assert said(text, role="anna") == ["One", "two"] and said(text, role="bob") == ["Three"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"script": DIALOGUE, "role": "carl"}, "no speaker.*ANNA, BOB"),
        ({"words": DIALOGUE, "role": "carl"}, "no speaker.*ANNA, BOB"),
        ({"script": "ANNA: One", "role": "anna"}, "needs lines with times"),
        ({"words": "One.", "role": "anna"}, "needs lines with times"),
        ({"script": "<speak>One</speak>", "role": "anna"}, "needs lines with times"),
        ({"words": "<speak>One</speak>"}, "give it as script"),
        ({"role": "anna"}, "needs lines with times"),
        ({"script": "One.", "words": "One."}, "not both"),
        ({"script": "One.", "rules": False}, "rules"),
        ({"script": "a.docx"}, "one of .txt"),
        ({"script": "One.", "language": "xx"}, "xx"),
    ],
)
def test_wrong_scripts_are_one_line(given, words):
    with one_line(UserError, match=words):
        animate(np.zeros(16_000, np.float32), sample_rate=16_000, **given)


def mark(kind, value, start=1.0, end=2.0):
    return TimedMark(kind, "x", value, start, end)


def test_emotion_of_a_mark_comes_before_its_words_and_goes_after():
    neutral = np.zeros((90, len(LABELS)), np.float32)
    neutral[:, 0] = 1
    found = with_emotions(neutral, [mark("emotion", "angry=0.8")], TIMES)
    angry = found[:, LABELS.index("angry")]
    assert np.allclose(found.sum(axis=1), 1)
    assert angry[30:61] == pytest.approx(0.8) and angry[TIMES < 1 - RAMP_SECONDS].max() == 0
    assert np.abs(np.diff(angry)).max() < 0.2 and np.array_equal(found[:20], neutral[:20])


def test_voice_of_a_mark_is_a_factor_and_other_kinds_change_nothing():
    factor = levels([mark("voice", "0.5"), mark("accent", "1"), mark("pause", "1")], TIMES)
    assert factor[30:61] == pytest.approx(0.5) and factor[:20] == pytest.approx(1)


@pytest.mark.parametrize(
    ("value", "before", "after"),
    [
        ("1.0", [(40, 0.3)], [(40, 1.0)]),
        ("1.0", [], [(45, 1.0)]),
        ("1.0", [(28, 0.4), (80, 0.5)], [(28, 0.4), (45, 1.0), (80, 0.5)]),
        ("0.0", [(40, 0.9), (80, 0.5)], [(80, 0.5)]),
    ],
)
def test_accent_of_a_mark_is_the_accent_of_its_word(value, before, after):
    voice = Voice(90, np.zeros(90, np.float32), tuple(Accent(*a) for a in before), ())
    found = with_accents(voice, [mark("accent", value)])
    assert [tuple(accent) for accent in found.accents] == after


SENTENCE = "docs/samples/promise.flac"


TAGGED = (
    "Maybe you believe me. [angrily] But mother, BOB promised *everybody* a piece of that perfect "
    "apple pie! [zorbs]\n[happy] Well, what a [laughs] wonderful evening this could become."
)


@pytest.fixture(scope="module")
def take(default):
    return animate(SENTENCE, model=default, script=TAGGED)


def test_emotions_of_a_take_follow_its_script(default, take):
    plain = re.sub(r"\[.*?\]|\*", "", TAGGED)
    assert [word.text for word in take.words.words] == re.sub(r"[.,!]", "", plain).split()
    shown = take.curves.emotion.argmax(axis=1)
    assert take.emotion == "neutral and 3 of the script"
    times = {word.text: word for word in take.words.words}
    for word, label in (("believe", "neutral"), ("everybody", "angry"), ("evening", "happy")):
        middle = round((times[word].start + times[word].end) / 2 * 30)
        assert LABELS[shown[middle]] == label
    assert any("[zorbs]" in note for note in take.recording.warnings)
    brow = take.curves["CTRL_L_brow_down.ty"]
    plain_take = animate(SENTENCE, model=default)
    at = round(times["promised"].start * 30)
    assert brow[at : at + 60].mean() > plain_take.curves["CTRL_L_brow_down.ty"][at : at + 60].mean()


def test_marks_of_a_take_are_in_its_folder_and_its_settings_give_it_again(default, take, tmp_path):
    about = json.loads((take.save(tmp_path / "take") / "take.json").read_text())
    assert [(mark["kind"], mark["name"]) for mark in about["marks"]] == [
        ("emotion", "angrily"), ("accent", "BOB"), ("accent", "everybody"), ("emotion", "happy"),
        ("sound", "laughs"),
    ]  # fmt: skip
    assert all(0 <= mark["start"] <= mark["end"] <= 8.72 for mark in about["marks"])
    assert about["settings"] == {"script": TAGGED}
    again = animate(SENTENCE, model=default, acting=Acting.of(files={}, **about["settings"]))
    assert np.array_equal(again.curves.values, take.curves.values)


def test_script_without_tags_is_its_words(default, take):
    words = re.sub(r"\[.*?\]|\*", "", TAGGED).replace("BOB", "Bob")
    found, wanted = (animate(SENTENCE, model=default, **{n: words}) for n in ("script", "words"))
    assert np.array_equal(found.curves.values, wanted.curves.values)


def test_script_of_other_words_is_not_used_and_that_is_said(default):
    found = animate(SENTENCE, model=default, script="[angrily] Zebras quietly juggle six axes.")
    assert not found.marks and found.curves.emotion[:, 0].min() == 1
    notes = " ".join(found.recording.warnings)
    assert "do not fit" in notes and "tags are not used" in notes


def test_role_is_silent_where_others_speak(default):
    """Two people in one recording, each as a take of its own."""
    cues = (
        "1\n00:00:00,000 --> 00:00:01,400\nANNA: Maybe you believe me.\n\n"
        "2\n00:00:01,400 --> 00:00:09,000\nBOB: But mother, Bob promised everybody a piece of "
        "that perfect apple pie!\n"
    )
    takes = {r: animate(SENTENCE, model=default, words=cues, role=r) for r in ("anna", "bob")}
    jaw = {role: take.curves["CTRL_C_jaw.ty"] for role, take in takes.items()}
    assert jaw["anna"][:40].max() > 0.1 and np.abs(jaw["anna"][60:]).max() < 0.02
    assert jaw["bob"][60:].max() > 0.1 and np.abs(jaw["bob"][:25]).max() < 0.02
    assert all(len(take.curves) == 262 for take in takes.values())
    for take in takes.values():
        assert any("silent where others" in note for note in take.recording.warnings)


def test_whole_dialogue_without_a_role_is_as_before(default):
    with pytest.raises(DeitalkError):
        animate(SENTENCE, model=default, role="anna")
