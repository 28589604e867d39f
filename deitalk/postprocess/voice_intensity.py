"""Intensity of a voice: the network's prediction corrected by measured prosody.

The network is trained on windows at one level, in rooms and noise: its prediction follows the
voice within a take, but not whether the whole take is whispered or shouted. So it counts relative
to its own mean over the take, and two measurements are added. Within a take, the prosody index
(level, pitch and tilt relative to the take's mean; `deitalk.audio.prosody`) is finer than the
network where there is little noise. Across takes, the spectral tilt of voiced speech rises with
vocal effort, whatever the gain of the recording.

The sum is in standard deviations z of liveliness, on the scale of the corpus's intensity labels:
e = 0.15 + 0.85 / (1 + exp(-1.3 z)).
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from deitalk.audio.prosody import Prosody, prosody_index, vocal_effort_db
from deitalk.config import VoiceIntensity
from rig.arrays import Bool, Float32, Float64

FAINTEST, STEEPNESS = 0.15, 1.3
"""Lowest intensity, and its slope in z (`deitalk.corpus.rig_targets`)."""
SMOOTHING_FRAMES = 5.0
"""Sigma, 0.17 s: intensity does not follow single syllables."""
USUAL_EFFORT_DB, MOST_EFFORT = -12.5, 1.0
"""Effort of a usual voice, and the limit of the standard deviations above it."""
EDGE_FRAMES = 3.0
"""Sigma with which the corrected intensity fades beside speech."""


def voice_intensity(
    strength: Float32,
    prosody: Prosody,
    activity: Float32,
    rule: VoiceIntensity = VoiceIntensity(),
) -> Float32:
    """Smooth the network's intensity and correct it by the prosody.

    Parameters
    ----------
    strength : array [shape=(T,), range 0 to 1]
        Predicted by the network.
    prosody : Prosody
        Of the same T frames, from `deitalk.audio.prosody.measure_prosody`.
    activity : array [shape=(T,)]
        From `deitalk.audio.voice_activity.speech_activity`.
    rule : VoiceIntensity
        Weights of the prosody index and of the vocal effort.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
        At least 0.15 in speech. Linear through pauses; before the first and after the last speech
        `strength`, limited to the value at the nearest speech.

    Notes
    -----
    Not in the paper: DEITalk's saliency compares a frame with its own clip, not a clip with others.
    """
    speaking = activity > 0
    if not prosody.voiced.any() or not speaking.any():
        return strength
    z = _smoothed(_deviation(strength), speaking)
    z -= z[speaking].mean()  # labels of training have one mean per take
    z += rule.index_weight * prosody_index(prosody) + vocal_effort_z(prosody, rule)
    corrected = FAINTEST + (1 - FAINTEST) / (1 + np.exp(-STEEPNESS * z))
    pauses = _through_pauses(corrected, strength, speaking)
    counts = np.clip(2 * gaussian_filter1d(speaking.astype(float), EDGE_FRAMES), 0, 1)
    intensity: Float32 = (pauses + counts * (corrected - pauses)).astype(np.float32)
    return intensity


def vocal_effort_z(prosody: Prosody, rule: VoiceIntensity = VoiceIntensity()) -> float:
    """Vocal effort in standard deviations above the usual one, from the spectral tilt.

    0 where nothing is voiced.
    """
    if not prosody.voiced.any():
        return 0.0
    above = rule.effort_weight * (vocal_effort_db(prosody) - USUAL_EFFORT_DB)
    return MOST_EFFORT * float(np.tanh(above / MOST_EFFORT))


def _deviation(strength: Float32) -> Float64:
    """Standard deviations from the usual intensity; inverse of the curve of the labels."""
    share = np.clip((strength.astype(float) - FAINTEST) / (1 - FAINTEST), 1e-3, 1 - 1e-3)
    z: Float64 = np.log(share / (1 - share)) / STEEPNESS
    return z


def _through_pauses(corrected: Float64, strength: Float32, speaking: Bool) -> Float64:
    """Intensity with the frames without speech interpolated, or limited outside the speech."""
    frames, spoken = np.arange(len(strength)), np.flatnonzero(speaking)
    held: Float64 = np.interp(frames, spoken, corrected[spoken])
    outside = (frames < spoken[0]) | (frames > spoken[-1])
    return np.where(outside, np.minimum(held, strength), held)


def _smoothed(z: Float64, speaking: Bool) -> Float64:
    """Gaussian mean over the frames with speech."""
    weight = gaussian_filter1d(speaking.astype(float), SMOOTHING_FRAMES, mode="constant")
    total = gaussian_filter1d(np.where(speaking, z, 0), SMOOTHING_FRAMES, mode="constant")
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), z)
