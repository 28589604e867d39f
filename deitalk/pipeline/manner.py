"""Manner of a voice: how level, pitch, periodicity and spectrum move in a recording.

Numbers of a whole recording or of a window: spreads, steps and percentiles about the mean, of what
emotions of a voice are known by (Banse and Scherer 1996; Eyben et al. 2016). Gain changes none of
them, and a microphone's colour only the strength (`deitalk.audio.vocal_strength`).

Letters: T frames at 30 per second, M numbers.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.prosody import BANDS, Prosody
from deitalk.audio.vocal_strength import strength_frames, vocal_strength, without_level
from rig.arrays import Bool, Float32, Float64

SIZE = 3 * BANDS + 32
"""M."""
FEWEST_VOICED = 4
"""With fewer voiced frames of speech, those without speech count too."""
LARGEST_STEP = 5.0
"""Semitones from frame to frame; more is a wrong octave."""
DEEPEST_DB = 45.0
"""Level below the loudest speech; what is lower, such as digital silence, counts as this."""
EDGE_FRAMES = 6
"""At the start and the end, whose pitch is compared with the mean."""


def manner(prosody: Prosody, activity: Float32) -> Float32:
    """Measure the manner of a voice [shape=(M,)].

    Parameters
    ----------
    prosody : Prosody
        Of the frames.
    activity : array [shape=(T,)]
        1 in speech, else 0; 1 in at least one frame.
    """
    speech = activity > 0
    voiced = prosody.voiced & speech
    if voiced.sum() < FEWEST_VOICED:
        voiced = prosody.voiced | speech
    frames = strength_frames(prosody, activity)
    numbers = (
        _spectrum(without_level(frames)[0][:, :BANDS].astype(np.float64), speech),
        _pitch(prosody.pitch, voiced),
        _level(prosody.level, speech),
        _periodicity(prosody.periodicity, speech, voiced),
        _rate(prosody.sonority, speech),
        [voiced.sum() / speech.sum(), vocal_strength().measure(frames)],
        [_correlation(prosody.level, track, voiced) for track in (prosody.pitch, prosody.tilt)],
    )
    return np.concatenate(numbers).astype(np.float32)


def _spectrum(bands: Float64, speech: Bool) -> Float64:
    """Spread, height of the 90th percentile, and mean step of each band."""
    said = bands[speech]
    steps = np.abs(np.diff(bands, axis=0))[speech[1:] & speech[:-1]]
    mean_step = steps.mean(axis=0) if len(steps) else np.zeros(BANDS)
    high = np.percentile(said, 90, axis=0) - said.mean(axis=0)
    return np.concatenate((said.std(axis=0), high, mean_step))


def _pitch(pitch: Float64, voiced: Bool) -> Float64:
    """Percentiles, ranges, slope, ends and steps, in semitones."""
    found = pitch[voiced]
    places = np.percentile(found, (5, 25, 50, 75, 95))
    time = np.flatnonzero(voiced) / FRAME_RATE
    time = time - time.mean()
    slope = (found * time).sum() / (np.square(time).sum() + 0.05)
    ends = (found[-EDGE_FRAMES:].mean(), found[:EDGE_FRAMES].mean()) - found.mean()
    steps = np.diff(pitch)[voiced[1:] & voiced[:-1]]
    steps = steps[np.abs(steps) < LARGEST_STEP]
    moved = (np.abs(steps).mean(), steps.std()) if len(steps) else (0.0, 0.0)
    ranges = (places[4] - places[0], places[3] - places[1], found.std(), found.mean())
    return np.concatenate((places, ranges, [slope], ends, moved))


def _level(level: Float64, speech: Bool) -> Float64:
    """Percentiles about the mean, spread and mean step, dB."""
    said = np.maximum(level[speech], level[speech].max() - DEEPEST_DB)
    places = np.percentile(said, (5, 25, 50, 75, 95)) - said.mean()
    step = np.abs(np.diff(said)).mean() if len(said) > 1 else 0.0
    return np.concatenate((places, [said.std(), step]))


def _periodicity(periodicity: Float64, speech: Bool, voiced: Bool) -> Float64:
    """Harmonics over noise in dB: mean and spread of speech and of vowels, and percentiles."""
    share = np.clip(periodicity, 0.01, 0.99)
    harmonic = 10 * np.log10(share / (1 - share))
    both = (harmonic[speech], harmonic[voiced])
    moments = [value for part in both for value in (part.mean(), part.std())]
    return np.concatenate((moments, np.percentile(both[1], (10, 90))))


def _rate(sonority: Float64, speech: Bool) -> list[float]:
    """Peaks of the sonority per second of speech."""
    inner = sonority[1:-1]
    peaks = (inner > sonority[:-2]) & (inner >= sonority[2:]) & speech[1:-1]
    return [float(peaks.sum() / speech.sum() * FRAME_RATE)]


def _correlation(a: Float64, b: Float64, frames: Bool) -> float:
    a, b = a[frames], b[frames]
    if len(a) <= FEWEST_VOICED or not a.std() or not b.std():
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])
