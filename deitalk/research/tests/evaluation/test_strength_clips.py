"""Tables of readers and actors with known strength."""

import numpy as np
import pytest
import soundfile as sf

from deitalk.errors import DataError
from deitalk.research.evaluation.strength import measure_clips
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    READERS,
    StrengthClip,
    read_strength_clips,
)
from tests.deitalk.audio.test_prosody import voice
from tests.errors import one_line


@pytest.fixture
def tables(tmp_path):
    for name in ("10-7-0.wav", "10-7-1.wav", "a_lo.wav", "silence.wav"):
        sound = voice(seconds=1.0) if name != "silence.wav" else np.zeros(16_000)
        sf.write(tmp_path / name, sound * (0.1 if "lo" in name else 1), 16_000)
    readers = tmp_path / "readers.tsv"
    readers.write_text("path\tspeaker\ttext\n10-7-0.wav\t10\tA\n10-7-1.wav\t10\tB\n")
    actors = tmp_path / "actors.csv"
    actors.write_text("clip,actor,emotion,level\na_lo.wav,x,ANG,LO\nsilence.wav,x,NEU,XX\n")
    return readers, actors


def test_readers_are_grouped_by_chapter_and_actors_by_name(tables):
    readers = read_strength_clips(tables[0], READERS)
    assert [(c.speaker, c.group, c.level) for c in readers] == [("10", "10-7", "")] * 2
    (angry, neutral) = read_strength_clips(tables[1], ACTORS)
    assert (angry.group, angry.emotion, angry.level) == ("x", "ANG", "LO")
    assert neutral.emotion == "NEU"


def test_tables_of_other_words_are_read_as_the_same(tables, tmp_path):
    """RAVDESS's levels and emotions, and a column of another name."""
    other = tmp_path / "ravdess.csv"
    other.write_text(
        "path,actor,emotion,level\na_lo.wav,01,neutral,normal\na_lo.wav,01,surprised,normal\n"
        "a_lo.wav,01,angry,strong\n"
    )
    found = [(c.path.name, c.emotion, c.level) for c in read_strength_clips(other, ACTORS)]
    assert found == [("a_lo.wav", e, v) for e, v in (("NEU", "LO"), ("SUR", "LO"), ("ANG", "HI"))]


def test_level_is_that_of_the_recording_and_silence_is_left_out(tables):
    clips = read_strength_clips(tables[0], READERS)[:1] + read_strength_clips(tables[1], ACTORS)
    loud, soft = measure_clips(clips)
    assert loud.level_db - soft.level_db == pytest.approx(20, abs=0.1)


def test_speakers_are_in_one_split_and_all_splits_occur(tmp_path):
    splits = {
        name: StrengthClip(ACTORS, tmp_path, str(name), str(name)).split for name in range(300)
    }
    share = [list(splits.values()).count(s) / 300 for s in ("test", "validation", "train")]
    np.testing.assert_allclose(share, [0.28, 0.18, 0.54], atol=0.08)
    assert splits[7] == StrengthClip(ACTORS, tmp_path / "b", "7", "7", "ANG", "HI").split


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("path,speaker\n", "needs rows with the columns"),
        ("clip,actor\nx,y\n", "needs rows with the columns path, speaker"),
        ("path,speaker\nnone.wav,1\n", "no sound"),
        ("", "is empty"),
        ('path,speaker\n"x', "no table"),
    ],
)
def test_read_strength_clips_rejects_bad_tables(tmp_path, text, words):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with one_line(DataError, words):
        read_strength_clips(path, READERS)
