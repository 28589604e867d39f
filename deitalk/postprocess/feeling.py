"""State of feeling of a voice, and its display.

The model, for a recording that is known and, in `deitalk.live`, for a voice that has not ended::

    intensity = MOST / (1 + exp(-(state + display)))
    shown expression = share * intensity * pose of the emotion

The *state* is slow. In speech it is the strength of the phrase at any gain (`Speech.strengths`), in
a pause that of the phrase before, which passes into that of the phrase after. It is linear in
decibels and has no bound: a shout is stronger than a loud voice, and `MOST`, which no voice
reaches, is above 1. The *display* is what a listener sees change within a phrase: level, pitch,
tilt and the network's prediction about their means. It is small, has a mean of about 0 in each
phrase, and ends with the phrase: the voice falls there, and an expression that fell with it would
rise again in the pause. (A live voice's ends .2 s later, as its end is not known.)

The intensity that is shown of a named emotion is more than that of the voice, in weak and in
strong ones (`felt_intensity`): a line that is read plainly, by a calm reader or a synthetic voice,
shows a moderate expression, and of two phrases the stronger one is seen to be. The mouth opens
further as the voice is stronger than usual.

The *share* is that of `deitalk.postprocess.gates`.

Not in the paper: DEITalk's saliency compares a frame with its own clip, not a clip with others.

The numbers were chosen on training and validation actors, validation readers, and actors of another
corpus; MODEL_CARD.md has the scores of test actors.
"""

from typing import Any

import numpy as np

from deitalk.array_functions import (
    FAR,
    Array,
    as_index,
    as_number,
    between,
    join,
    library,
    like,
    mean_of,
    neighbours,
    padded,
    percentile,
    precise,
    single,
    smoothed,
)
from deitalk.audio.prosody import (
    LEVEL_DB,
    PITCH_SEMITONES,
    TILT_DB,
    Prosody,
)
from deitalk.config.rules import VoiceIntensity
from deitalk.emotions import LABELS

FAINTEST, STEEPNESS = 0.15, 1.3
"""Lowest intensity that a network is taught, and its slope per standard deviation of liveliness,
as in the training corpus."""
MOST = 1.2
"""Intensity that the strongest voice approaches."""
SMOOTHING_FRAMES = 6.0
"""Sigma, 0.2 s: the display does not follow single syllables."""
MOST_DISPLAY = 3.0
"""Limit of the standard deviations of the display."""
NAMED = (1.6, -2.0, 1.5)
NAMED_AS = {
    "neutral": (MOST, 0.0, 1.0),
    "angry": (1.3, -0.5, 1.6),
    "sad": (1.6, 0.0, 1.4),
    "surprised": (1.4, 0.0, 1.5),
}
"""Intensity that the strongest voice approaches in an emotion that is named, the decibels that its
voice counts more, and the factor of its state and display; and those of some labels. With smaller
factors a feeling seems to have one level, and the stronger phrase is hardly seen to be. In sadness
people are quieter; in stronger surprise the mouth is wide open at every vowel."""
NAMED_MOST, NAMED_DB, NAMED_SLOPE = np.array([NAMED_AS.get(label, NAMED) for label in LABELS]).T
PAUSE_FRAMES = 8
"""Longest silence within a phrase, 0.27 s."""
LEVEL_SHARE, TONE_SHARE = 0.9, 0.3
"""Standard deviations of the display per one of level, and of pitch and of tilt."""
NETWORK_SHARE = 0.8
"""The same per one of the network's prediction."""
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


def voice_intensity(
    network: Array,
    prosody: Prosody,
    speaking: Array,
    strength: Array | float = 0.0,
    rule: VoiceIntensity = VoiceIntensity(),
) -> Array:
    """Intensity of every frame, of the strength of the voice, its prosody and the network.

    Parameters
    ----------
    network : array or Tensor [shape=(T,), range 0 to 1]
        Predicted by the network.
    prosody : Prosody
        Of the same T frames, from `deitalk.audio.prosody.measure_prosody`.
    speaking : array or Tensor of bool [shape=(T,)]
        Frames of speech.
    strength : float, array or Tensor [shape=(T,)]
        Of the voice around each frame, dB above the usual (`Speech.strengths`).
    rule : VoiceIntensity
        Weights.

    Returns
    -------
    array or Tensor [shape=(T,), range 0 to 1.2]
        That of a usual voice where nobody speaks at all.
    """
    xp, usual = library(network), state_of(0.0, rule)
    state = state_of(strength, rule) + 0 * network
    inside = xp.clip(2 * smoothed(as_number(speaking), SMOOTHING_FRAMES) - 1, 0, None)
    display = rule.display * inside * _display(network, prosody, speaking)
    found = between(state, speaking) + display
    return intensity_of(xp.where(speaking.any(), found, xp.full_like(found, usual)))


def state_of(strength: Any, rule: VoiceIntensity) -> Any:
    """State of a voice of a strength in dB."""
    return rule.per_decibel * (strength - rule.middle)


