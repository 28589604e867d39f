"""State of feeling of a voice, its display, and gates of mouth and expression in silence.

The model, for a recording that is known and, in `deitalk.live`, for a voice that has not ended::

    intensity = MOST / (1 + exp(-(state + display)))
    shown expression = share * intensity * pose of the emotion

The *state* is slow. In speech it is the strength of the phrase at any gain (`Speech.strengths`), in
a pause that of the phrase before, which passes into that of the phrase after. It is linear in
decibels and has no bound: a shout is stronger than a loud voice, and `MOST`, which no voice
reaches, is above 1. The *display* is what a listener sees change within a phrase: level, pitch,
tilt and the network's prediction about their means. It is small, has a mean of 0 in each phrase,
and ends with the voice.

The intensity that is felt is that of the voice, but for sadness, in which people are quieter
(`felt_intensity`); the mouth opens by that of the voice.

The *share* is 1 in speech. It rises over the half second before speech, decays over seconds after
it to the share that stays in silence (`Acting.rest`), and goes to 0 where speech is far, so that a
face is at rest in its emotion before and after it speaks. An intensity curve or keyframes of the
emotion are shown as drawn: their share is 1. The mouth has a gate of its own and is shut in
silence.

Not in the paper: DEITalk's saliency compares a frame with its own clip, not a clip with others. In
silence inside a speech the paper keeps "subtle emotions", by its positional encoding.

The numbers were chosen on training and validation actors, validation readers, and actors of another
corpus; MODEL_CARD.md has the scores of test actors.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from deitalk.audio.frames import runs
from deitalk.audio.prosody import (
    LEVEL_DB,
    PITCH_SEMITONES,
    TILT_DB,
    Prosody,
)
from deitalk.config.rules import Gates, VoiceIntensity
from deitalk.emotions import LABELS
from rig.arrays import AnyFloat, Bool, Float32, Float64, Int64
from rig.curves.edit import gaussian_smooth

FAINTEST, STEEPNESS = 0.15, 1.3
"""Lowest intensity that a network is taught, and its slope per standard deviation of liveliness,
as in the training corpus."""
READY_FRAMES = 3
"""Frames before speech (0.1 s) at which the whole expression is there."""
MOST = 1.2
"""Intensity that the strongest voice approaches."""
SMOOTHING_FRAMES = 6.0
"""Sigma, 0.2 s: the display does not follow single syllables."""
MOST_DISPLAY = 3.0
"""Limit of the standard deviations of the display."""
SAD, QUIETER_DB = LABELS.index("sad"), 6.0
"""Decibels by which people are quieter in sadness, which is no weakness of it."""
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


# Shares of the motion that are shown, from the distances to speech.


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


def expression_share(activity: npt.ArrayLike, rest: float, gates: Gates = Gates()) -> Float32:
    """Share of the expression shown at each frame: 1 in speech, `rest` in silence, 0 far from it.

    Parameters
    ----------
    activity, gates
        As for `mouth_gate`.
    rest : float
        Share that stays in silence, 0 to 1.

    Returns
    -------
    array [shape=(T,), range 0 to 1]
    """
    since, until = _distances(activity)
    return np.maximum(expression_after(since, until, rest, gates), _rising(until, gates))


def mouth_between(since: Float32, until: Float32, gates: Gates, ahead: int = 999) -> Float32:
    """Mouth gate so many frames after the last speech and before the next [shape=(T,) each].

    It opens no earlier than `ahead` frames before speech.
    """
    opens = min(gates.mouth_opens, ahead)
    return np.maximum(fade(since / (gates.mouth_closes + 1)), fade(until / (opens + 1)))


def expression_after(
    since: Float32, until: Float32, rest: AnyFloat | float, gates: Gates
) -> Float32:
    """Share of the expression that stays after speech: its decay to `rest`, and to 0 far from any.

    Parameters
    ----------
    since, until : array
        Frames since the last speech and until the next.
    rest : float or array
        Share that stays in silence.
    gates : Gates
        Frames of the decay.
    """
    kept = rest + (1 - np.asarray(rest)) * np.exp(-since / gates.feeling_decays)
    beyond = np.minimum(since, until) - gates.feeling_leaves
    return np.asarray(kept * fade(beyond / (2 * gates.feeling_decays)), np.float32)


def _rising(until: Float32, gates: Gates) -> Float32:
    """Share of the expression so many frames before speech."""
    return fade((until - READY_FRAMES) / (gates.feeling_rises + 1))


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


# State and display.


def voice_intensity(
    network: Float32,
    prosody: Prosody,
    activity: Float32,
    strength: Float32 | float = 0.0,
    rule: VoiceIntensity = VoiceIntensity(),
) -> Float32:
    """Intensity of every frame, of the strength of the voice, its prosody and the network.

    Parameters
    ----------
    network : array [shape=(T,), range 0 to 1]
        Predicted by the network.
    prosody : Prosody
        Of the same T frames, from `deitalk.audio.prosody.measure_prosody`.
    activity : array [shape=(T,)]
        From `deitalk.audio.voice_activity.speech_activity`.
    strength : float or array [shape=(T,)]
        Of the voice around each frame, dB above the usual (`Speech.strengths`).
    rule : VoiceIntensity
        Weights.

    Returns
    -------
    array [shape=(T,), range 0 to 1.2]
        That of a usual voice where nobody speaks at all.
    """
    speaking = activity > 0
    state = np.broadcast_to(state_of(strength, rule), network.shape)
    if not speaking.any():
        return intensity_of(np.zeros(network.shape) + state_of(0.0, rule))
    held = np.interp(np.arange(len(state)), np.flatnonzero(speaking), state[speaking])
    near = np.minimum(2 * gaussian_smooth(speaking.astype(float), SMOOTHING_FRAMES), 1)
    return intensity_of(held + rule.display * near * _display(network, prosody, speaking))


def state_of(strength: Float32 | Float64 | float, rule: VoiceIntensity) -> Float64:
    """State of a voice of a strength in dB."""
    state: Float64 = rule.per_decibel * (np.asarray(strength, np.float64) - rule.middle)
    return state


def intensity_of(state: Float64) -> Float32:
    """Intensity of a state with its display."""
    return np.asarray(MOST / (1 + np.exp(-state)), np.float32)


def felt_intensity(voice: Any, weights: Any, rule: VoiceIntensity) -> Any:
    """Intensity of the emotion that a voice is acted in: a quiet voice may be very sad.

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
    more = (math.exp(rule.per_decibel * QUIETER_DB) - 1) * weights[..., SAD]
    return MOST * (1 + more) * voice / (MOST + more * voice)


