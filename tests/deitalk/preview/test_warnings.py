"""Warnings of a preview: bilabials that stay open, curves early or late."""

import dataclasses

import numpy as np
import pytest
import soundfile

from deitalk.errors import DataError
from deitalk.preview.source import PreviewError, PreviewSource, load_source
from deitalk.preview.speech_warnings import (
    bilabial_warnings,
    find_warnings,
    lip_gaps,
    offset_warnings,
)
from deitalk.research.poses import MOUTH_POSES, pose_values
from rig import RigCurves, default_controls, write_curves
from rig.face import build_head

CONTROLS = default_controls()
JAW = CONTROLS.index("CTRL_C_jaw.ty")
SECONDS = 6


def bursts(times: np.ndarray) -> np.ndarray:
    """Syllables of uneven length and strength, 0 to 1."""
    wave = np.sin(2 * np.pi * 2.1 * times) + 0.8 * np.sin(2 * np.pi * 1.3 * times + 1)
    return np.clip(wave / 1.8, 0, 1)


def speaking(late_frames: float, fps: float = 30.0, rate: int = 16000) -> PreviewSource:
    """A jaw that follows the loudness with a delay of `late_frames`."""
    times = np.arange(SECONDS * rate) / rate
    noise = np.random.default_rng(5).standard_normal(len(times))
    sound = (0.3 * bursts(times) * noise).clip(-1, 1).astype(np.float32)
    frames = np.arange(int(SECONDS * fps))
    values = np.tile(CONTROLS.rest, (len(frames), 1))
    values[:, JAW] = 0.6 * bursts((frames - late_frames) / fps)
    return PreviewSource("talk", RigCurves(values, CONTROLS.names, fps), sound, rate)


@pytest.mark.parametrize(
    ("late", "word", "fps", "rate"),
    [(6, "late", 30, 16000), (-6, "early", 30, 16000), (12, "late", 60, 44100)],
)
def test_shifted_curves_are_reported_with_their_shift(late, word, fps, rate):
    (found,) = offset_warnings(speaking(late, fps, rate))
    milliseconds = float(found.text.split()[2])
    assert word in found.text
    assert milliseconds == pytest.approx(200, abs=34)  # within two steps of 1/60 s


@pytest.mark.parametrize("late", [0, 1, -1])
def test_curves_in_time_are_not_reported(late):
    assert find_warnings(speaking(late)) == []


def test_a_recording_of_another_length_is_reported():
    source = speaking(0)
    cut = dataclasses.replace(source, samples=source.samples[: 16000 * 5])
    assert "curves last 6.00 s, the recording 5.00 s" in [text for _, text in find_warnings(cut)]


def mouth(open_frames: slice) -> PreviewSource:
    """Lips pressed for /m/, except during an open vowel."""
    values = np.tile(pose_values(MOUTH_POSES["M B P"]), (60, 1))
    values[open_frames] = pose_values(MOUTH_POSES["AA (father)"])
    curves = RigCurves(values.astype(np.float32), CONTROLS.names, 30.0)
    return PreviewSource("m", curves, np.zeros(0, np.float32), 0)


def test_lip_gaps_are_zero_when_sealed_and_wide_when_open():
    gaps = lip_gaps(build_head(0), mouth(slice(30, 60)).curves.values)
    assert gaps[:30].max() < 0.02  # the seal's 0.2 mm
    assert gaps[30:].min() > 0.5


def test_open_bilabial_is_reported_and_a_closed_one_is_not():
    phones = ((0.2, 0.3, "M"), (1.5, 1.6, "b"), (1.6, 1.8, "AA1"))
    source = dataclasses.replace(mouth(slice(30, 60)), phones=phones)
    (found,) = bilabial_warnings(source)
    assert found.time == 1.5 and found.text.startswith("b does not close")


@pytest.fixture
def take(tmp_path):
    source = mouth(slice(30, 60))
    write_curves(tmp_path / "curves.json", source.curves)
    soundfile.write(tmp_path / "audio.wav", np.zeros(32000, np.float32), 16000)
    return tmp_path


def test_phones_of_a_take_are_read(take):
    """Unless others are given."""
    (take / "phones.csv").write_text("start,end,phone\n0.2,0.3,M\n")
    assert load_source(take).phones == ((0.2, 0.3, "M"),)
    (take / "mine.csv").write_text("start,end,phone\n1.5,1.6,P\n")
    assert load_source(take, phones=take / "mine.csv").phones == ((1.5, 1.6, "P"),)


def test_missing_or_broken_phones_are_refused_in_one_line(take):
    with pytest.raises(PreviewError, match="do not exist"):
        load_source(take, phones=take / "none.csv")
    (take / "bad.csv").write_text("start,end,phone\n0.4,0.3,M\n")
    with pytest.raises(DataError, match="ends before it starts"):
        load_source(take, phones=take / "bad.csv")
