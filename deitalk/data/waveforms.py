"""Recordings of clips: at the normal level, and how many frames they have."""

from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import normalise_level
from rig.arrays import Float32


@cache
def recorded_frames(path: str) -> int:
    """Rig frames of a recording, at least 1; by its header where that counts the samples."""
    import soundfile

    with suppress(soundfile.LibsndfileError):
        found = soundfile.info(path)
        if found.format in COUNTED:
            return n_clip_frames(round(found.frames * SAMPLE_RATE / found.samplerate))
    return n_clip_frames(len(load_audio(path).waveform))


COUNTED = ("FLAC", "WAV", "WAVEX", "RF64", "AIFF")
"""Formats of libsndfile whose headers have the number of samples."""


def read_waveform(path: Path) -> Float32:
    """A recording at the normal level [shape=(S,)]."""
    steps, unit = sound_of(str(path))
    return steps.astype(np.float32) * np.float32(unit)


@lru_cache(maxsize=64)
def sound_of(path: str) -> tuple[NDArray[np.int16], float]:
    """A recording at the normal level in 16 bits of its own peak, and the worth of a step."""
    waveform = normalise_level(load_audio(path).waveform)
    unit = float(np.abs(waveform).max(initial=0)) / 32767 or 1.0
    return np.round(waveform / unit).astype(np.int16), unit


def n_clip_frames(n_samples: int, speed: float = 1.0) -> int:
    """Rig frames of a clip that is played at another speed; at least 1."""
    if speed == 1.0:
        return max(frame_count(n_samples), 1)
    return max(int(np.ceil(n_samples / SAMPLE_RATE * FRAME_RATE / speed)), 1)
