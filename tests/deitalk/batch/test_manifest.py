"""Manifests: tables of any spreadsheet to lines, one error a row."""

import json
from collections import Counter

import pytest

from deitalk.acting import Acting
from deitalk.batch.lines import BadLine, Line, Written
from deitalk.batch.manifest import read_manifest
from deitalk.batch.source import distinct, read_source
from deitalk.emotions import ActorReference
from deitalk.errors import DataError
from deitalk.postprocess.edges import Edge
from deitalk.postprocess.life.other import OtherVoice

NOTHING = Line(0, "", "")
EDGE = str(Edge({"CTRL_C_jaw.ty": 0.5})).replace('"', '""')


def rows(text, defaults=NOTHING, base="base"):
    return read_manifest(text, "lines.csv", base, defaults)[0]


def only(text, **options):
    (line,) = rows(text, **options)
    return line


def test_row_keeps_the_defaults_of_empty_cells():
    acting = Acting.of(emotion="happy", intensity=1.5)
    line = only("audio,emotion,intensity\nanna/1.wav,,\n", defaults=Line(0, "", "", acting))
    assert line == Line(1, "base/anna/1.wav", "anna/1", acting)


def test_row_sets_every_column(tmp_path):
    (tmp_path / "i.csv").write_text("time,intensity\n0,1\n")
    (tmp_path / "v.json").write_text(ActorReference(1.0, 2, 3.0).as_json())
    line = only(
        "Audio;Output;Formats;Emotion;Intensity;Intensity_curve;Actor;Voice;FPS;Seed\n"
        "a.wav;x/y;npz take;angry=0.5;1,5;i.csv;Änne;v.json;29.97;7\n",
        base=str(tmp_path),
    )
    assert line.output == "x/y" and line.targets == ("x/y.npz", "x/y") and line.actor == "Änne"
    assert line.written == Written((".npz", "take"), 29.97)
    assert line.acting == Acting.of(
        emotion="angry=0.5", intensity=1.5, intensity_curve=tmp_path / "i.csv",
        voice=ActorReference(1.0, 2, 3.0), seed=7,
    )  # fmt: skip


@pytest.mark.parametrize("name", Acting.model_fields)
def test_every_field_of_an_acting_is_a_column(name):
    cell = {
        "emotion": "sad", "intensity_curve": "[{'time': 0, 'intensity': 1}]".replace("'", '""'),
        "voice": ActorReference(1.0, 2, 3.0).as_json().strip().replace('"', '""'), "words": "a",
        "language": "de", "life": "off", "look_at": "1,2", "gain": "jaw=2", "rules": "no",
        "style": "eve", "script": "[sad] a", "role": "anna", "after": EDGE, "into": EDGE,
        "edit": '{""schema"": ""deitalk.edit/1"", ""edits"": []}', "rest": ".25",
        "variant": "hot", "listen_to": json.dumps(OtherVoice(2.0).content).replace('"', '""'),
    }.get(name, "2")  # fmt: skip
    line = only(f'audio,{name}\na.wav,"{cell}"\n')
    assert isinstance(line, Line), line
    assert list(line.acting.settings) == [name]


def test_digits_and_time_code_of_a_row_are_checked():
    settings = only("audio,formats,digits,timecode\na.wav,csv npz,3,recording\n").written
    assert (settings.digits, settings.timecode) == (3, "recording")
    for cells, words in (
        ("csv,7,", "must be 2 to 6"),
        ("csv,x,", "must be 2 to 6"),
        ("npz,3,", "does not apply to npz"),
        ("csv,,10:00", "is not HH:MM:SS:FF"),
    ):
        bad = only(f"audio,formats,digits,timecode\na.wav,{cells}\n")
        assert isinstance(bad, BadLine) and words in bad.error


@pytest.mark.parametrize(
    "text",
    [
        "audio\ta\nx.wav\t1\n",
        "sep=;\naudio;a\nx.wav;1\n",
        '"audio",a\n"x.wav",1\n\n,\n',
        "\r\n;\r\nAudio;a\r\nx.wav;1\r\n",
        "sep=;\raudio;a\rx.wav;1\r",
    ],
)
def test_any_spreadsheet_is_read_and_unused_columns_are_named(text):
    lines, notes = read_manifest(text, "lines.csv", "", NOTHING)
    assert [line.audio for line in lines] == ["x.wav"]
    assert notes == ("columns of the manifest that are not used: a",)


