"""Frames that come as they are made: an even pace from uneven arrivals, without drift."""

import errno
import json

import numpy as np
import pytest

from rig.controls import DEFAULT_ID, default_controls
from rig.conversion.arkit import ARKIT_ID, HEAD, arkit_controls
from rig.livelink.pace import MARGIN_SECONDS, MOST_SECONDS, LiveSender
from rig.livelink.protocols import LiveLinkFace, PropertyJson
from rig.livelink.sender import REST_REPEATS, Clock

FPS = 30.0
NAMES = tuple(arkit_controls().names)


class Link:
    """A socket that keeps what is sent, or fails."""

    def __init__(self, now):
        self.now, self.times, self.error = now, [], None

    def send(self, data):
        if self.error is not None:
            raise self.error
        self.times.append(self.now())

    def close(self):
        pass


class Run:
    """A sender on a clock of its own, polled as often as blocks of sound come."""

    def __init__(self, **options):
        self.time = 100.0
        clock = Clock(now=lambda: self.time, sleep=self._sleep)
        self.sender = LiveSender(
            LiveLinkFace(), ("127.0.0.1", 9), NAMES, ARKIT_ID, FPS, clock=clock, **options
        )
        self.sender.link.close()
        self.link = self.sender.link = Link(lambda: self.time)

    def _sleep(self, seconds):
        self.time += seconds

    def until(self, moment):
        while (wait := self.sender.wait()) is not None and self.time + wait <= moment:
            self.time += wait
            self.sender.send_due()
        self.time = max(moment, self.time)

    def come(self, moment, count=1):
        self.until(moment)
        self.sender.push(np.zeros((count, len(NAMES)), np.float32))
        self.sender.send_due()


def test_frames_leave_evenly_however_they_come(rng):
    run = Run()
    for k in range(300):
        run.come(100 + k / FPS + rng.uniform(0, 0.015))
    run.sender.drain()
    steps = np.diff(run.link.times)[30:]
    assert len(run.link.times) == 300 and run.sender.n_skipped == 0
    assert np.abs(steps - 1 / FPS).max() < 0.001
    report = run.sender.report()
    assert report.waited[1] <= 0.015 + MARGIN_SECONDS + 0.001


def test_one_stall_in_three_seconds_delays_no_other_frame():
    run = Run()
    for k in range(90):
        run.come(100 + k / FPS + (0.06 if k == 60 else 0.0))
    run.sender.drain()
    behind = np.array(run.link.times) - 100 - np.arange(90) / FPS
    assert run.sender.n_skipped == 0 and behind[60] == pytest.approx(0.06)
    assert np.abs(np.delete(behind, [60, 61]) - MARGIN_SECONDS).max() < 0.001


@pytest.mark.parametrize("drift", [-2e-3, 2e-3])
def test_another_clock_of_the_sound_adds_up_to_no_frame(drift):
    run, frames = Run(), 3 * 60 * 30
    for k in range(frames):
        run.come(100 + k / FPS * (1 + drift))
    run.sender.drain()
    behind = run.link.times[-1] - (100 + (frames - 1) / FPS * (1 + drift))
    assert len(run.link.times) == frames and 0 <= behind < 1 / FPS


def test_late_burst_is_caught_up_with(rng):
    run = Run()
    for k in range(60):
        run.come(100 + k / FPS)
    run.come(100 + 90 / FPS, count=31)  # one second without frames
    for k in range(91, 200):
        run.come(100 + k / FPS)
    run.sender.drain()
    late = run.link.times[-1] - (100 + 199 / FPS)
    assert run.sender.n_skipped >= 31 - MOST_SECONDS * FPS - 1
    assert late <= MOST_SECONDS


def test_lost_network_is_noted_once_and_survived():
    notes = []
    run = Run(note=notes.append)
    run.come(100.0)
    run.until(100.5)
    run.link.error = OSError(errno.ENETUNREACH, "Network is unreachable")
    for k in range(1, 10):
        run.come(100.5 + k / FPS)
    run.until(101)
    assert len(notes) == 1 and "Network is unreachable" in notes[0]
    run.link.error = None
    run.come(101.2)
    run.until(102)
    assert len(notes) == 2 and run.sender.report().n_failed == 9


def test_face_rests_at_the_end():
    run = Run()
    run.sender.rest()
    assert len(run.link.times) == REST_REPEATS


def test_head_follows_the_columns_that_are_sent_as_they_are():
    protocol = PropertyJson("anna", ("CTRL_C_jaw.ty", *HEAD))
    sender = LiveSender(
        protocol, ("127.0.0.1", 9), ("CTRL_C_jaw.ty",), DEFAULT_ID, FPS, sends_head=True
    )
    sender.link.close()
    sent = sender.link = Link(lambda: 0.0)
    texts = []
    sent.send = lambda data: texts.append(json.loads(data)["anna"]["Properties"])
    track = np.array([[25.0, -10.0, 5.0, 1.0, 1.0, 1.0]], np.float32)
    sender.push(np.full((1, 1), 0.5, np.float32), track, catch_up=False)
    sender.drain()
    sender.rest()
    assert {one["Name"]: one["Value"] for one in texts[0]} == {
        "CTRL_C_jaw.translateY": 0.5, "HeadYaw": -0.5, "HeadPitch": -0.2, "HeadRoll": 0.1,
    }  # fmt: skip
    assert all(one["Value"] == 0 for one in texts[-1]) and len(texts) == 1 + REST_REPEATS


def test_head_of_the_board_reaches_the_values_of_arkit():
    names = default_controls().names
    run = LiveSender(LiveLinkFace(), ("127.0.0.1", 9), names, DEFAULT_ID, FPS)
    run.link.close()
    rows = run._converted(
        default_controls().rest[None].astype("f4"), np.full((1, 6), 10.0, np.float32)
    )
    np.testing.assert_allclose(rows[0, arkit_controls().indices(HEAD)], [-0.2, 0.2, 0.2], rtol=1e-5)
