"""`AgentFace`: sound and frames in step, interruption, and a face between its turns."""

import threading

import numpy as np
import pytest

from deitalk import LiveAnimator
from deitalk.agents.face import IDLE_SECONDS, AgentFace
from deitalk.errors import AudioError
from deitalk.live.stream import CLOSING_FRAMES
from tests.deitalk.live.conftest import RATE, mouth_from_rest, tiny, voice
from tests.errors import one_line

__all__ = ["tiny", "voice"]
SMILE = "CTRL_L_mouth_cornerPull.ty"


class Clock:
    """Seconds that pass when a test says so."""

    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def face(tiny, clock):
    return AgentFace(tiny, "happy", clock=clock)


def pcm(samples):
    return np.rint(np.asarray(samples) * 32767).astype("<i2").tobytes()


def at_rate(voice, rate):
    times = np.arange(round(len(voice) / RATE * rate)) / rate
    return np.interp(times, np.arange(len(voice)) / RATE, voice)


def spoken(face, sound, rate, size=None):
    """The pieces of a turn whose sound comes in chunks of so many bytes."""
    size = size or len(sound)
    pieces = [p for k in range(0, len(sound), size) for p in face.speak(sound[k : k + size], rate)]
    return pieces + face.end()


@pytest.mark.parametrize(
    ("size", "rate"),
    [(None, 16_000), (None, 48_000), (1_282, 22_050), (3_334, 8_000)],
)
def test_sound_is_passed_on_whole_and_in_step_with_its_frames(face, voice, rate, size):
    sound = pcm(at_rate(voice[:RATE], rate))
    for _ in range(2):  # two turns
        pieces = spoken(face, sound, rate, size)
        joined = b"".join(piece.sound for piece in pieces)
        assert joined.endswith(sound) and not any(joined[: -len(sound)])  # silence, then all of it
        frames = played = 0
        for piece in pieces[:-1]:
            frames += len(piece.curves)
            played += len(piece.sound) // 2
            assert abs(played / rate - frames / 30) <= 1 / 30
        count = frames + len(pieces[-1].curves)
        assert abs(count / 30 - len(joined) / 2 / rate) <= 2 / 30
        assert len(joined) - len(sound) <= 2 * rate * 0.25
    numbers = [piece.first for piece in pieces]
    assert numbers == sorted(numbers)


def test_frames_are_those_of_the_live_animator(face, tiny, voice):
    sound = np.frombuffer(pcm(voice), "<i2")
    pieces = spoken(face, sound.tobytes(), RATE, 3200)
    wanted = LiveAnimator(tiny, "happy").feed(sound)
    found = np.concatenate([piece.curves for piece in pieces])
    # Pieces of other lengths are summed in another order.
    assert np.abs(found[: len(wanted)] - wanted).max() < 1e-4


def test_channels_are_mixed(tiny, clock, voice):
    both = np.repeat(np.frombuffer(pcm(voice), "<i2"), 2)
    found, wanted = (
        AgentFace(tiny, clock=clock).speak(sound, RATE, n)
        for sound, n in ((both.tobytes(), 2), (both[::2].tobytes(), 1))
    )
    assert np.array_equal(found[0].curves, wanted[0].curves) and found[0].sound == wanted[0].sound


@pytest.mark.parametrize("played", [0.0, 0.4, 0.75, 1.3, 2.0, 9.0])
def test_interrupted_mouth_shuts_from_the_frame_that_is_shown(face, clock, voice, played):
    pieces = spoken(face, pcm(voice), RATE)
    curves = np.concatenate([piece.curves for piece in pieces])
    clock.now += played
    (piece,) = face.interrupt()
    shown = curves[min(int(played * 30), len(curves) - 1)]
    assert not piece.sound and len(piece.curves) >= CLOSING_FRAMES
    assert mouth_from_rest(face.animator, piece.curves)[CLOSING_FRAMES - 1 :].max() < 1e-6
    smile = face.names.index(SMILE)
    near = curves[max(int(played * 30) - 1, 0) : int(played * 30) + 2, smile]
    near = near if len(near) else shown[[smile]]
    assert np.abs(piece.curves[:, smile][:, None] - near).min() < 1e-6
    assert piece.first > pieces[-1].first


