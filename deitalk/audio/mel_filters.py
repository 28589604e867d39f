"""Triangular filters of equal width on the mel scale of Slaney's Auditory Toolbox.

They are those of ``librosa.filters.mel(..., htk=False)``, which takes longer to import than a
recording to animate.
"""

import numpy as np

from rig.arrays import Float32, Float64

LINEAR_HZ = 200 / 3
"""Hertz per mel up to `BREAK_HZ`."""
BREAK_HZ = 1000.0
"""Frequency from which the scale is logarithmic."""
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
