"""Turn and shift of the head on the voice.

- Nods on stressed syllables, deeper where level and pitch are high (Hadar et al. 1983; Munhall et
  al. 2004; Graf et al. 2002), lowering at the end of a phrase and a raise before the next one
  (McClave 2000), stillness in pauses, where the breath lifts head and shoulders a little.
- An emotion has a posture and a liveliness: sadness lowers and tilts the head, anger lowers and
  advances it, surprise draws it back (Coulson 2004); motion is wider and faster in happiness and
  anger, and smaller in sadness, than in neutral speech (Busso et al. 2007).
- `NODS`, `SWAY` and `STIR` are set so that range and speed of a neutral take, and the correlation
  of its pitch with stressed syllables, are those of six readers on video (docs/life.md).

The track has six columns (`rig.curves.HEAD`): yaw to the character's right, pitch up, roll to the
right shoulder, degrees, the signs of Unreal's rotators; then the shift in cm to the character's
left, up and forward, the axes of the embedded head.

Letters: T frames at 30 per second.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import EMOTIONS, by_emotion
from deitalk.postprocess.life.tracks import presence, slow_noise, swell
from deitalk.postprocess.life.traits import Traits
from deitalk.postprocess.life.voice import Voice
from rig.arrays import Float32, Float64
from rig.curves.filters import gaussian_smooth

NODS = (0.26, 1.8, 0.26)
"""Turn of a full nod, degrees: its pitch, and the standard deviation of its yaw and roll."""
NOD_SECONDS = ((0.13, 0.2), (0.15, 0.24))
"""Attack and decay."""
NOD_SPEED = 15.0
"""Degrees per second: a nod that would go down faster takes longer and is less deep. The fastest
moments of six readers' pitch are of 7 to 28 (mean 17)."""
NOD_LAG, NOD_SPREAD = 0.03, 0.015
"""Seconds from the peak of the syllable to the lowest point, and their standard deviation."""
NOD_SHARE, ASIDE_SHARE, UP_SHARE = (0.78, 0.2), 0.06, 0.05
"""Share of the stressed syllables with a nod: of the weakest, and more of the strongest. Of these
the share that turns or tilts the head instead (McClave 2000), and that raises it."""
TURN, TURN_SECONDS = ((2.2, 0.4, 0.5), (0.5, 0.4, 1.7)), ((0.35, 0.6), (0.5, 1.0))
"""Yaw, pitch and roll of a full turn and of a full tilt; attack and decay."""
MOST_ASIDE = 1.2
"""Height of the largest turn or tilt."""
VIGOUR, VIGOUR_SECONDS = 0.35, 1.6
"""A speaker moves the head in phases: standard deviation of the logarithm of the factor on nods and
slow turns, and the sigma of the Gaussian that its noise is smoothed with."""
LEAST_NOD, HIGH_NOD = 0.5, 0.3
"""Height of the nod of the weakest stress, and what a prominence of 1 adds to any."""
NOD_RAISE = 0.4
"""Pitch from which a speaker nods, degrees: about the mean of the nods."""
LISTENING_SECONDS = 3.0
"""Silence of at least so long is a turn of the other: single and double nods, six seconds apart on
the average (Dittmann and Llewellyn 1968)."""
LISTENING_DEGREES = (0.8, 1.6)
SWAY, SWAY_SECONDS = (0.25, 0.7, 0.2), 0.7
STIR, STIR_SECONDS = (0.46, 0.28, 0.3), 0.14
"""Standard deviation of slow and of quick turns, yaw, pitch and roll in degrees, and the sigma of
the Gaussian that their noise is smoothed with."""
QUIET = 0.5
"""Share of the sway that is left in a pause."""
FINAL_DEGREES, INITIAL_DEGREES = -0.8, 0.5
"""Pitch at the end and before the start of a phrase."""
FINAL_SECONDS, INITIAL_SECONDS = (1.0, 0.1, 1.2), (0.6, 0.0, 0.8)
"""Attack, hold and decay."""
INITIAL_LEAD = 0.2
"""The raise is highest so long before a phrase, seconds."""
BREATH_SECONDS, BREATH_CM, BREATH_DEGREES = 4.0, 0.05, 0.15
"""Period of quiet breathing, its lift, and the pitch that goes with it."""
INHALE_CM, INHALE_DEGREES = 0.14, 0.35
"""The same in a pause of at least 0.3 s before a phrase."""
SHIFT_CM, SHIFT_SECONDS = (0.07, 0.05, 0.1), 0.8
POSTURE: dict[str, tuple[float, ...]] = {
    "neutral": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "angry": (0.0, -3.0, 0.0, 0.0, -0.1, 0.8),
    "happy": (0.0, 1.0, 1.5, 0.0, 0.1, 0.1),
    "sad": (0.0, -4.5, 2.5, 0.0, -0.3, -0.1),
    "surprised": (0.0, 2.5, 0.0, 0.0, 0.15, -0.7),
}
"""Held turn and shift of an emotion at intensity 1; its roll goes to the character's own side."""
LIVELINESS = {"neutral": 1.0, "angry": 1.35, "happy": 1.4, "sad": 0.85, "surprised": 1.25}
POSTURE_SECONDS = 0.35
"""Sigma of the Gaussian over which a posture comes and goes."""