def test_sound_that_waits_is_dropped_by_an_interruption(face, clock, voice):
    face.speak(pcm(voice), RATE)
    face.interrupt()
    assert not face.end()
    again = spoken(face, pcm(voice), RATE)
    joined = b"".join(piece.sound for piece in again)
    assert joined.endswith(pcm(voice)) and len(joined) - len(pcm(voice)) <= 0.25 * 2 * RATE


def test_interruption_before_anything_is_nothing(face):
    assert face.interrupt() == [] and face.end() == []


def test_a_silent_face_moves_in_real_time(face, clock):
    frames, began = 0, clock.now
    for _ in range(40):
        clock.now += 0.13
        pieces = face.idle()
        assert all(not piece.sound for piece in pieces)
        frames += sum(len(piece.curves) for piece in pieces)
    assert frames / 30 == pytest.approx(clock.now - began, abs=0.4)


def test_a_face_is_not_idle_while_its_sound_is_played(face, clock, voice):
    spoken(face, pcm(voice), RATE)
    for _ in range(int(3.0 / 0.1)):
        clock.now += 0.1
        assert face.idle() == []
    clock.now += 1
    assert face.idle()
    assert face.idle() == []  # not twice


def test_late_sound_is_waited_for_in_silence(face, clock, voice):
    """A stall of the service: what comes after it is whole, and in step."""
    half = len(voice) // 2
    pieces = face.speak(pcm(voice[:half]), RATE)
    clock.now += half / RATE + 0.4
    pieces += face.idle()
    pieces += face.speak(pcm(voice[half:]), RATE) + face.end()
    joined = b"".join(piece.sound for piece in pieces)
    assert joined.startswith(pcm(voice[:half])) and joined.endswith(pcm(voice[half:]))
    frames = sum(len(piece.curves) for piece in pieces)
    assert frames / 30 == pytest.approx(len(joined) / 2 / RATE, abs=2 / 30)


@pytest.mark.parametrize("rate", [16_000, 48_000])
def test_a_listener_moves_by_the_voice_of_the_user(tiny, voice, rate):
    """The heard voice changes the head, and leaves the mouth shut."""
    found = []
    for hears in (False, True):
        clock = Clock()
        face, heads = AgentFace(tiny, clock=clock, seed=1), []
        sound = pcm(np.tile(at_rate(voice, rate), 2))
        for k in range(36):
            clock.now += IDLE_SECONDS
            if hears:
                step = 2 * round(rate * IDLE_SECONDS)
                face.listen(sound[k * step : (k + 1) * step], rate)
            for piece in face.idle():
                heads.append(piece.head)
                assert mouth_from_rest(face.animator, piece.curves).max() < 0.05
        found.append(np.concatenate(heads))
    assert found[0].shape == found[1].shape and not np.array_equal(*found)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [((b"\0\0\0", 16_000), "bytes"), ((b"\0\0", 16_000, 2), "4 for each"), ((b"", 100), "8000")],
)
def test_wrong_sound_is_one_line(face, arguments, words):
    for take in (face.speak, face.listen):
        with one_line(AudioError, match=words):
            take(*arguments)


def test_threads_do_not_disturb_each_other(face, voice):
    sound, pieces = pcm(voice), []

    def speak():
        for k in range(0, len(sound), 3200):
            pieces.extend(face.speak(sound[k : k + 3200], RATE))

    threads = [threading.Thread(target=speak), threading.Thread(target=face.interrupt)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    pieces += face.end()
    assert pieces and mouth_from_rest(face.animator, face.interrupt()[0].curves)[2:].max() < 1e-6
