"""Transcripts: texts, TextGrids and subtitles to words with phones."""

import pytest

from deitalk.errors import ConfigError, DataError, MissingError
from deitalk.pipeline.words import pronounced
from deitalk.pipeline.words.alphabets import spoken_words
from deitalk.pipeline.words.pronounced import Word
from deitalk.pipeline.words.textgrid import intervals_of
from deitalk.pipeline.words.transcript import Transcript

LONG = """File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 1.5
tiers? <exists>
size = 2
item []:
    item [1]:
        class = "IntervalTier"
        name = "words"
        xmin = 0
        xmax = 1.5
        intervals: size = 3
        intervals [1]:
            xmin = 0
            xmax = 0.25
            text = ""
        intervals [2]:
            xmin = 0.25
            xmax = 0.75
            text = "my"
        intervals [3]:
            xmin = 0.75
            xmax = 1.5
            text = "map"
    item [2]:
        class = "IntervalTier"
        name = "phones"
        xmin = 0
        xmax = 1.5
        intervals: size = 2
        intervals [1]:
            xmin = 0
            xmax = 0.5
            text = "M"
        intervals [2]:
            xmin = 0.5
            xmax = 1.5
            text = "say ""a""!"
"""
SHORT = """File type = "ooTextFile"
Object class = "TextGrid"

0
1.5
<exists>
2
"IntervalTier"
"words"
0
1.5
3
0
0.25
""
0.25
0.75
"my"
0.75
1.5
"map"
"IntervalTier"
"phones"
0
1.5
2
0
0.5
"M"
0.5
1.5
"say ""a""!"
"""


def phones_of(*args):
    return [word.phones for word in Transcript.of(*args).words]


def test_text_is_pronounced_word_by_word():
    words = Transcript.of("My promise -- is big!").words
    assert [w.text for w in words] == ["My", "promise", "is", "big"]
    assert [w.phones for w in words] == [
        ("M", "AY"), ("P", "R", "AA", "M", "IH", "S"), ("IH", "Z"), ("B", "IH", "G")
    ]  # fmt: skip


def test_other_languages_share_the_phones():
    assert phones_of("bitte", "de") == [("B", "IH", "T", "AX")]
    assert phones_of("爸爸跑步", "cmn") == [("P", "AA", "P", "AA"), ("P", "AW"), ("P", "UW")]
    assert spoken_words("(en)də1 phjɑu5", "cmn") == [("D", "AX"), ("P", "Y", "AW")]


def test_joined_small_words_keep_their_places():
    words = Transcript.of("In the map of the boy").words
    assert [w.text for w in words] == ["In", "the", "map", "of", "the", "boy"]


def test_both_forms_of_a_textgrid_are_equal(tmp_path):
    tiers = []
    for name, text in (("a.TextGrid", LONG), ("b.TextGrid", SHORT)):
        (tmp_path / name).write_text(text)
        tiers.append(intervals_of((tmp_path / name).read_text(), name))
    assert tiers[0] == tiers[1]
    assert tiers[0]["words"][1] == (0.25, 0.75, "my")
    assert tiers[0]["phones"][1] == (0.5, 1.5, 'say "a"!')


def test_words_of_a_textgrid_have_its_times(tmp_path):
    (tmp_path / "a.TextGrid").write_text(LONG)
    expected = (Word("my", ("M", "AY"), 0.25, 0.75), Word("map", ("M", "AE", "P"), 0.75, 1.5))
    for given in (tmp_path / "a.TextGrid", LONG):
        assert Transcript.of(given).words == expected


SRT = """1
00:00:01,000 --> 00:00:02,500
{\\an8}My <i>promise</i>
is big. [MUSIC]

2
00:00:02,000 --> 00:00:04,000
(laughs) Bob!
"""
VTT = """WEBVTT - a title

NOTE My promise
is a note

STYLE
::cue { color: red }

intro
00:01.000 --> 00:02.500 align:start
My <b>promise</b>
is big.

00:00:02.000 --> 00:00:04.000 position:10%
<v Anna>Bob!

NOTE of the end
"""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize(("name", "text"), [("a.srt", SRT), ("a.vtt", VTT), ("A.SRT", SRT)])
def test_words_of_subtitles_lie_near_their_times(tmp_path, name, text, newline, encoding):
    path = tmp_path / name
    path.write_bytes(text.replace("\n", newline).encode(encoding))
    for given in (path, str(path), text):
        found = Transcript.of(given).words
        assert [w.text for w in found] == ["My", "promise", "is", "big", "Bob"]
        assert [(w.start, w.end) for w in found] == [(0.5, 3.0)] * 4 + [(1.5, 4.5)]


@pytest.mark.parametrize("name", ["a.srt", "a.vtt"])
def test_subtitles_without_times_are_refused(tmp_path, name):
    (tmp_path / name).write_text("My promise is big.")
    with pytest.raises(DataError, match=r"no subtitle with times such as 00:00:01,000"):
        Transcript.of(tmp_path / name)


@pytest.mark.parametrize(
    "name",
    ["said.csv", "said.tsv", "said.docx", "my lines.pdf", "C:\\lines\\one.rtf", "one.ass", "a.mp4"],
)
def test_a_name_with_another_suffix_is_no_speech(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    for exists in (False, True):
        if exists:
            (tmp_path / name).write_text("start,end,word\n0,1,a\n")
        with pytest.raises(
            DataError, match=r"is one of \.txt, \.textgrid, \.srt, \.vtt; if this is"
        ):
            Transcript.of(name)


@pytest.mark.parametrize("name", ["said.txt", "my lines.srt", "./x/a.TextGrid", "a.vtt "])
def test_an_absent_file_is_no_speech(name):
    with pytest.raises(DataError, match=r"there is no such file|does not exist"):
        Transcript.of(name)


@pytest.mark.parametrize(
    "text",
    [
        "Meet Dr. Who",
        "It is 3.5",
        "At 5 p.m",
        "Go to example.com.",
        "Wait...",
        "one. Two",
        "Hm.\nA.txt",
    ],
)
def test_speech_with_stops_is_speech(text):
    assert Transcript.of(text).source == text


def test_words_need_espeak(monkeypatch):
    monkeypatch.setattr(
        pronounced, "missing", lambda: "espeak: absent; pip install espeakng-loader"
    )
    with pytest.raises(MissingError, match="pip install espeakng-loader"):
        Transcript.of("please")


def test_bad_textgrids_and_texts_are_refused(tmp_path):
    (tmp_path / "a.TextGrid").write_text(LONG.replace("size = 3", "size = 900"))
    with pytest.raises(DataError, match="900"):
        Transcript.of(tmp_path / "a.TextGrid")
    (tmp_path / "b.TextGrid").write_text(LONG.replace('"words"', '"Maria"'))
    with pytest.raises(DataError, match="no tier is named words; its tiers are 'Maria', 'phones'"):
        Transcript.of(tmp_path / "b.TextGrid")
    with pytest.raises(DataError, match="no word that is pronounced"):
        Transcript.of(" ... ")
    with pytest.raises(DataError, match=r"nothing\.txt"):
        Transcript.of("nothing.txt")
    with pytest.raises(ConfigError, match="'klingonese' is no voice"):
        Transcript.of("hello", "klingonese")
    with pytest.raises(DataError, match="no text; write them in UTF-8"):
        Transcript.of("caf\udce9")
