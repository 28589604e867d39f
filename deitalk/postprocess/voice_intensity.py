"""What a voice does over time: gates of mouth and expression, and its intensity.

The sum of two parts, in standard deviations z of liveliness. The *base*, the operating point, is
how strong the voice is at any gain over two seconds (`deitalk.audio.vocal_strength`), relative to
the actor's own where it is given; it is bounded, so that a shouted take still has a range to vary
in. The *variation* within the take is that of level, pitch, tilt and the network's prediction about
their means, half of it about those of the seconds around, whose strength the base has; the mean
intensity of the take stays that of its base. The intensity is
e = 0.15 + 0.85 / (1 + exp(-1.3 z)), the scale of the corpus's labels. In pauses it decays towards
0.15, and rises just before the voice returns.

The weights were chosen on training and validation actors and validation readers; MODEL_CARD.md has
the scores of test actors.
"""

import numpy as np
import numpy.typing as npt

from deitalk.audio.vocal_strength import (
    LEVEL_DB,
    PITCH_SEMITONES,
    TILT_DB,
    Prosody,
)
from deitalk.config.rules import Gates, VoiceIntensity
from rig.arrays import AnyFloat, Bool, Float32, Float64
from rig.curves.edit import gaussian_smooth

# Gates of mouth and expression: shares of motion shown at each frame, from voice activity.
#
# Paper silent: neither paper specifies the face in silence. Here the mouth shuts and the expression
# decays by these gates, which use the activity of the whole clip.


REST_AT_END = 13  # frames of trailing silence (0.43 s) that end in a face wholly at rest
HOLD_AT_END = 6  # frames (0.2 s) that change nothing yet; in between, in proportion


def mouth_gate(activity: npt.ArrayLike, gates: Gates = Gates()) -> Float32:
    """Share of the mouth's motion shown at each frame: 1 in speech, 0 in silence.

    Opens over the 0.17 s before speech and closes over the 0.33 s after it, in raised cosines.

    Parameters
    ----------
    activity : array [shape=(T,)]
        1 in speech, else 0, from `deitalk.audio.voice_activity.speech_activity`.
    gates : Gates
        Frames of opening and closing.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
    """
    return mouth_between(*_distances(activity), gates)


