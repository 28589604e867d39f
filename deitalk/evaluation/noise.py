"""Speech in noise at a known ratio."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deitalk.activity import active_level_db
from deitalk.audio import load_audio
from deitalk.errors import DataError

Floats = NDArray[np.float32]
SNRS_DB = (20.0, 10.0, 5.0, 0.0)
MAX_FILES = 50


def pink_noise(n: int, seed: int = 0) -> Floats:
    """Noise whose power falls 3 dB an octave [shape=(n,), RMS 1]."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(n))
    spectrum /= np.sqrt(np.maximum(np.arange(len(spectrum)), 1))
    noise = np.fft.irfft(spectrum, n)
    unit: Floats = (noise / np.sqrt(np.square(noise).mean())).astype(np.float32)
    return unit


def read_noises(source: str) -> list[Floats]:
    """Noises of a folder of recordings, or ``pink``.

    Raises
    ------
    DataError
        If the folder is missing or holds no recording.
    """
    if source == "pink":
        return [pink_noise(16_000 * 30)]
    folder = Path(source)
    if not folder.is_dir():
        raise DataError(f"{source}: neither a folder of recordings nor the word pink")
    files = sorted(f for f in folder.iterdir() if f.suffix.lower() in (".flac", ".wav", ".ogg"))
    if not files:
        raise DataError(f"{source}: holds no .flac, .wav or .ogg; give a folder that does, or pink")
    return [load_audio(file).waveform for file in files[:MAX_FILES]]


def mix(speech: Floats, noise: Floats, snr_db: float) -> Floats:
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
    level = active_level_db(speech)
    piece = np.resize(noise, len(speech)).astype(np.float64)
    power = np.square(piece).mean()
    if not np.isfinite(level) or power == 0:
        return speech.copy()
    gain = 10 ** ((level - snr_db) / 20) / np.sqrt(power)
    mixed: Floats = (speech + gain * piece).astype(np.float32)
    return mixed
