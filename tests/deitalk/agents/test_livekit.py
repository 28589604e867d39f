"""A face behind the sound of a LiveKit agent, without a room."""

import asyncio
import time

import numpy as np
import pytest

from deitalk.live.stream import CLOSING_FRAMES
from tests.deitalk.live.conftest import mouth_from_rest, tiny, voice

pytest.importorskip(
    "livekit.agents", reason="needs the extra livekit: pip install 'deitalk[livekit]'"
)

from livekit import rtc
from livekit.agents.voice.io import AudioOutput, AudioOutputCapabilities

from deitalk.agents.livekit import FaceAudioOutput

__all__ = ["tiny", "voice"]
RATE = 24_000


class Player(AudioOutput):
    """Keeps what it is given; says that it was played when it is flushed or cleared."""

    def __init__(self, log):
        capabilities = AudioOutputCapabilities(pause=False)
        super().__init__(label="player", capabilities=capabilities, sample_rate=RATE)
        self.log, self.seconds = log, 0.0

    async def capture_frame(self, frame):
        await super().capture_frame(frame)
        self.seconds += frame.duration
        self.log.append(("sound", bytes(frame.data)))

    def flush(self):
        super().flush()
        self.log.append(("flush", b""))
        self.on_playback_finished(playback_position=self.seconds, interrupted=False)

    def clear_buffer(self):
        self.log.append(("clear", b""))
        self.on_playback_finished(playback_position=self.seconds, interrupted=True)


def sounds(voice):
    times = np.arange(len(voice) * 3 // 2) / RATE
    pcm = np.rint(np.interp(times, np.arange(len(voice)) / 16_000, voice) * 32767).astype("<i2")
    return [
        rtc.AudioFrame(part.tobytes(), RATE, 1, len(part))
        for part in np.array_split(pcm, len(pcm) // 480)
    ]


def drive(tiny, work, **options):
    """What the player and the face were given, in order, while `work` drives the output."""
    log = []

    async def whole():
        output = FaceAudioOutput(
            Player(log), lambda piece: log.append(("face", piece)), tiny, "happy", **options
        )
        output.on_attached()
        await work(output)
        output.on_detached()
        return output

    return asyncio.run(whole()), log


def test_a_turn_is_played_whole_and_in_step(tiny, voice):
    given = sounds(voice)

    async def speak(output):
        for frame in given:
            await output.capture_frame(frame)
        output.flush()
        assert not (await output.wait_for_playout()).interrupted

    _, log = drive(tiny, speak, idle=False)
    frames = played = 0
    for kind, content in log:
        frames += len(content.curves) if kind == "face" else 0
        played += len(content) / 2 / RATE if kind == "sound" else 0
        if kind == "sound":
            assert played <= frames / 30 + 1 / 30 and frames / 30 - played <= 0.4
    sound = b"".join(content for kind, content in log if kind == "sound")
    assert sound.endswith(b"".join(bytes(frame.data) for frame in given))
    assert log[-1][0] == "flush"


def test_an_interruption_shuts_the_mouth_at_once(tiny, voice):
    async def interrupt(output):
        for frame in sounds(voice):
            await output.capture_frame(frame)
        output.clear_buffer()
        assert (await output.wait_for_playout()).interrupted
        output.flush()
        await asyncio.sleep(0.2)

    output, log = drive(tiny, interrupt, idle=False)
    at = log.index(("clear", b""))
    after = [content for kind, content in log[at:] if kind == "face"]
    assert not [kind for kind, _ in log[at:] if kind == "sound"]
    values = np.concatenate([piece.curves for piece in after])
    assert mouth_from_rest(output.face.animator, values)[CLOSING_FRAMES - 1 :].max() < 1e-6
    smile = output.face.names.index("CTRL_L_mouth_cornerPull.ty")
    assert np.ptp(values[:6, smile]) < 1e-6


def test_a_silent_face_moves(tiny, voice):
    async def wait(output):
        end = time.monotonic() + 20
        while time.monotonic() < end and output.face._next < 15:
            for frame in sounds(voice)[:5]:
                output.listen(frame)
            await asyncio.sleep(0.1)

    _, log = drive(tiny, wait)
    assert sum(len(piece.curves) for _, piece in log) >= 15
    assert {kind for kind, _ in log} == {"face"}