def expression_gate(activity: npt.ArrayLike, gates: Gates = Gates()) -> Float32:
    """Share of the emotional expression shown at each frame: 1 in speech and short pauses.

    Rises over the 0.4 s before speech, holds through pauses of 1.5 s, then fades over 1 s. In
    trailing silence the fade is complete by the last frame: from 0.43 s of silence on the face
    ends at rest; under 0.2 s the clip counts as cut and nothing fades; in between in proportion.

    Parameters
    ----------
    activity, gates
        As for `mouth_gate`.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
    """
    since, until = _distances(activity)
    gate = expression_between(since, until, gates)
    if len(gate) and 0 < since[-1] < gates.expression_holds + gates.expression_fades:
        trailing = int(since[-1])
        depth = np.clip((trailing - HOLD_AT_END) / (REST_AT_END - HOLD_AT_END), 0, 1)
        held = max(trailing - gates.expression_fades, trailing // 4)
        progress = (np.arange(1, trailing + 1) - held) / (trailing - held)
        gate[-trailing:] = 1 - depth * (1 - fade(progress))
    return gate


def mouth_between(since: Float32, until: Float32, gates: Gates, ahead: int = 999) -> Float32:
    """Mouth gate so many frames after the last speech and before the next [shape=(T,) each].

    It opens no earlier than `ahead` frames before speech.
    """
    opens = min(gates.mouth_opens, ahead)
    return np.maximum(fade(since / (gates.mouth_closes + 1)), fade(until / (opens + 1)))


def expression_between(since: Float32, until: Float32, gates: Gates, ahead: int = 999) -> Float32:
    """The same of the expression, but for the end of a take."""
    fading = fade((since - gates.expression_holds) / gates.expression_fades)
    rises = min(gates.expression_rises, ahead)
    return np.maximum(fading, fade(until / (rises + 1)))


def _distances(activity: npt.ArrayLike) -> tuple[Float32, Float32]:
    """Frames since the last and until the next speaking frame (T,) each; inf where none."""
    active = np.asarray(activity) > 0.5
    frames = np.arange(len(active), dtype=np.float32)
    last = np.maximum.accumulate(np.where(active, frames, -np.inf))
    following = np.minimum.accumulate(np.where(active, frames, np.inf)[::-1])[::-1]
    return (frames - last).astype(np.float32), (following - frames).astype(np.float32)


def fade(progress: AnyFloat) -> Float32:
    """Raised cosine from 1 (progress 0) to 0 (progress 1), flat outside."""
    faded: Float32 = 0.5 + 0.5 * np.cos(np.pi * np.clip(progress, 0, 1)).astype(np.float32)
    return faded


FAINTEST, STEEPNESS = 0.15, 1.3
"""Lowest intensity, and its slope in z; those of the training corpus."""
SMOOTHING_FRAMES = 6.0
"""Sigma, 0.2 s: intensity does not follow single syllables."""
MOST_TAKE = 3.0
"""Limit of the standard deviations of a whole take."""
MOST_BASE, MOST_VARIATION = 1.3, 3.0
"""Limits of the two parts, standard deviations."""
AROUND_WEIGHT = 2.6
"""Of the strength around a frame less its mean: two seconds of a take differ less than takes."""
NEAR_SHARE, NEAR_FRAMES = 0.5, 20.0
"""Share of the variation's own mean around a frame that is taken off it, and its sigma, 0.67 s."""
LEVEL_SHARE, TONE_SHARE = 1.5, 0.5
"""Of level, and of pitch and of tilt, in `VoiceIntensity.index_weight`."""
NETWORK_WEIGHT = 0.8
"""Of the network's prediction, deviations per one of its own."""
DEEPEST_DB = 25.0
"""Level below the loudest speech; what is lower counts as this."""
FURTHEST_SEMITONES = 9.0
"""From the median pitch; further is a wrong octave."""
BRIGHTEST_DB = 5.0
"""Tilt above which a frame is a hiss, whose pitch and tilt are none of the voice."""
FEWEST_VOICED = 4
"""Voiced frames below which pitch and tilt do not count."""
MOST_TONE = 2.5
"""Limit of the standard deviations of pitch and tilt."""
FALL_FRAMES, RISE_FRAMES, END_FRAMES = 10.0, 5.0, 30.0
"""Time constants: decay in a pause, rise before speech, decay after the last speech."""


def voice_intensity(
    network: Float32,
    prosody: Prosody,
    activity: Float32,
    strength: Float32 | float = 0.0,
    rule: VoiceIntensity = VoiceIntensity(),
) -> Float32:
    """Intensity of every frame, of the network's prediction, the prosody and the strength.

    Parameters
    ----------
    network : array [shape=(T,), range 0 to 1]
        Predicted by the network.
    prosody : Prosody
        Of the same T frames, from `deitalk.audio.vocal_strength.measure_prosody`.
    activity : array [shape=(T,)]
        From `deitalk.audio.voice_activity.speech_activity`.
    strength : float or array [shape=(T,)]
        Of the voice around each frame, dB above the usual (`VocalStrength.follow`).
    rule : VoiceIntensity
        Weights.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
        At least 0.15 in speech; falls to 0.15 in pauses. `network` where nothing is voiced.

    Notes
    -----
    Not in the paper: DEITalk's saliency compares a frame with its own clip, not a clip with others.
    """
    speaking = activity > 0
    if not prosody.voiced.any() or not speaking.any():
        return network
    base = np.broadcast_to(base_z(strength, rule), network.shape)
    z = _variation(network, prosody, speaking, rule) + base
    z = z + _shift(z[speaking], _intensity(base[speaking]).mean())
    return _decayed(_intensity(z), speaking).astype(np.float32)


def base_z(strength: Float32 | Float64 | float, rule: VoiceIntensity) -> Float64:
    """Operating point of a strength in dB, standard deviations."""
    base: Float64 = MOST_BASE * np.tanh(rule.strength_weight * np.asarray(strength) / MOST_BASE)
    return base


def _intensity(z: Float64) -> Float64:
    found: Float64 = FAINTEST + (1 - FAINTEST) / (1 + np.exp(-STEEPNESS * z))
    return found


def _shift(z: Float64, mean: float) -> float:
    """What has to be added for a mean intensity, to 1e-6."""
    low, high = -2 * MOST_VARIATION, 2 * MOST_VARIATION
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (low, middle) if _intensity(z + middle).mean() > mean else (middle, high)
    return low


def _variation(network: Float32, prosody: Prosody, speaking: Bool, rule: VoiceIntensity) -> Float64:
    """Standard deviations of every frame about the take's mean, limited."""
    level = np.maximum(prosody.level, np.percentile(prosody.level[speaking], 95) - DEEPEST_DB)
    index = LEVEL_SHARE * _centred(level, speaking) / LEVEL_DB
    voiced = prosody.voiced & speaking & (prosody.tilt < BRIGHTEST_DB)
    if voiced.any():
        near = np.abs(prosody.pitch - np.median(prosody.pitch[voiced])) <= FURTHEST_SEMITONES
        voiced &= near
    if voiced.sum() >= FEWEST_VOICED:
        for track, unit in ((prosody.pitch, PITCH_SEMITONES), (prosody.tilt, TILT_DB)):
            tone = np.clip((track - track[voiced].mean()) / unit, -MOST_TONE, MOST_TONE)
            index = index + TONE_SHARE * _smoothed(tone, voiced)
    z = NETWORK_WEIGHT * _centred(deviation(network), speaking) + rule.index_weight * index
    limited: Float64 = MOST_VARIATION * np.tanh(z / MOST_VARIATION)
    return limited - NEAR_SHARE * _smoothed(limited, speaking, NEAR_FRAMES)


def _decayed(intensity: Float64, speaking: Bool) -> Float64:
    """Intensity that falls to `FAINTEST` in pauses, from its value beside them."""
    frames, spoken = np.arange(len(speaking)), np.flatnonzero(speaking)
    held = np.interp(frames, spoken, intensity[spoken])
    after = np.searchsorted(spoken, frames, side="right")  # the next frame of speech, of `spoken`
    since = np.where(after > 0, frames - spoken[np.maximum(after - 1, 0)], np.inf)
    until = np.where(
        after < len(spoken), spoken[np.minimum(after, len(spoken) - 1)] - frames, np.inf
    )
    fall = np.where(after < len(spoken), FALL_FRAMES, END_FRAMES)
    kept = np.maximum(np.exp(-since / fall), np.exp(-until / RISE_FRAMES))
    decayed: Float64 = np.where(speaking, intensity, FAINTEST + (held - FAINTEST) * kept)
    return decayed


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


def _centred(track: Float64, frames: Bool) -> Float64:
    """A track smoothed over some frames, less its mean over them."""
    smoothed = _smoothed(track, frames)
    centred: Float64 = smoothed - smoothed[frames].mean()
    return centred


def _smoothed(z: Float64, frames: Bool, sigma: float = SMOOTHING_FRAMES) -> Float64:
    """Gaussian mean over some frames; 0 far from them."""
    weight = gaussian_smooth(frames.astype(float), sigma)
    total = gaussian_smooth(np.where(frames, z, 0), sigma)
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), 0)
