"""A face in a real Pipecat pipeline, with a text-to-speech program of this machine."""

import asyncio
import io
import shutil
import subprocess
import wave

import numpy as np
import pytest

from deitalk.live.stream import CLOSING_FRAMES
from tests.deitalk.live.conftest import mouth_from_rest, tiny, voice

pytest.importorskip("pipecat", reason="needs the extra pipecat: pip install 'deitalk[pipecat]'")

from pipecat.frames.frames import (
    InputAudioRawFrame,
    InterruptionFrame,
    TTSAudioRawFrame,
    TTSSpeakFrame,
    TTSStartedFrame,
    TTSStoppedFrame,
)
from pipecat.pipeline.pipeline import Pipeline
from pipecat.services.tts_service import TTSService
from pipecat.tests.utils import SleepFrame, run_test

from deitalk.agents.pipecat import CurvesFrame, FaceProcessor

__all__ = ["tiny", "voice"]
RATE = 16_000


def flite(text):
    """Sound of a text, as the program flite speaks it."""
    if not shutil.which("flite"):
        pytest.skip("needs the program flite")
    done = subprocess.run(
        ["flite", "-voice", "slt", "-t", text, "-o", "/dev/stdout"], capture_output=True, check=True
    )
    data = bytearray(done.stdout)
    with wave.open(io.BytesIO(bytes(data))) as file:
        return file.readframes(len(data)), file.getframerate()


class Flite(TTSService):
    """A service that speaks in chunks of 20 ms, faster than they are played."""

    async def run_tts(self, text, context_id):
        sound, rate = flite(text)
        step = rate // 50 * 2
        for start in range(0, len(sound), step):
            yield TTSAudioRawFrame(sound[start : start + step], rate, 1, context_id=context_id)


def run(processor, frames):
    down, _ = asyncio.run(run_test(processor, frames_to_send=frames, start_timeout=60))
    return down


def of(kind, frames):
    return [frame for frame in frames if type(frame) is kind]


def chunks(voice, seconds=0.02):
    sound = np.rint(voice * 32767).astype("<i2").tobytes()
    step = 2 * round(RATE * seconds)
    return [TTSAudioRawFrame(sound[k : k + step], RATE, 1) for k in range(0, len(sound), step)]


def test_a_sentence_of_a_local_voice_comes_out_with_its_curves(tiny):
    text = "My promise is big."
    face = FaceProcessor(tiny, "happy", idle=False)
    service = Flite(push_start_frame=True, push_stop_frames=True, stop_frame_timeout_s=0.3)
    down = run(Pipeline([service, face]), [TTSSpeakFrame(text), SleepFrame(3.0)])
    sound = b"".join(frame.audio for frame in of(TTSAudioRawFrame, down))
    said, rate = flite(text)
    assert said in sound and len(sound) - len(said) <= 0.3 * 2 * rate
    curves = of(CurvesFrame, down)
    count = sum(len(frame.values) for frame in curves)
    assert count / 30 == pytest.approx(len(sound) / 2 / rate, abs=0.07)
    assert (
        mouth_from_rest(
            face.face.animator, np.concatenate([frame.values for frame in curves])
        ).max()
        > 0.02
    )
    assert [frame.first for frame in curves] == sorted({frame.first for frame in curves})


def test_curves_stand_before_the_sound_of_their_time(tiny, voice):
    face = FaceProcessor(tiny, idle=False)
    down = run(face, [TTSStartedFrame(), *chunks(voice), TTSStoppedFrame()])
    frames = played = 0
    for frame in down:
        if isinstance(frame, CurvesFrame):
            frames += len(frame.values)
        elif isinstance(frame, TTSAudioRawFrame):
            played += len(frame.audio) / 2 / RATE
            assert played <= frames / 30 + 1 / 30
            assert frames / 30 - played <= 0.4
    assert isinstance(down[-1], TTSStoppedFrame)  # after the last sound
    assert played == pytest.approx(len(voice) / RATE, abs=0.25)


def test_an_interruption_shuts_the_mouth_and_keeps_the_expression(tiny, voice):
    face = FaceProcessor(tiny, "happy", idle=False)
    frames = [TTSStartedFrame(), *chunks(voice), SleepFrame(1.5), InterruptionFrame()]
    down = run(face, [*frames, SleepFrame(1.0)])
    at = next(k for k, frame in enumerate(down) if isinstance(frame, InterruptionFrame))
    closing = of(CurvesFrame, down[at:])
    assert closing and not of(TTSAudioRawFrame, down[at:])
    values = np.concatenate([frame.values for frame in closing])
    assert mouth_from_rest(face.face.animator, values)[CLOSING_FRAMES - 1 :].max() < 1e-6
    smile = face.names.index("CTRL_L_mouth_cornerPull.ty")
    before = np.concatenate([frame.values for frame in of(CurvesFrame, down[:at])])[:, smile]
    assert np.ptp(values[:, smile]) < 1e-6
    assert np.abs(before - values[0, smile]).min() < 1e-6


def test_sound_after_an_interruption_is_spoken(tiny, voice):
    face = FaceProcessor(tiny, idle=False)
    frames = [*chunks(voice), SleepFrame(1.0), InterruptionFrame(), SleepFrame(0.5)]
    down = run(face, [*frames, *chunks(voice), TTSStoppedFrame()])
    at = next(k for k, frame in enumerate(down) if isinstance(frame, InterruptionFrame))
    sound = b"".join(frame.audio for frame in of(TTSAudioRawFrame, down[at:]))
    assert sound.endswith(b"".join(frame.audio for frame in chunks(voice)))
    values = np.concatenate([frame.values for frame in of(CurvesFrame, down[at:])])
    assert mouth_from_rest(face.face.animator, values).max() > 0.02


def test_a_silent_face_moves_and_hears_the_user(tiny, voice):
    face = FaceProcessor(tiny)
    heard = [InputAudioRawFrame(frame.audio, RATE, 1) for frame in chunks(voice[:RATE], 0.1)]
    frames = [part for frame in heard for part in (frame, SleepFrame(0.1))]
    down = run(face, [*frames, SleepFrame(0.5)])
    curves = of(CurvesFrame, down)
    assert sum(len(frame.values) for frame in curves) >= 10
    assert not of(TTSAudioRawFrame, down)
    assert len(of(InputAudioRawFrame, down)) == len(heard)  # passed on
    assert (
        mouth_from_rest(
            face.face.animator, np.concatenate([frame.values for frame in curves])
        ).max()
        < 0.05
    )
