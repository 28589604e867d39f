"""Blinks of takes: made lids of known times."""

import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.research.evaluation.blinks import (
    Take,
    draw_take,
    find_blinks,
    main,
    measure_blinks,
    recordings,
)


def lids(*starts, frames=300, depth=1.0):
    """Blinks of six frames, three of them more than half closed."""
    track = np.zeros(frames, np.float32)
    for start in starts:
        track[start : start + 6] = depth * np.array([0.3, 1, 1, 0.7, 0.3, 0.1])
    return track


def take(track, *ends, look=0.0):
    gaze = np.full((len(track), 2), look, np.float32)
    return Take(track, np.array(ends), gaze)


def test_blinks_are_found_with_their_length_and_incomplete_ones_without():
    assert find_blinks(lids(30, 120)) == [(1.0, pytest.approx(0.1)), (4.0, pytest.approx(0.1))]
    assert find_blinks(lids(30, depth=0.6)) == [(1.0, 0)]
    assert find_blinks(lids()) == []


def test_measures_of_known_blinks():
    """10 s: blinks at 1, 4 and 7 s; the phrase ends at 3.9 s, 0.6 of 10 s are near it."""
    whole = take(lids(30, 120, 210), 3.9)
    found = measure_blinks([whole, whole, take(lids(30), 5.0)])
    assert found["takes"] == "3" and found["different ones"] == "2"
    assert found["blinks a minute"] == "14.0"  # 7 in half a minute
    assert found["interval, s"].startswith("3.0 ")
    assert found["half closed, s"] == "0.10"
    assert found["at ends of phrases (chance)"] == "0.29 (0.06)"


def test_a_face_that_does_not_blink_has_no_intervals():
    found = measure_blinks([take(lids(), 3.0)])
    assert found["blinks a minute"] == "0.0" and found["interval, s"] == "–"


def test_takes_that_blink_alike_and_look_elsewhere_are_different():
    assert measure_blinks([take(lids()), take(lids(), look=1.0)])["different ones"] == "2"
    assert measure_blinks([take(lids()), take(lids())])["different ones"] == "1"


def test_takes_follow_sound_and_seed():
    rng = np.random.default_rng(0)
    sounds = [rng.standard_normal(16_000 * 8).astype("f4") * 0.05 for _ in range(2)]
    same, again, other = draw_take(sounds[0]), draw_take(sounds[0]), draw_take(sounds[1])
    assert np.array_equal(same.lids, again.lids) and not np.array_equal(same.lids, other.lids)
    assert not np.array_equal(same.lids, draw_take(sounds[0], 1).lids)


def test_command_prints_the_table_and_refuses_what_is_no_sound(tmp_path, capsys):
    assert main(["docs/samples/amiable.flac"]) == 0
    assert "| takes | 1 |" in capsys.readouterr().out
    (tmp_path / "no.wav").write_bytes(b"no sound")
    assert main([str(tmp_path / "no.wav")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_recordings_of_a_folder_are_evenly_spread(tmp_path):
    for k in range(5):
        (tmp_path / f"{k}.wav").touch()
    (tmp_path / "notes.txt").touch()
    assert [f.stem for f in recordings([tmp_path], 3)] == ["0", "2", "4"]
    assert recordings([tmp_path / "x.wav"], 3) == [tmp_path / "x.wav"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="holds no"):
        recordings([tmp_path / "empty"], 3)


def test_report_is_never_written_over_a_file(tmp_path, capsys):
    mine = tmp_path / "mine.json"
    mine.write_text("mine")
    for target, words in ((mine, "exists; name another file"), (tmp_path / "no/x", "not a folder")):
        with pytest.raises(SystemExit) as ended:
            main(["docs/samples/amiable.flac", "--json", str(target)])
        assert ended.value.code == 2 and words in capsys.readouterr().err
    assert mine.read_text() == "mine"
