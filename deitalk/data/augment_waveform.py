"""Augmentation of recordings: voice, room, microphone, noise and level.

SDFA §4.3 (noise, pre-emphasis, warps) and the most effective ones for synthetic speech: resampling
as vocal-tract change, equalisers, rooms, band limits. Every function takes a Generator; none
changes its input.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy  # loads its parts at their first use, which takes half a second

from deitalk.audio.frames import SAMPLE_RATE
from rig.arrays import Float32, Float64


@dataclass(frozen=True)
class Surroundings:
    """Recordings of noise and of rooms to mix in; both may be empty."""

    noises: tuple[Float32, ...] = field(default=(), repr=False)
    rooms: tuple[Float32, ...] = field(default=(), repr=False)


def speed_factor(rng: np.random.Generator) -> float:
    """Factor of speed and pitch: above 1 is faster, higher, a shorter vocal tract."""
    return float(rng.uniform(0.82, 1.25)) if rng.random() < 0.75 else 1.0


def change_speed(waveform: Float32, factor: float) -> Float32:
    """Resample: S samples become about S / factor, pitch and formants rise by the factor."""
    if factor == 1.0 or not len(waveform):
        return waveform
    import soxr

    fast: Float32 = soxr.resample(waveform, SAMPLE_RATE * factor, SAMPLE_RATE, quality="MQ")
    return fast


def augment(
    waveform: Float32,
    rng: np.random.Generator,
    surroundings: Surroundings,
    voices: Sequence[Float32] = (),
    noisy: float = 0.62,
) -> Float32:
    """Change spectrum, room, band, noise and level, not the timing.

    Parameters
    ----------
    waveform : ndarray [shape=(S,)]
        Speech at the normal level.
    rng : numpy.random.Generator
        Source of every choice.
    surroundings : Surroundings
        Recordings of noise and of rooms.
    voices : sequence of ndarray
        Other speech, for babble.
    noisy : float, range 0 to 1
        Share of the noises that are less than 11 dB below the speech.

    Returns
    -------
    ndarray [shape=(S,)]
        In time with the input to a millisecond.
    """
    if not len(waveform):
        return waveform
    x = _colour(waveform.astype(np.float64), rng)
    if rng.random() < 0.45:
        x = _reverberate(x, rng, surroundings.rooms)
    x = _limit_band(x, rng)
    power = float(np.sqrt(np.mean(x**2)) + 1e-9)
    if rng.random() < 0.9:
        noise = _noise(len(x), rng, surroundings.noises, voices)
        # Signal-to-noise ratio, dB.
        low, high = (-3, 11) if rng.random() < noisy else (11, 48)
        x = x + noise * power * 10 ** (-float(rng.uniform(low, high)) / 20)
    else:
        x = x + rng.standard_normal(len(x)) * 10 ** rng.uniform(-5, -3.5)
    x = x * 10 ** (rng.uniform(-9, 7) / 20)
    if rng.random() < 0.03:
        x = np.clip(x, -0.3 * np.abs(x).max(), 0.3 * np.abs(x).max())
    return x.astype(np.float32)


def _colour(x: Float64, rng: np.random.Generator) -> Float64:
    """One to three peaking equalisers, and a tilt by (de-)emphasis (SDFA §4.3)."""
    for _ in range(rng.integers(1, 4)):
        centre = float(np.exp(rng.uniform(np.log(120), np.log(6500))))
        b, a = _peak(centre, rng.uniform(-9, 9), rng.uniform(0.4, 1.2))
        x = scipy.signal.lfilter(b, a, x)
    if rng.random() < 0.6:
        x = scipy.signal.lfilter([1, -rng.uniform(-0.5, 0.6)], [1], x)
    return x


def _peak(centre: float, gain_db: float, q: float) -> tuple[Float64, Float64]:
    """Peaking equaliser after Bristow-Johnson's audio EQ cookbook."""
    amplitude = 10 ** (gain_db / 40)
    omega = 2 * np.pi * centre / SAMPLE_RATE
    alpha, cosine = np.sin(omega) / (2 * q), np.cos(omega)
    b = np.array([1 + alpha * amplitude, -2 * cosine, 1 - alpha * amplitude])
    a = np.array([1 + alpha / amplitude, -2 * cosine, 1 - alpha / amplitude])
    return b / a[0], a / a[0]


