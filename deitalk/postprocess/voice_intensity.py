"""How lively a voice is: what the network hears, what can be measured, and the take as a whole.

The network hears windows at one level, through rooms, colours and noises: it knows when a voice
rises above itself, roughly, and cannot know whether the whole take is a whisper or a shout: only
what it says within a take counts, against its own mean there. Two measurements add what it misses.
Within a take, the prosody index (level, pitch and tilt against the take's own mean;
`deitalk.audio.prosody`) is finer than the network where there is little noise. Across takes, the
spectral tilt of voiced speech rises with vocal effort whatever the gain of the recording.

All of it is added in standard deviations of liveliness, on the scale on which the corpus labels
its intensity: e = 0.15 + 0.85 / (1 + exp(-1.3 z)). Letters: T frames.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from deitalk.audio.prosody import Prosody, prosody_index, vocal_effort_db
from rig.arrays import Bool, Float32, Float64

FAINTEST, STEEPNESS = 0.15, 1.3
"""Intensity of the dullest moment, and how fast it rises with z (`deitalk.corpus.rig_targets`)."""
SMOOTHING_FRAMES = 5.0
"""Sigma, 0.17 s: an actor's intensity does not tremble with the syllables."""
INDEX_WEIGHT = 0.6
"""Standard deviations added for one of the prosody index."""
USUAL_EFFORT_DB, EFFORT_WEIGHT, MOST_EFFORT = -12.5, 0.08, 1.0
"""Effort of a usual voice, standard deviations for a decibel above it, and at most so many."""
EDGE_FRAMES = 3.0
"""What is measured counts in speech and fades beside it, with this sigma."""


def voice_intensity(strength: Float32, prosody: Prosody, activity: Float32) -> Float32:
    """Intensity heard in a voice: the network's, smoothed and mended by measurement.

    Parameters
    ----------
    strength : ndarray [shape=(T,), range 0 to 1]
        The network's.
    prosody : Prosody
        Of the same T frames, from `deitalk.audio.prosody.measure_prosody`.
    activity : ndarray [shape=(T,)]
        From `deitalk.audio.voice_activity.speech_activity`.

    Returns
    -------
    ndarray [shape=(T,), range 0 to 1]
        In speech at least 0.15. A pause goes from what was before it to what follows; before the
        speech and after it, `strength`, but no more than the nearest speech.

    Notes
    -----
    Paper silent: DEITalk's saliency compares a frame with its clip; nothing in it sees that one
    clip is livelier than another.
    """
    speaking = activity > 0
    if not prosody.voiced.any() or not speaking.any():
        return strength
    z = _smoothed(_liveliness(strength), speaking)
    z -= z[speaking].mean()  # every take it learnt from was as lively as another
    z += INDEX_WEIGHT * prosody_index(prosody) + vocal_effort_z(prosody)
    mended = FAINTEST + (1 - FAINTEST) / (1 + np.exp(-STEEPNESS * z))
    pauses = _through_pauses(mended, strength, speaking)
    counts = np.clip(2 * gaussian_filter1d(speaking.astype(float), EDGE_FRAMES), 0, 1)
    intensity: Float32 = (pauses + counts * (mended - pauses)).astype(np.float32)
    return intensity


def vocal_effort_z(prosody: Prosody) -> float:
    """Standard deviations by which a voice is livelier than usual, from its spectral tilt.

    0 where nothing is voiced.
    """
    if not prosody.voiced.any():
        return 0.0
    above = EFFORT_WEIGHT * (vocal_effort_db(prosody) - USUAL_EFFORT_DB)
    return MOST_EFFORT * float(np.tanh(above / MOST_EFFORT))


def _liveliness(strength: Float32) -> Float64:
    """Standard deviations of liveliness behind an intensity."""
    share = np.clip((strength.astype(float) - FAINTEST) / (1 - FAINTEST), 1e-3, 1 - 1e-3)
    z: Float64 = np.log(share / (1 - share)) / STEEPNESS
    return z


def _through_pauses(mended: Float64, strength: Float32, speaking: Bool) -> Float64:
    """Intensity of the frames without speech: nobody is livelier for saying nothing."""
    frames, spoken = np.arange(len(strength)), np.flatnonzero(speaking)
    held: Float64 = np.interp(frames, spoken, mended[spoken])
    outside = (frames < spoken[0]) | (frames > spoken[-1])
    return np.where(outside, np.minimum(held, strength), held)


def _smoothed(z: Float64, speaking: Bool) -> Float64:
    """Gaussian mean over the frames with speech."""
    weight = gaussian_filter1d(speaking.astype(float), SMOOTHING_FRAMES, mode="constant")
    total = gaussian_filter1d(np.where(speaking, z, 0), SMOOTHING_FRAMES, mode="constant")
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), z)
