"""Whisper's log-mel spectrogram: its numbers, and the loudest value of a clip; without torch.

S samples at 16 kHz, F mel bins.
"""

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from rig.arrays import Float32, Float64, Int64

# Triangular filters of equal width on the mel scale of Slaney's Auditory Toolbox.
#
# They are those of ``librosa.filters.mel(..., htk=False)``, which takes longer to import
# than a recording to animate.

LINEAR_HZ = 200 / 3
"""Hertz per mel up to `BREAK_HZ`."""
BREAK_HZ = 1000.0
"""From here the scale is logarithmic."""
LOG_STEP = np.log(6.4) / 27
"""Natural logarithm of the frequency ratio of one mel above `BREAK_HZ`."""


def hz_to_mel(hz: float) -> float:
    """Mel of a frequency: linear to 1 kHz, which is 15 mel, logarithmic above."""
    if hz < BREAK_HZ:
        return hz / LINEAR_HZ
    return float(BREAK_HZ / LINEAR_HZ + np.log(hz / BREAK_HZ) / LOG_STEP)


def mel_to_hz(mel: Float64) -> Float64:
    """Frequencies of an array of mels, the inverse of `hz_to_mel`."""
    above = BREAK_HZ * np.exp(LOG_STEP * (mel - BREAK_HZ / LINEAR_HZ))
    return np.where(mel < BREAK_HZ / LINEAR_HZ, LINEAR_HZ * mel, above)


def mel_filters(
    sample_rate: float,
    n_fft: int,
    n_mels: int,
    lowest_hz: float,
    highest_hz: float,
    *,
    equal_area: bool = False,
) -> Float32:
    """Weights of the power spectrum's bins in each band.

    Parameters
    ----------
    sample_rate : float
        Hz.
    n_fft : int
        Length of the Fourier transform.
    n_mels : int
        Bands F.
    lowest_hz, highest_hz : float
        Lower edge of the first band and upper edge of the last.
    equal_area : bool
        Triangles of area 1 Hz (librosa's ``norm="slaney"``) instead of height 1 (``norm=None``).

    Returns
    -------
    array [shape=(F, n_fft / 2 + 1)]
        The height of a triangle would be reached, were there a bin at its centre.
    """
    edges = mel_to_hz(np.linspace(hz_to_mel(lowest_hz), hz_to_mel(highest_hz), n_mels + 2))
    distance = edges[:, None] - np.fft.rfftfreq(n_fft, 1 / sample_rate)  # (F + 2, bins)
    width = np.diff(edges)[:, None]
    rising, falling = -distance[:-2] / width[:-1], distance[2:] / width[1:]
    filters = np.maximum(0, np.minimum(rising, falling))
    if equal_area:
        filters *= 2 / (edges[2:] - edges[:-2])[:, None]
    return filters.astype(np.float32)


N_FFT = 400
"""Samples of a spectrum (25 ms)."""
PUBLISHED_RATE = 100
"""Spectra a second of the published models."""
DYNAMIC_RANGE = 8.0
"""Mel power is at most so many decades below the clip's loudest."""
SILENCE = 1e-10
"""Least mel power."""
BLOCK = 6000
"""Spectra that are computed at once."""


def log_mel_filters(n_mels: int) -> Float32:
    """Weights of the power spectrum's bins in each band (F, 201)."""
    return mel_filters(SAMPLE_RATE, N_FFT, n_mels, 0.0, SAMPLE_RATE / 2, equal_area=True)


def hann_window() -> Float32:
    """Periodic Hann window (400,)."""
    window: Float32 = np.hanning(N_FFT + 1)[:-1].astype(np.float32)
    return window


def centres(first: int, count: int, rate: int) -> Int64:
    """Samples at the centre of spectra `first` … `first` + `count` - 1: j SAMPLE_RATE / rate."""
    return np.round(np.arange(first, first + count) * (SAMPLE_RATE / rate)).astype(np.int64)


def loudest(sound: Float32, n_mels: int, n_frames: int, rate: int) -> float:
    """Largest logarithm to base 10 of the mel power of a clip (S,), in bounded memory.

    Outside the clip there is silence.
    """
    filters, window = log_mel_filters(n_mels).T, hann_window()
    found = SILENCE
    for first in range(0, n_frames, BLOCK):
        starts = centres(first, min(BLOCK, n_frames - first), rate) - N_FFT // 2
        begin, end = int(starts[0]), int(starts[-1]) + N_FFT
        piece = sound[max(begin, 0) : max(end, 0)]
        piece = np.pad(piece, (max(-begin, 0), max(end - max(begin, 0) - len(piece), 0)))
        frames = np.lib.stride_tricks.sliding_window_view(piece, N_FFT)[starts - begin] * window
        spectra = np.fft.rfft(frames)
        power = (np.square(spectra.real) + np.square(spectra.imag)).astype(np.float32)
        found = max(found, float((power @ filters).max()))
    return float(np.log10(found))
