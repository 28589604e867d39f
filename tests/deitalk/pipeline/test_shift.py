"""Delay of the face, and handles, of what is written."""

import json

import numpy as np
import pytest
import soundfile

from deitalk import animate
from deitalk.postprocess.edges import edge_of
from deitalk.research.evaluation.benchmark_curves import speechlike
from rig import read_curves
from rig.curves.shift import shift, start_with_handles
from rig.errors import CurveError
from tests.command import ran, refused
from tests.errors import one_line

RATE = 16_000
CASES = [(0, 8, 24.0), (3, 0, 30.0), (-2, 0, 24.0), (1, 8, 23.976), (4, 2, 60.0), (200, 5, 24.0)]
"""Delay, handles and rate."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shift")
    soundfile.write(folder / "line.wav", speechlike(1.2), RATE, subtype="PCM_16")
    return folder


@pytest.fixture(scope="module")
def performance(place, model):
    return animate(place / "line.wav", "happy", model=model)


def wanted(performance, delay, handles, fps):
    """Frame k shows what frame k - handles - delay had, held beyond both ends."""
    own = performance.curves.resample(fps).values
    places = np.arange(-handles, len(own) + handles).clip(0, len(own) - 1)
    return own[(places - delay).clip(0, len(own) - 1)]


@pytest.mark.parametrize(("delay", "handles", "fps"), CASES)
def test_python_and_convert_write_the_same(performance, delay, handles, fps, tmp_path):
    """Other doors: `tests.api.test_parity`."""
    form = {"fps": fps, "delay": delay, "handles": handles}
    saved = performance.save(tmp_path / "python.csv", **form)
    converted = tmp_path / "converted.csv"
    options = [f"--{name}={value}" for name, value in form.items()]
    ran("convert", performance.save(tmp_path / "take"), converted, *options)
    rows = wanted(performance, delay, handles, fps)
    for path in (saved, converted):
        curves = read_curves(path)
        assert curves.values.shape == rows.shape, path
        assert np.abs(curves.values - rows).max() < 1e-5, path


@pytest.mark.parametrize(("delay", "handles", "fps"), CASES)
def test_take_has_silence_for_its_handles_and_an_earlier_time(
    place, performance, delay, handles, fps, tmp_path
):
    start = 3600.0
    take = performance.save(tmp_path / "take", fps=fps, start=start, delay=delay, handles=handles)
    curves = read_curves(take / "curves.json")
    about = json.loads((take / "take.json").read_text())
    assert (about["delay_frames"], about["handles_frames"]) == (delay, handles)
    assert about["start_seconds"] == pytest.approx(start - handles / curves.fps)
    sound, rate = soundfile.read(take / "audio.wav", dtype="float32")
    lead = round(handles / curves.fps * rate)
    assert not sound[:lead].any() and (not lead or not sound[-lead:].any())
    own = performance.recording.waveform
    assert np.abs(sound[lead : lead + len(own)] - own).max() < 1e-4
    assert len(curves) == about["frames"] == len(wanted(performance, delay, handles, fps))
    intensity = (take / "intensity.csv").read_text().splitlines()
    assert len(intensity) == len(performance.curves) + 1  # in the time of the recording
    if not delay:  # another take goes on at the last pose, with its speed
        first = edge_of(performance, "after", last=True)
        kept = edge_of(take, "after", last=True)
        assert kept.quiet == first.quiet
        if fps == 24.0:
            rows = performance.curves.resample(fps).values
            place_of = performance.curves.index("CTRL_C_jaw.ty")
            step = (rows[-1] - rows[-2])[place_of] * fps / 30
            assert kept.speed.get("CTRL_C_jaw.ty", 0) == pytest.approx(step, abs=1e-4)


@pytest.mark.parametrize(
    ("start", "handles", "fps", "found"),
    [(3600.0, 8, 24, 3600 - 1 / 3), (0.0, 8, 24, 0.0), (0.25, 24, 24, 86399.25), (5.0, 0, 30, 5.0)],
)
def test_time_of_the_first_frame(start, handles, fps, found):
    """Zero is no time; before midnight is the day before."""
    assert start_with_handles(start, handles, fps) == pytest.approx(found)


@pytest.mark.parametrize(
    ("delay", "handles"), [(241, 0), (-241, 0), (0, -1), (0, 1001), (1.5, 0), (0, "8"), (True, 0)]
)
def test_shifts_out_of_range_are_one_line(performance, delay, handles, tmp_path):
    for write in (
        lambda: shift(performance.curves, delay, handles),
        lambda: performance.save(tmp_path / "a.csv", delay=delay, handles=handles),
        lambda: performance.save(tmp_path / "take", delay=delay, handles=handles),
    ):
        with one_line(CurveError, match="whole number"):
            write()
    assert not [*tmp_path.iterdir()]


def test_a_mesh_has_no_delay(place, tmp_path):
    line = refused("animate", place / "line.wav", "--vertices", "-o", tmp_path / "m.npz",
                   "--delay", "2")  # fmt: skip
    assert "--delay does not apply" in line
