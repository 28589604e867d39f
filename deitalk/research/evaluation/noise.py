"""Speech in noise or music at a given signal-to-noise ratio.

Letters: N samples of the noise.
"""

from pathlib import Path

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.voice_activity import active_level_db
from deitalk.errors import DataError
from deitalk.research.training.surroundings import read_recordings
from rig.arrays import Float32, Float64

SNRS_DB = (20.0, 10.0, 5.0, 0.0)
MAX_FILES = 50
CHORDS = ((0, 4, 7, 12), (7, 11, 14, 19), (9, 12, 16, 21), (5, 9, 12, 17))
"""Semitones above the tonic: I, V, vi, IV."""


def pink_noise(n: int, seed: int | np.random.Generator = 0) -> Float32:
    """Noise without DC whose power falls 3 dB an octave [shape=(n,), RMS 1]; n at least 2."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(n))
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
    spectrum[0] = 0
    noise = np.fft.irfft(spectrum, n)
    unit: Float32 = (noise / np.sqrt(np.square(noise).mean())).astype(np.float32)
    return unit


def synthetic_music(seconds: float, seed: int = 0) -> Float32:
    """Four chords in a loop, an arpeggio and drums [shape=(N,), 16 kHz, RMS 1].

    Held notes have 14 harmonics and vibrato (5.5 Hz, 0.4 %), like strings; plucked notes decay
    within 0.3 s; drums are a falling sine and bursts of noise. Key and tempo are drawn from the
    seed. It has no singing, which speech detectors often take for speech.

    Parameters
    ----------
    seconds : float
        Greater than 0.
    seed : int
        Of key, tempo, phases and the arpeggio's order.
    """
    rng = np.random.default_rng(seed)
    beat = 60 / rng.uniform(80, 140)
    tonic = 110 * 2 ** (rng.integers(12) / 12)
    music = np.zeros(round(seconds * SAMPLE_RATE))
    for i in range(int(seconds / beat) + 1):
        chord = CHORDS[i // 4 % len(CHORDS)]
        if i % 4 == 0:
            for step in chord:
                _add(music, i * beat, 0.5 * _held_note(tonic * 2 ** (step / 12), 4 * beat, rng))
        for half in (0, 0.5):
            step = chord[rng.integers(len(chord))] + 12
            _add(music, (i + half) * beat, _plucked_note(tonic * 2 ** (step / 12)))
            _add(music, (i + half) * beat, 0.3 * _burst(0.03, rng))
        _add(music, i * beat, _burst(0.12, rng) if i % 2 else 3 * _drum())
    unit: Float32 = (music / np.sqrt(np.square(music).mean())).astype(np.float32)
    return unit


def _add(music: Float64, start: float, note: Float64) -> None:
    """Add a note that begins at `start` seconds, as far as it fits."""
    first = round(start * SAMPLE_RATE)
    piece = music[first : first + len(note)]
    piece += note[: len(piece)]


def _seconds(length: float) -> Float64:
    return np.arange(round(length * SAMPLE_RATE)) / SAMPLE_RATE


def _held_note(pitch: float, length: float, rng: np.random.Generator) -> Float64:
    t = _seconds(length)
    phase = 2 * np.pi * pitch * (t + 0.004 / (2 * np.pi * 5.5) * np.sin(2 * np.pi * 5.5 * t))
    tones = [np.sin(k * phase + rng.uniform(0, 6.3)) / k for k in range(1, 15)]
    note: Float64 = np.sum(tones, axis=0) * np.minimum(1, np.minimum(t, t[::-1]) / 0.05)
    return note


def _plucked_note(pitch: float) -> Float64:
    t = _seconds(0.6)
    tones = [np.sin(2 * np.pi * k * pitch * t) * np.exp(-t * 6 * k) / k for k in range(1, 9)]
    note: Float64 = np.sum(tones, axis=0)
    return note


def _burst(decay: float, rng: np.random.Generator) -> Float64:
    """Noise that rises with frequency and fades, as of a cymbal or a snare."""
    t = _seconds(5 * decay)
    return np.diff(rng.standard_normal(len(t) + 1)) * np.exp(-t / decay)


def _drum() -> Float64:
    t = _seconds(0.25)
    drum: Float64 = np.sin(2 * np.pi * (50 * t - 5 * np.exp(-t / 0.03)))
    return drum * np.exp(-t / 0.08)


def read_noises(source: str) -> list[Float32]:
    """Noises of a folder of recordings, or ``pink``.

    Raises
    ------
    DataError
        If the folder is missing or holds no recording.
    """
    return list(named_noises(source).values())


def named_noises(source: str) -> dict[str, Float32]:
    """Noises by file name without suffix; 30 s of ``pink`` or ``synthetic`` music are made.

    Raises
    ------
    DataError
        If the folder is missing or holds no recording.
    """
    if source == "pink":
        return {source: pink_noise(30 * SAMPLE_RATE)}
    if source == "synthetic":
        return {source: synthetic_music(30)}
    if not Path(source).is_dir():
        raise DataError(
            f"{source}: neither a folder of recordings nor one of the words pink, synthetic"
        )
    return dict(read_recordings(source, MAX_FILES))


def mix(speech: Float32, noise: Float32, snr_db: float) -> Float32:
    """Add noise, `snr_db` below the level of the speech without its pauses.

    Parameters
    ----------
    speech, noise : ndarray [shape=(S,)], [shape=(N,)]
        16 kHz; the noise is repeated as needed.
    snr_db : float
        Speech over noise, by power.

    Returns
    -------
    ndarray [shape=(S,)]
    """
    return mix_at_level(speech, noise, active_level_db(speech) - snr_db)


def mix_at_level(waveform: Float32, noise: Float32 | Float64, level_db: float) -> Float32:
    """Add noise of a given level.

    Parameters
    ----------
    waveform, noise : ndarray [shape=(S,)], [shape=(N,)]
        16 kHz; the noise is repeated as needed. Silent noise adds nothing.
    level_db : float
        RMS of the noise afterwards, dB re full scale; no noise is added at ``-inf``.

    Returns
    -------
    ndarray [shape=(S,)]
    """
    piece = np.resize(noise, len(waveform)).astype(np.float64)
    power = np.square(piece).mean()
    if not np.isfinite(level_db) or power == 0:
        return waveform.copy()
    mixed: Float32 = (waveform + 10 ** (level_db / 20) / np.sqrt(power) * piece).astype(np.float32)
    return mixed
