"""Manifests: tables of any spreadsheet to lines, one error a row."""

import pytest

from deitalk.batch.lines import BadLine, Line, Settings, parse_formats
from deitalk.batch.manifest import read_manifest
from deitalk.batch.source import distinct, read_source
from deitalk.errors import DataError, DeitalkError


def rows(text, defaults=Settings(), base="base"):
    return read_manifest(text, "lines.csv", base, defaults)[0]


def only(text, **options):
    (line,) = rows(text, **options)
    return line


def test_row_keeps_the_defaults_of_empty_cells():
    line = only("audio,emotion,intensity\nanna/1.wav,,\n", defaults=Settings("happy", 1.5))
    assert line == Line(1, "base/anna/1.wav", "anna/1", Settings("happy", 1.5))


def test_row_sets_every_column():
    line = only(
        "Audio;Output;Formats;Emotion;Intensity;Intensity_curve;Actor;Voice;FPS;Seed\n"
        "a.wav;x/y;npz take;angry=0.5;1,5;i.csv;Änne;v.json;29.97;7\n"
    )
    assert line.output == "x/y" and line.targets == ("x/y.npz", "x/y")
    assert line.settings == Settings(
        "angry=0.5", 1.5, "base/i.csv", "base/v.json", "Änne", (".npz", "take"), 29.97, seed=7
    )


def test_digits_and_time_code_of_a_row_are_checked():
    settings = only("audio,formats,digits,timecode\na.wav,csv npz,3,recording\n").settings
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
    "text", ["audio\ta\nx.wav\t1\n", "sep=;\naudio;a\nx.wav;1\n", '"audio",a\n"x.wav",1\n\n,\n']
)
def test_any_spreadsheet_is_read_and_unused_columns_are_named(text):
    lines, unused = read_manifest(text, "lines.csv", "", Settings())
    assert [line.audio for line in lines] == ["x.wav"] and unused == ("a",)


def test_track_and_url_are_found_from_the_manifest():
    line = only("audio,emotion\ns3://sounds/a.wav,moods.csv\n")
    assert (line.audio, line.output) == ("s3://sounds/a.wav", "a")
    assert line.settings.emotion == "base/moods.csv"


def test_words_are_a_text_or_a_file_beside_the_manifest():
    text = "audio,transcript,language\na.wav,Bitte sehr,de\nb.wav,said/b.TextGrid,\n"
    first, second = (line.settings for line in rows(text))
    assert (first.transcript, first.language) == ("Bitte sehr", "de")
    assert (second.transcript, second.language) == ("base/said/b.TextGrid", "")
    assert only("audio,phones\na.wav,b.csv\n").settings.phones == "base/b.csv"


@pytest.mark.parametrize(
    ("audio", "output"),
    [("/abs/one.wav", "one"), ("../up/two.wav", "two"), ("sub/three.v2.wav", "sub/three.v2")],
)
def test_output_is_the_name_of_the_recording(audio, output):
    assert only(f"audio\n{audio}\n").output == output


def test_suffix_of_an_output_is_its_format():
    assert only("audio,output\na.wav,b.livelink.csv\n").targets == ("b.livelink.csv",)
    assert only("audio,output,formats\na.wav,b.csv,csv json\n").targets == ("b.csv", "b.json")
    assert only("audio,output,formats\na.wav,b.csv,npz\n").targets == ("b.csv.npz",)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (",x,1,happy", "no recording"),
        ("a.wav,../x,1,happy", "below the output folder"),
        ("a.wav,/x,1,happy", "below the output folder"),
        ("a.wav,.x/y,1,happy", "hidden"),
        ("a.wav,x,9,happy", "0 to 4"),
        ("a.wav,x,much,happy", "finite number"),
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


def test_formats_are_names_or_suffixes():
    assert parse_formats("csv, .NPZ;livelink|take usda csv") == (
        ".csv", ".npz", ".livelink.csv", "take", ".usda",
    )  # fmt: skip
    with pytest.raises(DeitalkError, match="'mp3' is unknown"):
        parse_formats("csv mp3")


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


def test_output_within_a_take_is_refused():
    first, second, third = errors(
        "audio,output,formats\na.wav,x/y,csv\nb.wav,x,take\nc.wav,xy/z,csv\n"
    )
    assert "lies in the take of line 2" in first and not second and not third


def test_tables_of_the_batch_are_no_outputs():
    assert all(errors("audio,output\na.wav,batch-summary.csv\nb.wav,batch-actors/anna.json\n"))


def test_folder_is_walked_without_hidden_files_and_outputs(tmp_path):
    for name in ("b/2.wav", "b/2.txt", "a.MP3", ".b/3.wav", "b/.4.wav", "out/take/audio.wav"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).touch()
    plan = read_source(tmp_path, tmp_path / "out", Settings())
    assert [line.output for line in plan.lines] == ["a", "b/2"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="holds no recording"):
        read_source(tmp_path / "empty", tmp_path / "out", Settings())


def test_hundred_thousand_rows_are_read_in_seconds():
    text = "audio,emotion,intensity\n" + "".join(
        f"{i % 100}/{i}.wav,happy,1\n" for i in range(100_000)
    )
    lines = distinct(rows(text))
    assert len(lines) == 100_000 and lines[-1] == Line(
        100_000, "base/99/99999.wav", "99/99999", Settings("happy")
    )