def _reverberate(x: Float64, rng: np.random.Generator, rooms: Sequence[Float32]) -> Float64:
    if rooms and rng.random() < 0.5:
        room = rooms[int(rng.integers(len(rooms)))][:SAMPLE_RATE].astype(np.float64)
        room = room[max(int(np.abs(room).argmax()) - 8, 0) :]  # no delay: curves stay in time
        room = room / (np.abs(room).max() + 1e-9)
        wet = scipy.signal.fftconvolve(x, room)[: len(x)]
        mixed = x + rng.uniform(0.1, 1.0) * wet * (np.std(x) / (np.std(wet) + 1e-9))
        return mixed
    length = int(SAMPLE_RATE * rng.uniform(0.08, 0.5))
    tail = rng.standard_normal(length) * np.exp(-6.9 * np.arange(length) / length)
    tail *= rng.uniform(0.02, 0.12)
    tail[0] = 1
    return scipy.signal.fftconvolve(x, tail)[: len(x)]


def _limit_band(x: Float64, rng: np.random.Generator) -> Float64:
    if rng.random() < 0.3:
        x = scipy.signal.sosfilt(
            scipy.signal.butter(4, rng.uniform(3300, 7500), fs=SAMPLE_RATE, output="sos"), x
        )
    if rng.random() < 0.3:
        x = scipy.signal.sosfilt(
            scipy.signal.butter(2, rng.uniform(60, 300), "high", fs=SAMPLE_RATE, output="sos"), x
        )
    return x


def _noise(
    n: int, rng: np.random.Generator, noises: Sequence[Float32], voices: Sequence[Float32]
) -> Float64:
    """Babble, recorded or made, at power 1, of constant or varying level."""
    kind = rng.random()
    if kind < 0.15 and len(voices) >= 4:
        chosen = [voices[int(rng.integers(len(voices)))] for _ in range(4)]
        noise = np.sum([_piece(voice, n, rng) for voice in chosen], axis=0)
    elif kind < 0.35 and noises:
        noise = _piece(noises[int(rng.integers(len(noises)))], n, rng)
        noise = _coloured(noise, rng.uniform(-4, 4))
    elif kind < 0.85:
        # Noise with a random spectrum: a slope of ±6 dB an octave at most, and peaks of ±20 dB.
        slope = -rng.uniform(0, 6) if rng.random() < 0.6 else rng.uniform(0, 6)
        hills = rng.integers(1, 5) if rng.random() < 0.6 else 0
        peaks = [
            (rng.uniform(0, 7), rng.uniform(0.2, 1.2), rng.uniform(-20, 20)) for _ in range(hills)
        ]
        noise = _coloured(rng.standard_normal(n), slope, peaks)
    else:
        # Harmonics of a varying pitch, as of engines, horns and animals.
        pitch = np.exp(rng.uniform(np.log(60), np.log(900)))
        glide = 2 ** (rng.uniform(0, 0.6) * _wandering(n, rng, rng.uniform(0.5, 3)))
        phase = 2 * np.pi * np.cumsum(pitch * glide) / SAMPLE_RATE
        harmonics = range(1, int(min(7000 / (pitch * glide.max()), 12)) + 1)
        fall = rng.uniform(0.3, 1.5)
        noise = np.sum([np.sin(k * phase) * k**-fall for k in harmonics], axis=0)
    if rng.random() < 0.4:
        noise = noise * 10 ** (_wandering(n, rng, rng.uniform(1, 8)) * rng.uniform(3, 12) / 20)
    scaled: Float64 = noise / (noise.std() + 1e-9)
    return scaled


def _coloured(
    noise: Float64, slope: float, hills: Sequence[tuple[float, float, float]] = ()
) -> Float64:
    """Tilt the spectrum by `slope` dB an octave; `hills`: octaves below the top, width, dB."""
    n = len(noise)
    length = scipy.fft.next_fast_len(n, real=True)
    spectrum = scipy.fft.rfft(noise, length)
    octaves = np.log2(np.arange(len(spectrum)) + 1.0)
    gain_db = slope * octaves
    for below, width, height in hills:
        gain_db += height * np.exp(-(((octaves - octaves[-1] + below) / width) ** 2))
    coloured: Float64 = scipy.fft.irfft(spectrum * 10 ** (gain_db / 20), length)[:n]
    return coloured


def _wandering(n: int, rng: np.random.Generator, hertz: float) -> Float64:
    """A smooth random curve, mostly within -1 to 1, with about `hertz` knots a second."""
    knots = max(int(n / SAMPLE_RATE * hertz), 1) + 3
    places = np.linspace(0, knots - 1, n)
    course: Float64 = scipy.interpolate.CubicSpline(
        np.arange(knots), 0.6 * rng.standard_normal(knots)
    )(places)
    return np.clip(course, -1.5, 1.5)


def _piece(recording: Float32, n: int, rng: np.random.Generator) -> Float64:
    """A random stretch of n samples, repeated where the recording is shorter; power 1."""
    start = int(rng.integers(max(len(recording) - n, 0) + 1))
    piece = np.resize(recording[start : start + n], n).astype(np.float64)
    scaled: Float64 = piece / (piece.std() + 1e-9)
    return scaled
