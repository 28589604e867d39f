"""Dataset folders: correct tables are read, faults are errors of one line."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deitalk.data.clips import read_clips, read_intensity, read_known, read_phones
from deitalk.errors import DataError
from rig import default_controls
from tests.dataset import spoil, write_dataset
from tests.errors import one_line


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"))


def copied(written: Path, place: Path) -> Path:
    """A copy whose clips.csv may be changed; the files are linked."""
    for part in ("audio", "curves", "phones", "intensity"):
        (place / part).symlink_to(written / part)
    (place / "clips.csv").write_bytes((written / "clips.csv").read_bytes())
    return place


@pytest.fixture
def folder(written, tmp_path) -> Path:
    return copied(written, tmp_path)


def refused(folder: Path, match: str) -> None:
    with one_line(DataError, match=match):
        read_clips(folder)


def test_every_row_is_a_clip_with_its_files(folder):
    clips = read_clips(folder)
    assert [clip.name for clip in clips] == [f"clip{i}" for i in range(6)]
    assert all(clip.audio.is_file() and clip.curves.is_file() for clip in clips)
    assert [clip.split for clip in read_clips(folder, "validation")] == ["validation"] * 2
    assert len(read_clips(folder, "train")) == 4 and read_clips(folder, "test") == []


def test_optional_columns_have_defaults(folder):
    frame = pd.read_csv(folder / "clips.csv", dtype=str)
    frame.drop(columns=["voice", "source", "phones", "intensity"]).to_csv(
        folder / "clips.csv", index=False
    )
    clip = read_clips(folder)[1]
    assert clip.voice == clip.emotion == "angry" and clip.source == "recording"
    assert clip.offset_seconds == 0 and clip.phones is None and clip.intensity is None


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff\xfe\x00\x01\x80", b'clip,audio\n"unclosed,1\n', b"a,b\n1,2,3\n4,5,6,7\n"],
)
def test_file_that_is_no_table_is_refused(written, tmp_path, content):
    folder = copied(written, tmp_path)
    (folder / "clips.csv").write_bytes(content)
    refused(
        folder, r"clips\.csv(, row 1)?:? (cannot be read as CSV|lacks the column|is no UTF-16 text)"
    )


def test_missing_column_is_named(folder):
    frame = pd.read_csv(folder / "clips.csv").drop(columns="speaker")
    frame.to_csv(folder / "clips.csv", index=False)
    refused(folder, r"lacks the column speaker; it needs clip, audio")


@pytest.mark.parametrize(
    ("column", "value", "match"),
    [
        ("clip", "clip1", "'clip1' appears twice"),
        ("clip", "", "has no name"),
        ("emotion", "furious", "emotion 'furious' is unknown; known are neutral, angry"),
        ("voice", "loud", "voice 'loud' is unknown; known are neutral"),
        ("split", "dev", "split 'dev' is unknown; known are train, validation, test"),
        ("audio", "../elsewhere.wav", "leaves the folder"),
        ("curves", "/etc/passwd", "leaves the folder"),
        ("audio", "audio/none.flac", "does not exist"),
        ("audio", "", "does not exist"),
        ("phones", "phones/none.csv", "does not exist"),
        ("offset_s", "soon", "offset_s 'soon' of clip 'clip0' must be a number"),
        ("offset_s", "nan", "offset_s 'nan'"),
        ("offset_s", "1e9", "within ±3600"),
    ],
)
def test_bad_value_is_named_with_the_rule(written, tmp_path, column, value, match):
    folder = copied(written, tmp_path)
    spoil(folder, column, value)
    refused(folder, match)


def test_intensity_is_linear_between_its_rows_and_held_beyond(folder):
    clip = read_clips(folder)[0]
    values = read_intensity(clip.intensity, np.array([-1, 0, 0.5, 1, 2, 3, 9.0]))
    np.testing.assert_allclose(values, [0, 0, 0.4, 0.8, 0.4, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "time,intensity\n",
        "time,loud\n0,1\n",
        "time,intensity\n1,0\n0,1\n",
        "time,intensity\n0,2\n",
        "time,intensity\n0,-0.1\n",
        "time,intensity\n0,high\n",
        "time,intensity\n0,\n",
        "",
    ],
)
def test_read_intensity_rejects_damaged_files(tmp_path, text):
    path = tmp_path / "i.csv"
    path.write_text(text)
    with one_line(DataError, match=r"i\.csv: "):
        read_intensity(path, np.zeros(1))


@pytest.mark.parametrize(
    "text", ["start,end\n0,1\n", "start,end,phone\n0,x,AA\n", "start,end,phone\n1,0,AA\n", ""]
)
def test_read_phones_rejects_damaged_files(tmp_path, text):
    path = tmp_path / "p.csv"
    path.write_text(text)
    with one_line(DataError, match=r"p\.csv: "):
        read_phones(path)


def test_known_controls_are_those_that_a_file_names(folder):
    controls = default_controls()
    assert read_clips(folder)[0].known is None and read_known(None, controls).all()
    (folder / "livelink.txt").write_text(
        "# a face camera\nCTRL_C_jaw.ty\n\nCTRL_L_brow_down.Y  # as Unreal spells it\n"
    )
    spoil(folder, "known", "livelink.txt")
    known = read_known(read_clips(folder)[0].known, controls)
    assert set(np.array(controls.names)[known]) == {"CTRL_C_jaw.ty", "CTRL_L_brow_down.ty"}
    assert read_clips(folder)[1].known is None


@pytest.mark.parametrize(
    ("text", "match"),
    [("jawOpen\n", "unknown control 'jawOpen'"), ("# none\n\n", "names no control")],
)
def test_known_controls_rejects(folder, text, match):
    path = folder / "known.txt"
    path.write_text(text)
    with one_line(DataError, "known.txt", match=match):
        read_known(path, default_controls())
