"""Measured lips as captures of a rig of their own."""

import numpy as np
import pytest

from deitalk.config.rig_file import read_controls
from deitalk.data.captures.splits import divide_clips
from deitalk.data.clips import read_clips
from deitalk.errors import DataError
from deitalk.evaluation.smoothness import load_example
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from deitalk.research.lips.measured import read_lips
from deitalk.research.lips.own_rig import write_measure_dataset
from deitalk.research.tests.lips.test_lips import write_measured
from rig.face.head import build_head
from tests.command import ran


def test_curves_are_the_measures_and_a_speaker_can_be_left_out(tmp_path):
    wave = 0.05 * (1 - np.cos(np.arange(50) / 25 * 2 * np.pi))
    clips = {name: (name[0], wave * (1 + 0.1 * i)) for i, name in enumerate(("a1", "a2", "b1"))}
    folder, out = write_measured(tmp_path / "lips", clips), tmp_path / "data"
    path = folder / "video" / "a1.npz"
    table = np.load(path)["meas"]
    table[20:22, 3] = -32768
    np.savez(path, meas=table)
    ran("lips", folder, "--as-rig", "-o", out)
    controls = read_controls(str(out / "rig.yaml"))
    assert controls.names == MEASURES
    measured = {c.name: c for c in read_lips(folder, HeadLips(build_head()).eye_distance)}
    for clip in read_clips(out):
        curves, expected = load_example(clip, controls).curves, measured[clip.name].measures
        known = np.isfinite(expected).all(axis=1)
        assert np.abs(curves - expected)[known].max() < 2e-3 and np.isfinite(curves).all()
        assert clip.speaker == clip.take == clip.name[0]
    division = divide_clips(read_clips(out), "b")
    assert [c.name for c in division.train] == ["a1"] and [c.name for c in division.test] == ["b1"]


def test_recordings_with_many_gaps_are_left_out(tmp_path):
    folder = write_measured(tmp_path / "lips", {"a": ("one", np.linspace(0, 0.1, 50))})
    table = np.load(folder / "video" / "a.npz")["meas"]
    table[10:30, 1] = -32768
    np.savez(folder / "video" / "a.npz", meas=table)
    with pytest.raises(DataError, match="no recording has all measures in 90% of frames"):
        write_measure_dataset(folder, tmp_path / "data")
