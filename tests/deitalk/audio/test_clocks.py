"""Recordings whose packets have times of several clocks."""

import io

import av
import numpy as np
import pytest

from deitalk.audio.load import load_audio
from deitalk.errors import AudioError
from tests.deitalk.audio.test_times import EXACT, RATE, notes
from tests.errors import one_line
from tests.media import click, click_time, packets_of


def timed(times, length=0.1):
    """Packets of sound with the given times, seconds; a click within the last one."""
    file = io.BytesIO()
    with av.open(file, "w", format="matroska") as container:
        track = container.add_stream("pcm_s16le", rate=RATE, layout="mono")
        for number, time in enumerate(times):
            samples = np.zeros(round(length * RATE), np.float32)
            if number == len(times) - 1:
                samples = click(RATE, length, length / 2)
            for packet in packets_of(track, samples[:, None], RATE, time):
                container.mux(packet)
    return file.getvalue()


def places(count, *changes):
    """Times of packets of 0.1 s; each change is a number and what is added from it on."""
    times = np.arange(count) / 10
    for number, seconds in changes:
        times[number:] += seconds
    return times.tolist()


@pytest.mark.parametrize(
    ("times", "seconds", "note"),
    [
        (places(20), 2.0, ""),
        (places(20, (10, 0.004)), 2.0, ""),  # rounding
        (places(20, (10, 0.02)), 2.02, "1 hole between its packets, 0.02 s in all, the first at 1.00 s"),
        (places(20, (5, 1), (10, 2)), 5.0, "2 holes between its packets, 3.00 s in all"),
        (places(20, (10, -0.05)), 1.95, "overlapped the sound before, 0.05 s in all"),
        (places(20, (10, 50)), 52.0, "1 hole"),
        (places(20, (10, 1e6)), 2.0, "1 jump of its clock, the first at 1.00 s"),
        (places(20, (0, 1e6)), 2.0, ""),  # of the only track
    ],
)  # fmt: skip
def test_times_of_packets_are_kept_within_reason(times, seconds, note):
    recording = load_audio(timed(times))
    assert recording.duration == pytest.approx(seconds, abs=EXACT)
    assert click_time(recording.waveform) == pytest.approx(seconds - 0.05, abs=EXACT)
    assert note in " ".join(notes(recording)) and bool(note) == bool(notes(recording))


def test_silence_by_times_counts_for_the_longest_recording():
    with one_line(AudioError, "the limit is 60 s"):
        load_audio(timed(places(20, (10, 3000))), max_seconds=60)