class Nod(NamedTuple):
    """A nod of one syllable."""

    lag: float
    """Seconds from the peak of the syllable to the lowest point."""
    attack: float
    """Seconds down."""
    decay: float
    """Seconds up."""
    degrees: Float64
    """Yaw, pitch and roll at the lowest point [shape=(3,)]; 0 where the syllable has no nod."""

    def scaled(self, factor: float) -> "Nod":
        """So much deeper; where that is faster than `NOD_SPEED`, longer and less deep."""
        degrees = factor * self.degrees
        fastest = 0.5 * np.pi * abs(float(degrees[1])) / self.attack
        share = max(fastest / NOD_SPEED, 1.0) ** 0.5
        return Nod(self.lag, share * self.attack, share * self.decay, degrees / share)


def head_motion(
    voice: Voice, traits: Traits, mixture: Float32, rng: np.random.Generator
) -> tuple[Float32, Float32]:
    """Motion of the head, and the posture that is held beneath it.

    Parameters
    ----------
    voice : Voice
        Of the recording.
    traits : Traits
        Of the character.
    mixture : array [shape=(T, S)]
        Emotion shown at each frame: weights times intensity.
    rng : numpy.random.Generator
        Equal generators give equal motion.

    Returns
    -------
    motion, posture : arrays [shape=(T, 6)]
        Degrees and cm; their sum is the track. At rest in the first and the last frame.
    """
    n_frames = voice.n_frames
    motion = np.zeros((n_frames, 6))
    vigour = np.exp(VIGOUR * slow_noise(n_frames, VIGOUR_SECONDS, rng))
    motion[:, :3] = _sway(voice, vigour, rng) + _nods(voice, vigour, rng)
    motion[:, 1] += _phrases(voice)
    motion[:, 3:] = np.asarray(SHIFT_CM) * _noises(n_frames, 3, SHIFT_SECONDS, rng)
    lift = _breath(voice, rng)
    motion[:, 4] += lift[:, 0]
    motion[:, 1] += lift[:, 1]
    calm = np.maximum(1 - mixture[:, 1:].sum(axis=1), 0)
    lively = np.array([LIVELINESS.get(name, 1.0) for name in EMOTIONS])
    motion *= (calm + mixture[:, 1:] @ lively[1:])[:, None] * traits.head_range
    side = np.array([1, 1, 1 if traits.side >= 0 else -1, 1, 1, 1])
    held = mixture @ by_emotion(POSTURE) * side
    shown = presence(n_frames, voice.silence)[:, None]
    posture = _smooth(held) * shown
    return (motion * shown).astype(np.float32), posture.astype(np.float32)


def _sway(voice: Voice, vigour: Float64, rng: np.random.Generator) -> Float64:
    """Slow and quick turns, smaller in pauses [shape=(T, 3)]."""
    speaking = _smooth(voice.speaking[:, None])
    slow = np.asarray(SWAY) * _noises(voice.n_frames, 3, SWAY_SECONDS, rng)
    quick = np.asarray(STIR) * _noises(voice.n_frames, 3, STIR_SECONDS, rng)
    return (slow * vigour[:, None] + quick) * (QUIET + (1 - QUIET) * speaking)


def _nods(voice: Voice, vigour: Float64, rng: np.random.Generator) -> Float64:
    """Nods of stressed syllables, and in long silences [shape=(T, 3)], degrees."""
    nods = np.zeros((voice.n_frames, 3))
    for stress in voice.stresses:
        nod = draw_nod(stress.strength, float(voice.prominence[stress.frame]), rng)
        nod = nod.scaled(float(vigour[stress.frame]))
        peak = stress.frame / FRAME_RATE + nod.lag
        span, shape = swell(voice.n_frames, peak, nod.attack, nod.decay)
        nods[span] += shape[:, None] * nod.degrees
    for start, stop in voice.pauses(LISTENING_SECONDS):
        time = start / FRAME_RATE + rng.exponential(LISTENING_SECONDS)
        while time < stop / FRAME_RATE - 1:
            for beat in range(int(rng.integers(1, 3))):
                span, shape = swell(voice.n_frames, time + 0.45 * beat, 0.25, 0.35)
                nods[span, 1] -= rng.uniform(*LISTENING_DEGREES) * shape
            time += LISTENING_SECONDS + rng.exponential(LISTENING_SECONDS)
    return nods


