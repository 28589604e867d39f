"""Labels of takes: order of the sources, spellings, and one line for each fault."""

from pathlib import Path

import pytest

from deitalk.data.captures.labels import Labelling
from deitalk.data.captures.sources import Source
from deitalk.errors import DataError
from tests.errors import one_line


def source(place: str) -> Source:
    return Source(Path(place + ".csv"), place)


@pytest.mark.parametrize(
    ("place", "emotion"),
    [("takes/happy/a_1", "happy"), ("takes/anna_ANGER_03", "angry"), ("sad/joy-2", "happy")],
)
def test_names_of_folders_and_files_give_the_emotion(place, emotion):
    labels = Labelling().of(source(place))
    assert labels.emotion == emotion and not labels.named


def test_a_name_of_two_emotions_says_so():
    labels = Labelling().of(source("angry/anna_happy_sadness_1"))
    assert labels.emotion == "sad" and labels.named == ("sad", "happy")
    assert not Labelling(emotion="happy").of(source("anna_happy_sad")).named


def test_a_take_without_any_label_is_of_one_neutral_actor_and_says_so():
    labels = Labelling().of(source("takes/a_1"))
    assert (labels.actor, labels.emotion) == ("actor", "neutral")
    assert not labels.is_emotion_given and not labels.is_actor_given


def test_pattern_names_actor_emotion_and_style():
    pattern = r"(?P<actor>\w+)/(?P<style>\w+)_(?P<emotion>[a-z]+)_\d"
    labels = Labelling(pattern=pattern).of(source("anna/whisper_joy_2"))
    assert (labels.actor, labels.style, labels.emotion) == ("anna", "whisper", "happy")


def test_table_comes_before_option_before_pattern(tmp_path):
    table = tmp_path / "t.csv"
    table.write_text("take,emotion,split,voice\na_1,sad,test,angry\nb_1,,,\n")
    labelling = Labelling(emotion="happy", pattern="(?P<actor>[ab])_", table=table)
    first, second = (labelling.of(source(f"x/{n}_1")) for n in "ab")
    assert (first.emotion, first.split, first.voice, first.actor) == ("sad", "test", "angry", "a")
    assert (second.emotion, second.split, second.actor) == ("happy", "", "b")


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"emotion": "bored"}, "'bored' is unknown; known are neutral"),
        ({"pattern": "("}, "no regular expression"),
        ({"pattern": "x"}, "needs a group"),
        ({"pattern": "(?P<who>x)"}, "no other named one"),
        ({"pattern": "(?P<actor>z)"}, "is not found in 'x/a_1'"),
        ({"pattern": "(?P<emotion>a)"}, "emotion 'a' is unknown"),
    ],
)
def test_fault_is_one_line(given, expected):
    with one_line(DataError, match=expected.replace("(", "\\(")):
        Labelling(**given).of(source("x/a_1"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name\na\n", "lacks the column take"),
        ("take\nA_1\na_1\n", "appears twice"),
        ("take,actor,Actor\na_1,x,y\n", "column 'actor' is there twice"),
        ("take\nb\n", "has no row of take 'a_1'"),
        ("take,split\na_1,dev\n", "split 'dev' must be train"),
    ],
)
def test_fault_of_the_table_is_one_line(tmp_path, text, expected):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(DataError, match=expected):
        Labelling(table=tmp_path / "t.csv").of(source("x/a_1"))
