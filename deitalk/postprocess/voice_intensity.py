"""Intensity of a voice: the network's prediction corrected by measured prosody.

The network is trained on windows at one level, in rooms and noise: its prediction follows the
voice within a take, but not whether the whole take is whispered or shouted. So it counts relative
to its own mean over the take, and two measurements are added. Within a take, the prosody index
(level, pitch and tilt relative to the take's mean; `deitalk.audio.prosody`) is finer than the
network where there is little noise. Across takes, the strength of the whole voice at any gain
(`deitalk.audio.vocal_strength`) counts, relative to the actor's own where it is given.

The sum is in standard deviations z of liveliness, on the scale of the corpus's intensity labels:
e = 0.15 + 0.85 / (1 + exp(-1.3 z)).
"""

import numpy as np

from deitalk.audio.prosody import Prosody, prosody_index
from deitalk.config import VoiceIntensity
from rig.arrays import Bool, Float32, Float64
from rig.curves.filters import gaussian_smooth

FAINTEST, STEEPNESS = 0.15, 1.3
"""Lowest intensity, and its slope in z (`deitalk.research.corpus.rig_targets`)."""
SMOOTHING_FRAMES = 5.0
"""Sigma, 0.17 s: intensity does not follow single syllables."""
MOST_TAKE = 3.0
"""Limit of the standard deviations of a whole take."""
EDGE_FRAMES = 3.0
"""Sigma with which the corrected intensity fades beside speech."""


def voice_intensity(
    network: Float32,
    prosody: Prosody,
    activity: Float32,
    take: float = 0.0,
    rule: VoiceIntensity = VoiceIntensity(),
) -> Float32:
    """Smooth the network's intensity and correct it by the prosody and the whole take's strength.

    Parameters
    ----------
    network : array [shape=(T,), range 0 to 1]
        Predicted by the network.
    prosody : Prosody
        Of the same T frames, from `deitalk.audio.prosody.measure_prosody`.
    activity : array [shape=(T,)]
        From `deitalk.audio.voice_activity.speech_activity`.
    take : float
        Of the whole take, in standard deviations, from `take_z`.
    rule : VoiceIntensity
        Weight of the prosody index.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
        At least 0.15 in speech. Linear through pauses; before the first and after the last speech
        `network`, limited to the value at the nearest speech.

    Notes
    -----
    Not in the paper: DEITalk's saliency compares a frame with its own clip, not a clip with others.
    """
    speaking = activity > 0
    if not prosody.voiced.any() or not speaking.any():
        return network
    z = _smoothed(deviation(network), speaking)
    z -= z[speaking].mean()  # labels of training have one mean per take
    z += rule.index_weight * prosody_index(prosody) + take
    corrected = FAINTEST + (1 - FAINTEST) / (1 + np.exp(-STEEPNESS * z))
    # Intensity with the frames without speech interpolated, or limited outside the speech.
    frames, spoken = np.arange(len(network)), np.flatnonzero(speaking)
    held: Float64 = np.interp(frames, spoken, corrected[spoken])
    outside = (frames < spoken[0]) | (frames > spoken[-1])
    pauses = np.where(outside, np.minimum(held, network), held)
    counts = np.clip(2 * gaussian_smooth(speaking.astype(float), EDGE_FRAMES, "mirror"), 0, 1)
    intensity: Float32 = (pauses + counts * (corrected - pauses)).astype(np.float32)
    return intensity


def take_z(strength: float, rule: VoiceIntensity = VoiceIntensity()) -> float:
    """Standard deviations of a whole take above the usual one, between -3 and 3.

    Parameters
    ----------
    strength : float
        Strength of the voice, dB above the usual (`deitalk.audio.vocal_strength`).
    rule : VoiceIntensity
        Standard deviations per decibel.
    """
    return MOST_TAKE * float(np.tanh(rule.strength_weight * strength / MOST_TAKE))


def deviation(intensity: Float32) -> Float64:
    """Standard deviations from the usual intensity; inverse of the curve of the labels."""
    share = np.clip((intensity.astype(float) - FAINTEST) / (1 - FAINTEST), 1e-3, 1 - 1e-3)
    z: Float64 = np.log(share / (1 - share)) / STEEPNESS
    return z


def _smoothed(z: Float64, speaking: Bool) -> Float64:
    """Gaussian mean over the frames with speech."""
    weight = gaussian_smooth(speaking.astype(float), SMOOTHING_FRAMES)
    total = gaussian_smooth(np.where(speaking, z, 0), SMOOTHING_FRAMES)
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), z)
