"""Sound and curves of a take, laid together by their time codes."""

from itertools import cycle

import numpy as np
import pytest

from deitalk.audio.load import load_audio, write_wav
from deitalk.data.captures.imported import import_captures
from deitalk.data.captures.take import paired, read_capture
from tests.deitalk.data.captures.shape_tables import NAMES, frames, live_link, motion, text
from tests.takes import bursts


def broadcast(path, start, seconds, rate=16_000):
    """A recording with a time code: bursts of a tone, so that it holds speech."""
    write_wav(path, bursts(seconds), start=start)


PAIRS = {
    "curves 2 s later": (51020.0, 51022.0, 5, 3, 2.0, "2.00 s of sound"),
    "curves 1 s earlier": (51021.0, 51020.0, 4, 4, -1.0, "1.00 s of sound and 1.00 s of curves"),
    "sound within": (51021.5, 51020.0, 2, 6, -1.5, "4.00 s of curves"),
    "curves within": (51000.0, 51004.25, 20, 4, 4.25, "16.00 s of sound"),
    "over midnight": (86399.0, 1.0, 6, 3, 2.0, "3.00 s of sound"),
    "midnight before the sound": (0.5, 86399.5, 4, 4, -1.0, "1.00 s of sound and 1.00 s of curves"),
    "at once": (51020.0, 51020.0, 3, 3, 0.0, ""),
    "hours apart": (51020.0, 12.0, 3, 3, 0.0, "do not overlap"),
    "an hour apart": (51020.0, 54620.0, 3, 3, 0.0, "laid together at the start"),
    "a moment together": (51020.0, 51022.8, 3, 3, 0.0, "laid together at the start"),
    "no time codes in the sound": (0.0, 51022.0, 3, 3, 0.0, ""),
}


@pytest.mark.parametrize(("name", "fps"), zip(PAIRS, cycle((60, 24, 30000 / 1001))))
def test_time_codes_lay_sound_and_curves_together(tmp_path, name, fps):
    sound_start, start, sound_seconds, seconds, late, note = PAIRS[name]
    count = 60
    step = round(start * count) / count
    rows = live_link(*frames(fps, seconds), count, start=step)
    (tmp_path / "a.csv").write_text(text(rows))
    broadcast(tmp_path / "a.wav", sound_start, sound_seconds)
    capture, sound = paired(read_capture(tmp_path / "a.csv"), load_audio(tmp_path / "a.wav"))
    assert note in "; ".join(capture.notes)
    whole = load_audio(tmp_path / "a.wav").waveform
    first = whole.tobytes().index(sound.waveform[:800].tobytes()) // whole.itemsize
    jaw = NAMES.index("JawOpen")
    at = capture.curves.times + first / 16_000 - late
    assert np.abs(capture.curves["CTRL_C_jaw.ty"] - motion(at)[:, jaw]).max() < 0.02
    if note and "laid" not in note and "overlap" not in note:
        assert abs(capture.curves.duration - sound.duration) < 1.5 / fps
        assert f"sound {clock_of(sound_start)}, curves {clock_of(step)}" in capture.notes[-1]


def clock_of(seconds):
    h, m = int(seconds // 3600), int(seconds // 60 % 60)
    return f"{h:02d}:{m:02d}:{seconds % 60:05.2f}"


def test_import_says_how_a_take_was_paired(tmp_path):
    rows = live_link(*frames(60, 3), start=51022.0)
    (tmp_path / "t").mkdir()
    (tmp_path / "t" / "a.csv").write_text(text(rows))
    broadcast(tmp_path / "t" / "a.wav", 51020.0, 5)
    result = import_captures([tmp_path / "t"], tmp_path / "data", actor="a", split_by="none")
    (take,) = result.takes
    assert take.notes[0] == (
        "paired by time code (sound 14:10:20.00, curves 14:10:22.00): 2.00 s of sound outside "
        "both, cut"
    )
    assert take.seconds == pytest.approx(3, abs=0.02)
