"""Transcripts: texts, tables and TextGrids to words with phones."""

import pytest

from deitalk.errors import ConfigError, DataError, MissingError
from deitalk.pipeline.words import transcript
from deitalk.pipeline.words.transcript import Transcript, Word, intervals_of, spoken_words
from tests.each import each

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


def test_timed_words_of_a_textgrid_and_of_a_table_are_equal(tmp_path):
    (tmp_path / "a.TextGrid").write_text(LONG)
    (tmp_path / "w.csv").write_text("start;end;word\n0,25;0,75;my\n\n0,75;1,5;map\n")
    expected = (Word("my", ("M", "AY"), 0.25, 0.75), Word("map", ("M", "AE", "P"), 0.75, 1.5))
    for name in ("a.TextGrid", "w.csv"):
        assert Transcript.of(tmp_path / name).words == expected
        assert Transcript.of(str(tmp_path / name)).source == name


def test_phones_need_no_espeak(monkeypatch, tmp_path):
    monkeypatch.setattr(
        transcript, "missing", lambda: "espeak: absent; pip install espeakng-loader"
    )
    assert Transcript.of("phones: P L IY1 Z | SIL B AY").words == (
        Word("P L IY1 Z", ("P", "L", "IY", "Z")), Word("SIL B AY", ("B", "AY"))
    )  # fmt: skip
    assert [w.phones for w in Transcript.of("phones: pliːz baɪ").words] == [
        ("P", "L", "IY", "Z"), ("B", "AY")
    ]  # fmt: skip
    (tmp_path / "p.csv").write_text("start,end,phone\n0,.1,SIL\n.1,.2,p\n.2,.4,IY0\n")
    assert Transcript.of(f"phones:{tmp_path}/p.csv").words == (
        Word("p", ("P",), 0.1, 0.2), Word("IY0", ("IY",), 0.2, 0.4)
    )  # fmt: skip
    with pytest.raises(MissingError, match=r"pip install espeakng-loader, or give phones"):
        Transcript.of("please")


@each(
    ("text", "message"),
    [
        ("start,end,label of\n0,1,a\n", "must name the columns start, end, word"),
        ("start,end,word\n0,1,a\n.5,.6,b\n", "word 2 'b': 0.5 to 0.6 s; times must rise"),
        ("start,end,word\n0,1\n", "row 2: no start and end"),
        ("start,end,word\n0,inf,a\n", "row 2: start and end must be finite"),
        ("start,end,word\n0,1,\n", "no word that is pronounced"),
    ],
)
def test_bad_tables_name_the_row(tmp_path, text, message):
    (tmp_path / "w.csv").write_text(text)
    with pytest.raises(DataError, match=message):
        Transcript.of(tmp_path / "w.csv")


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
    with pytest.raises(DataError, match="neither ARPABET nor IPA"):
        Transcript.of("phones: !!! ???")
