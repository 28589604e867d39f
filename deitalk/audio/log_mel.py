"""Whisper's log-mel spectrogram: its numbers, and the loudest value of a clip; without torch.

S samples at 16 kHz, F mel bins.
"""

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.mel_filters import mel_filters
from rig.arrays import Float32

N_FFT, HOP = 400, 160
"""Samples of a spectrum (25 ms) and between two."""
DYNAMIC_RANGE = 8.0
"""Mel power is at most so many decades below the clip's loudest."""
SILENCE = 1e-10
"""Least mel power."""
BLOCK = 6000
"""Frames whose spectra are computed at once."""


def log_mel_filters(n_mels: int) -> Float32:
    """Weights of the power spectrum's bins in each band (F, 201)."""
    return mel_filters(SAMPLE_RATE, N_FFT, n_mels, 0.0, SAMPLE_RATE / 2, equal_area=True)


def hann_window() -> Float32:
    """Periodic Hann window (400,)."""
    window: Float32 = np.hanning(N_FFT + 1)[:-1].astype(np.float32)
    return window


def frames_of(n_samples: int) -> int:
    """Frames of a clip: even, so that every feature at 50 Hz has two."""
    return -(-n_samples // (2 * HOP)) * 2


def loudest(sound: Float32, n_mels: int) -> float:
    """Largest logarithm to base 10 of the mel power of a clip (S,), in bounded memory.

    Frame j is at sample 160 j; outside the clip there is silence.
    """
    filters, window = log_mel_filters(n_mels).T, hann_window()
    found = SILENCE
    n_frames = frames_of(len(sound))
    for first in range(0, n_frames, BLOCK):
        count = min(BLOCK, n_frames - first)
        begin, end = first * HOP - N_FFT // 2, (first + count - 1) * HOP + N_FFT // 2
        piece = sound[max(begin, 0) : end]
        piece = np.pad(piece, (max(-begin, 0), max(end - max(begin, 0) - len(piece), 0)))
        frames = np.lib.stride_tricks.sliding_window_view(piece, N_FFT)[::HOP] * window
        spectra = np.fft.rfft(frames)
        power = (np.square(spectra.real) + np.square(spectra.imag)).astype(np.float32)
        found = max(found, float((power @ filters).max()))
    return float(np.log10(found))
