"""Whisper's log-mel spectrogram: its numbers, and the loudest value of a clip; without torch.

S samples at 16 kHz, F mel bins.
"""

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.mel_filters import mel_filters
from rig.arrays import Float32, Int64

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
