"""Sound in blocks, and the way from it to datagrams."""

import socket
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from deitalk.cli import app
from deitalk.cli.udp import transmit
from deitalk.errors import AudioError, MissingError
from deitalk.live import sources
from deitalk.live.animator import LiveAnimator
from deitalk.live.sources import BLOCKS_A_SECOND, Microphone, PacedSound
from rig.errors import UserError
from rig.livelink import LiveSender, decode, make_protocol
from rig.livelink.sender import Clock

SAMPLE = str(Path(__file__).parents[3] / "docs/samples/promise.flac")


class Time:
    """A clock that moves when somebody waits."""

    def __init__(self):
        self.seconds = 0.0

    def now(self):
        return self.seconds

    def sleep(self, seconds):
        self.seconds += seconds


def test_recording_comes_at_its_own_pace(voice):
    time = Time()
    source = PacedSound(voice, time.now, time.sleep)
    assert source.read(0.001) is None and time.seconds == pytest.approx(0.001)
    blocks = []
    while not source.is_over:
        blocks.append(source.read(1.0))
        assert time.seconds == pytest.approx(sum(map(len, blocks)) / 16_000)
    assert np.array_equal(np.concatenate(blocks), voice)
    ends = np.cumsum([len(block) for block in blocks])
    assert BLOCKS_A_SECOND % 30 == 0 and ends[14] == 1600  # three frames of 1/30 s


def test_missed_blocks_come_at_once_after_a_stall(voice, monkeypatch):
    time = Time()
    source = PacedSound(voice, time.now, time.sleep)
    source.read(1.0)
    time.sleep(0.101)
    late = source.read(1.0)
    assert np.array_equal(late, voice[107:1707])  # the block that is due, and 14 that were missed
    device = Device()
    monkeypatch.setitem(sys.modules, "sounddevice", device)
    microphone = Microphone()
    for value in range(3):
        device.made["callback"](np.full((441, 1), value), 441, None, None)
    assert np.array_equal(microphone.read(0.1), np.repeat(np.arange(3, dtype=np.float32), 441))


def test_recording_becomes_datagrams_behind_its_look_ahead(tiny, voice):
    time, times, frames = Time(), [], []
    source = PacedSound(voice, time.now, time.sleep)
    animator = LiveAnimator(tiny, emotion="happy")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5)
        sender = LiveSender(
            make_protocol("livelink", "anna", animator.names),
            receiver.getsockname(),
            animator.names,
            tiny.controls.id,
            30.0,
            clock=Clock(now=time.now, sleep=time.sleep),
        )
        send = sender._send

        def noted(number, row):
            times.append(time.seconds - number / 30)
            send(number, row)
            frames.append(decode(receiver.recv(2048)).frame)

        sender._send = noted
        transmit(source, animator, sender)
        sender.close()
    assert frames == list(range(93))
    assert max(times) <= animator.lookahead_seconds + 0.03  # computing takes no time on this clock
    assert min(times) >= animator.lookahead_seconds - 0.001


class Device:
    """A stand-in for sounddevice with one input."""

    PortAudioError = type("PortAudioError", (Exception,), {})

    def __init__(self, error=None):
        self.error, self.made = error, None

    def query_devices(self, device, kind):
        if self.error is not None:
            raise self.error
        return {"default_samplerate": 44100.0}

    def InputStream(self, **options):
        self.made = options
        return SimpleNamespace(start=lambda: None, close=lambda ignore_errors: None)


def test_microphone_gives_its_blocks_and_tells_when_it_is_gone(monkeypatch):
    device = Device()
    monkeypatch.setitem(sys.modules, "sounddevice", device)
    microphone = Microphone()
    assert microphone.sample_rate == 44100 and device.made["blocksize"] == 294
    device.made["callback"](np.full((441, 1), 0.5), 441, None, None)
    assert np.array_equal(microphone.read(0.1), np.full(441, 0.5, np.float32))
    assert microphone.read(0.001) is None
    monkeypatch.setattr(sources, "SILENT_SECONDS", 0.0)
    with pytest.raises(AudioError, match="given no sound"):
        microphone.read(0.001)


def test_microphone_that_is_gone_at_the_start_is_one_line(monkeypatch):
    device = Device()
    monkeypatch.setitem(sys.modules, "sounddevice", device)
    microphone = Microphone()

    def gone():
        raise device.PortAudioError("Device unavailable [PaErrorCode -9985]")

    microphone.stream.start = gone
    with pytest.raises(AudioError, match=r"cannot be opened \(Device unavailable"):
        microphone.read(0.1)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([SAMPLE, "--model", "none"], "none: no model there"),
        ([SAMPLE, "--model", "none", "--backend", "onnx"], "none: no model there"),
        (["--mic", "--model", "default"], "needs the whole clip; use the model live"),
        ([SAMPLE, "--backend", "gpu"], "backend 'gpu' is unknown; use auto, torch, onnx"),
        ([SAMPLE, "--loop"], "for a take or curves; leave them out"),
        ([SAMPLE, "--input", "x", "--force"], "sending does not use --force"),
        ([SAMPLE, "--input", "x"], "does not use --input"),
        (["docs", "--model", "mel"], "docs does not use --model"),
        (["--record", "x.csv", "--emotion", "sad", "--fps", "24"], "not use --emotion, --fps"),
        ([SAMPLE, "--words", "a"], "words needs the whole recording; leave it out"),
        (["--mic", SAMPLE], "give one of a recording, a take or curves, --mic, and --record"),
    ],
)
def test_wrong_command_is_one_line(arguments, words):
    done = CliRunner().invoke(app, ["live", *arguments])
    assert done.exit_code and isinstance(done.exception, UserError)
    assert words in str(done.exception) and "\n" not in str(done.exception)


def test_missing_microphone_or_package_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", Device(ValueError("No input device\nmatching")))
    with pytest.raises(AudioError, match=r"'x' cannot be opened \(No input device matching\)"):
        Microphone("x")
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(MissingError, match=r"deitalk\[mic\]"):
        Microphone()