def state_of_intensity(intensity: float) -> float:
    """State without a display of an intensity; inverse of `intensity_of`."""
    share = min(max(float(intensity) / MOST, 1e-3), 1 - 1e-3)
    return math.log(share / (1 - share))


def deviation(intensity: Float32) -> Float64:
    """Standard deviations from the usual intensity; inverse of the curve of the labels."""
    share = np.clip((intensity.astype(float) - FAINTEST) / (1 - FAINTEST), 1e-3, 1 - 1e-3)
    z: Float64 = np.log(share / (1 - share)) / STEEPNESS
    return z


def limited(display: Float64) -> Float64:
    """Display within `MOST_DISPLAY`."""
    found: Float64 = MOST_DISPLAY * np.tanh(display / MOST_DISPLAY)
    return found


def _display(network: Float32, prosody: Prosody, speaking: Bool) -> Float64:
    """Standard deviations of every frame about the take's mean, limited."""
    level = np.maximum(prosody.level, np.percentile(prosody.level[speaking], 95) - DEEPEST_DB)
    z = NETWORK_SHARE * _centred(deviation(network), speaking)
    z = z + LEVEL_SHARE * _centred(level, speaking) / LEVEL_DB
    voiced = prosody.voiced & speaking & (prosody.tilt < BRIGHTEST_DB)
    if voiced.any():
        near = np.abs(prosody.pitch - np.median(prosody.pitch[voiced])) <= FURTHEST_SEMITONES
        voiced &= near
    if voiced.sum() >= FEWEST_VOICED:
        for track, unit in ((prosody.pitch, PITCH_SEMITONES), (prosody.tilt, TILT_DB)):
            tone = np.clip((track - track[voiced].mean()) / unit, -MOST_TONE, MOST_TONE)
            z = z + TONE_SHARE * _smoothed(tone, voiced)
    z = limited(z)
    for start, stop in phrases(speaking):
        z[start:stop] -= z[start:stop][speaking[start:stop]].mean()
    return z


def phrases(speaking: Bool) -> Int64:
    """[start, stop) of every phrase [shape=(n, 2)]: speech between pauses."""
    found = runs(speaking)
    if not len(found):
        return found
    is_pause = found[1:, 0] - found[:-1, 1] > PAUSE_FRAMES
    starts, stops = found[np.append(True, is_pause), 0], found[np.append(is_pause, True), 1]
    return np.stack((starts, stops), axis=1)


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