def test_files_are_found_from_the_manifest(tmp_path):
    (tmp_path / "moods.csv").write_text("time,emotion,strength\n0,sad,1\n")
    (tmp_path / "said").mkdir()
    (tmp_path / "said" / "b.txt").write_text("Bitte sehr")
    text = (
        "audio,emotion,words,language\ns3://sounds/a.wav,moods.csv,Bitte,de\nb.wav,,said/b.txt,\n"
    )
    first, second = rows(text, base=str(tmp_path))
    assert (first.audio, first.output) == ("s3://sounds/a.wav", "a")
    assert first.acting == Acting.of(emotion="sad", words="Bitte", language="de")
    assert second.acting == Acting.of(words="Bitte sehr")
    (missing,) = rows("audio,emotion\na.wav,none.csv\n", base=str(tmp_path))
    assert isinstance(missing, BadLine) and "none.csv" in missing.error


@pytest.mark.parametrize(
    ("audio", "output"),
    [("/abs/one.wav", "one"), ("../up/two.wav", "two"), ("sub/three.v2.wav", "sub/three.v2")],
)
def test_output_is_the_name_of_the_recording(audio, output):
    assert only(f"audio\n{audio}\n").output == output


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (",x,1,happy", "no recording"),
        ("a.wav,../x,1,happy", "below the output folder"),
        ("a.wav,/x,1,happy", "below the output folder"),
        ("a.wav,.x/y,1,happy", "hidden"),
        ("a.wav,x,9,happy", "0 to 4"),
        ("a.wav,x,much,happy", "must be a number"),
        ("a.wav,x,1,hapy", "'hapy'"),
        ("a.wav,x,1,happy=2", "happy"),
    ],
)
def test_bad_row_is_one_line_and_the_others_stay(row, words):
    bad, good = rows(f"audio,output,intensity,emotion\n{row}\nb.wav,,,\n")
    assert isinstance(bad, BadLine) and bad.number == 1
    assert words in bad.error and "\n" not in bad.error
    assert isinstance(good, Line) and good.number == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no column 'audio'"),
        ("sound,emotion\na.wav,happy\n", "no column 'audio'"),
        ("audio,audio\na.wav,b.wav\n", "twice"),
        ("audio\n\n", "no rows"),
    ],
)
def test_table_without_lines_is_refused(text, words):
    with pytest.raises(DataError, match=words):
        rows(text)


def errors(text):
    return [line.error if isinstance(line, BadLine) else "" for line in distinct(rows(text))]


def test_lines_of_one_output_are_refused_but_for_the_first():
    text = "audio,output,formats\na.wav,x,csv\nb.wav,X,csv\nc.wav,x,npz\nd.wav,y,csv\n"
    assert errors(text) == [
        "",
        "output X.csv is that of line 1 (base/a.wav) too; name another",
        "",
        "",
    ]


def test_folder_is_walked_without_hidden_files_and_outputs(tmp_path):
    for name in ("b/2.wav", "b/2.txt", "a.MP3", ".b/3.wav", "b/.4.wav", "out/take/audio.wav"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).touch()
    plan = read_source(tmp_path, tmp_path / "out", NOTHING)
    assert [line.output for line in plan.lines] == ["a", "b/2"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="holds no recording"):
        read_source(tmp_path / "empty", tmp_path / "out", NOTHING)
    with pytest.raises(DataError, match=r"line\.WAV: a recording; name its folder"):
        read_source(tmp_path / "line.WAV", tmp_path / "out", NOTHING)


@pytest.mark.parametrize(
    ("names", "outputs"),
    [
        (["a.wav", "b.wav"], ["a", "b"]),
        (["line.mp3", "line.ogg", "b.wav"], ["b", "line_mp3", "line_ogg"]),
        (["x/line.mp3", "y/line.ogg"], ["x/line", "y/line"]),
        (["Line.mp3", "line.ogg"], ["Line_mp3", "line_ogg"]),
        (["a.b.wav", "a.b.flac", "a.wav"], ["a", "a.b_flac", "a.b_wav"]),
        (["line.wav", "line.flac", "line_wav.mp3"], ["line_flac", "line_wav"]),
    ],
)
def test_recordings_of_one_name_in_a_folder_have_results_of_their_own(tmp_path, names, outputs):
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    plan = read_source(tmp_path, tmp_path / "out", NOTHING)
    lines = [line for line in plan.lines if isinstance(line, Line)]
    assert sorted(line.output for line in lines) == outputs
    bad = [line.error for line in plan.lines if isinstance(line, BadLine)]
    assert len(lines) + len(bad) == len(names) and all("too; name another" in e for e in bad)
    assert not [n for n, k in Counter(t for line in lines for t in line.targets).items() if k > 1]
    assert bool(plan.notes) == any("_" in output for output in outputs)