def intensity_of(state: Array) -> Array:
    """Intensity of a state with its display."""
    return single(MOST / (1 + library(state).exp(-state)))


def felt_intensity(voice: Any, weights: Any, rule: VoiceIntensity) -> Any:
    """Intensity of an emotion that is named: up to `NAMED_MOST`, with steps by `NAMED_SLOPE`.

    By operators that arrays and tensors share.

    Parameters
    ----------
    voice : array or Tensor [shape=(..., T), range 0 to 1.2]
        Of the voice.
    weights : array or Tensor [shape=(..., T, 9)]
        Emotion of each frame.
    rule : VoiceIntensity
        State per decibel.
    """
    more, most, slope = (
        usual + weights @ like(named - usual, weights)
        for usual, named in (
            (1.0, np.exp(rule.per_decibel * NAMED_DB)), (MOST, NAMED_MOST), (1.0, NAMED_SLOPE)
        )
    )  # fmt: skip
    strong, weak = more * voice**slope, (MOST - voice) ** slope
    return most * strong / (strong + weak)


def state_of_intensity(intensity: Any) -> Any:
    """State without a display of intensities; inverse of `intensity_of`."""
    share = np.clip(intensity / MOST, 1e-3, 1 - 1e-3)
    return np.log(share / (1 - share))


def deviation(intensity: Array) -> Array:
    """Standard deviations from the usual intensity; inverse of the curve of the labels."""
    xp = library(intensity)
    share = xp.clip((intensity - FAINTEST) / (1 - FAINTEST), 1e-3, 1 - 1e-3)
    return xp.log(share / (1 - share)) / STEEPNESS


def limited(display: Array) -> Array:
    """Display within `MOST_DISPLAY`."""
    return MOST_DISPLAY * library(display).tanh(display / MOST_DISPLAY)


def _display(network: Array, prosody: Prosody, speaking: Array) -> Array:
    """Standard deviations of every frame about its phrase's mean, limited."""
    xp = library(network)
    deepest = percentile(prosody.level, 95, speaking) - DEEPEST_DB
    z = NETWORK_SHARE * _centred(deviation(network), speaking)
    z = z + LEVEL_SHARE / LEVEL_DB * _centred(xp.maximum(prosody.level, deepest), speaking)
    toned = prosody.voiced & speaking & (prosody.tilt < BRIGHTEST_DB)
    middle = percentile(prosody.pitch, 50, toned)
    toned = toned & (xp.abs(prosody.pitch - middle) <= FURTHEST_SEMITONES)
    is_enough = as_index(toned).sum() >= FEWEST_VOICED
    for track, unit in ((prosody.pitch, PITCH_SEMITONES), (prosody.tilt, TILT_DB)):
        tone = xp.clip((track - mean_of(track, toned)) / unit, -MOST_TONE, MOST_TONE)
        z = z + is_enough * TONE_SHARE * _mean_beside(tone, toned)
    z, phrases = limited(z), Phrases(speaking)
    return z - phrases.inside * phrases.mean(z)


class Phrases:
    """Phrases of frames of speech (T,), arrays or tensors: speech between pauses.

    Attributes
    ----------
    inside : array or Tensor of bool [shape=(T,)]
        Frames within a phrase.
    """

    def __init__(self, speaking: Array) -> None:
        last, following = neighbours(speaking)
        is_short = (following - last - 1 <= PAUSE_FRAMES) & (last >= 0) & (following < FAR)
        self.speaking, self.inside = speaking, speaking | is_short
        beside = padded(self.inside, 1, 1)
        starts, ends = (self.inside & ~part for part in (beside[:-2], beside[2:]))
        xp, end = library(speaking), speaking.shape[0] - 1
        self._start = xp.clip(neighbours(starts)[0], 0, end)
        self._stop = xp.clip(neighbours(ends)[1], None, end) + 1

    def sums(self, values: Array) -> Array:
        """Sum of the values (T,) at the speech of each frame's phrase."""
        total = join((precise(0 * values[:1]), precise(values * self.speaking).cumsum(0)))
        return total[self._stop] - total[self._start]

    def mean(self, values: Array) -> Array:
        """Their mean [shape=(T,)]."""
        count = library(self.speaking).clip(self.sums(self.speaking * 1.0), 1, None)
        return self.sums(values) / count


def _centred(track: Array, used: Array) -> Array:
    """A track smoothed over some frames, less its mean over them."""
    beside = _mean_beside(track, used)
    return beside - mean_of(beside, used)


def _mean_beside(track: Array, used: Array) -> Array:
    """Gaussian mean over some frames; 0 far from them."""
    xp, number = library(track), as_number(used)
    weight, total = smoothed(number, SMOOTHING_FRAMES), smoothed(number * track, SMOOTHING_FRAMES)
    return xp.where(weight > 1e-3, total / xp.clip(weight, 1e-3, None), 0.0)