def draw_nod(strength: float, prominence: float, rng: np.random.Generator) -> Nod:
    """Draw the nod of a stressed syllable.

    Parameters
    ----------
    strength : float, range 0 to 1
        Of the stress.
    prominence : float
        Level and pitch of the syllable, as in `Voice`.
    rng : numpy.random.Generator
        Gives nine numbers, whatever they are.
    """
    lag = NOD_LAG + NOD_SPREAD * rng.standard_normal()
    height = LEAST_NOD + (1 - LEAST_NOD) * strength
    height *= (1 + HIGH_NOD * min(max(prominence, 0.0), 2.0)) * rng.uniform(0.5, 1.5)
    height *= rng.random() < NOD_SHARE[0] + NOD_SHARE[1] * strength
    quick, slow, kind = rng.random(3)
    aside = rng.standard_normal(2)
    sign = 1.0 if rng.random() < 0.5 else -1.0
    is_aside = kind < ASIDE_SHARE
    attack, decay = (
        low + share * (high - low)
        for (low, high), share in zip(
            TURN_SECONDS if is_aside else NOD_SECONDS, (quick, slow), strict=True
        )
    )
    if is_aside:
        yaw, pitch, roll = TURN[int(kind < ASIDE_SHARE / 2)]
        degrees = np.array([sign * yaw, -pitch, sign * roll]) / max(height / MOST_ASIDE, 1)
    else:
        up = 0.7 if kind > 1 - UP_SHARE else -1.0
        degrees = np.asarray(NODS) * np.array([aside[0], up, aside[1]])
    return Nod(lag, attack, decay, height * degrees)


def _phrases(voice: Voice) -> Float64:
    """Pitch of phrases, of their ends and of their starts [shape=(T,)], degrees."""
    pitch = NOD_RAISE * _smooth(voice.speaking[:, None])[:, 0]
    for phrase in voice.phrases:
        longest = (phrase.stop - phrase.start) / FRAME_RATE / 2
        final = -0.5 * FINAL_DEGREES if phrase.is_question else FINAL_DEGREES
        attack, hold, decay = FINAL_SECONDS
        span, shape = swell(
            voice.n_frames, phrase.stop / FRAME_RATE, min(attack, longest), decay, hold
        )
        pitch[span] += final * shape
        attack, hold, decay = INITIAL_SECONDS
        before = phrase.start / FRAME_RATE - INITIAL_LEAD
        span, shape = swell(voice.n_frames, before, attack, min(decay, longest), hold)
        pitch[span] += INITIAL_DEGREES * shape
    return pitch


def _breath(voice: Voice, rng: np.random.Generator) -> Float64:
    """Lift in cm and pitch in degrees of the breath [shape=(T, 2)]."""
    time = np.arange(voice.n_frames) / FRAME_RATE
    phase = 2 * np.pi * (time / BREATH_SECONDS + rng.random())
    phase += 0.6 * slow_noise(voice.n_frames, 1.5, rng)
    quiet = np.sin(phase) * (1 - 0.7 * _smooth(voice.speaking[:, None])[:, 0])
    lift = np.outer(quiet, (BREATH_CM, BREATH_DEGREES))
    for _, stop in voice.pauses():
        if stop < voice.n_frames:
            span, rise = swell(voice.n_frames, stop / FRAME_RATE - 0.05, 0.35, 1.2)
            lift[span] += np.outer(rise, (INHALE_CM, INHALE_DEGREES))
    return lift


def _noises(n_frames: int, count: int, seconds: float, rng: np.random.Generator) -> Float64:
    return np.stack([slow_noise(n_frames, seconds, rng) for _ in range(count)], axis=1)


def _smooth(track: Float32 | Float64) -> Float64:
    """Smoothed over a posture's time along the frames."""
    sigma = POSTURE_SECONDS * FRAME_RATE
    columns = [gaussian_smooth(column, sigma, "mirror") for column in track.T.astype(np.float64)]
    return np.stack(columns, axis=1)
