"""Turn and shift of the head on the voice.

- Nods on stressed syllables and with level and pitch (Hadar et al. 1983; Munhall et al. 2004; Graf
  et al. 2002), lowering at the end of a phrase and a raise at the start of the next one (McClave
  2000), stillness in pauses, where the breath lifts head and shoulders a little.
- An emotion has a posture and a liveliness: sadness lowers and tilts the head, anger lowers and
  advances it, surprise draws it back (Coulson 2004); motion is wider and faster in happiness and
  anger, and smaller in sadness, than in neutral speech (Busso et al. 2007).
- `NODS` and `SWAY` are set so that range and speed of a neutral take are those of six readers on
  video (docs/life.md).

The track has six columns (`rig.curves.HEAD`): yaw to the character's right, pitch up, roll to the
right shoulder, degrees, the signs of Unreal's rotators; then the shift in cm to the character's
left, up and forward, the axes of the embedded head.

Letters: T frames at 30 per second.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import EMOTIONS
from deitalk.postprocess.life.tracks import presence, slow_noise, swell
from deitalk.postprocess.life.traits import Traits
from deitalk.postprocess.life.voice import Voice
from rig.arrays import Float32, Float64
from rig.curves.filters import gaussian_smooth

NODS = (0.4, 1.6, 0.3)
"""Largest yaw, pitch and roll of an accent, degrees."""
NOD_SECONDS = ((0.16, 0.26), (0.22, 0.45))
"""Attack and decay."""
NOD_LAG = 0.04
"""The nod is lowest so long after the peak of the accent, seconds."""
DOWN_SHARE = 0.75
"""Share of the accents with a nod; the others raise the head."""
LISTENING_SECONDS = 3.0
"""Silence of at least so long is a turn of the other: single and double nods, six seconds apart on
the average (Dittmann and Llewellyn 1968)."""
SWAY, SWAY_SECONDS = (0.28, 0.5, 0.2), 0.45
STIR, STIR_SECONDS = (0.5, 0.82, 0.34), 0.14
"""Standard deviation of slow and of quick turns, yaw, pitch and roll in degrees, and the sigma of
the Gaussian that their noise is smoothed with."""
QUIET = 0.5
"""Share of the sway that is left in a pause."""
FINAL_DEGREES, INITIAL_DEGREES = -0.8, 0.5
"""Pitch at the end and at the start of a phrase."""
BREATH_SECONDS, BREATH_CM, BREATH_DEGREES = 4.0, 0.05, 0.15
"""Period of quiet breathing, its lift, and the pitch that goes with it."""
INHALE_CM, INHALE_DEGREES = 0.14, 0.35
"""The same in a pause of at least 0.3 s before a phrase."""
SHIFT_CM = (0.07, 0.05, 0.1)
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
    motion[:, :3] = _sway(voice, rng) + _nods(voice, rng)
    motion[:, 1] += _phrases(voice)
    motion[:, 3:] = np.asarray(SHIFT_CM) * _noises(n_frames, 3, 0.8, rng)
    lift = _breath(voice, rng)
    motion[:, 4] += lift[:, 0]
    motion[:, 1] += lift[:, 1]
    calm = np.maximum(1 - mixture[:, 1:].sum(axis=1), 0)
    lively = np.array([LIVELINESS[name] for name in EMOTIONS])
    motion *= (calm + mixture[:, 1:] @ lively[1:])[:, None] * traits.head_range
    side = np.array([1, 1, 1 if traits.side >= 0 else -1, 1, 1, 1])
    held = mixture @ np.array([POSTURE[name] for name in EMOTIONS]) * side
    shown = presence(n_frames)[:, None]
    posture = _smooth(held) * shown
    return (motion * shown).astype(np.float32), posture.astype(np.float32)


def _sway(voice: Voice, rng: np.random.Generator) -> Float64:
    """Slow and quick turns, smaller in pauses [shape=(T, 3)]."""
    speaking = _smooth(voice.speaking[:, None])
    slow = np.asarray(SWAY) * _noises(voice.n_frames, 3, SWAY_SECONDS, rng)
    quick = np.asarray(STIR) * _noises(voice.n_frames, 3, STIR_SECONDS, rng)
    return (slow + quick) * (QUIET + (1 - QUIET) * speaking)


def _nods(voice: Voice, rng: np.random.Generator) -> Float64:
    """Nods of accents [shape=(T, 3)]."""
    nods = np.zeros((voice.n_frames, 3))
    for accent in voice.accents:
        peak = accent.frame / FRAME_RATE + NOD_LAG + 0.03 * rng.standard_normal()
        times = (rng.uniform(*seconds) for seconds in NOD_SECONDS)
        span, shape = swell(voice.n_frames, peak, *times)
        sign = -1.0 if rng.random() < DOWN_SHARE else 0.6
        height = (0.2 + 0.8 * accent.strength) * rng.uniform(0.6, 1.4)
        aside = rng.normal(0, 0.6, 2)
        nods[span] += height * shape[:, None] * np.array([aside[0], sign, aside[1]])
    for start, stop in voice.pauses(LISTENING_SECONDS):
        time = start / FRAME_RATE + rng.exponential(LISTENING_SECONDS)
        while time < stop / FRAME_RATE - 1:
            for beat in range(int(rng.integers(1, 3))):
                span, shape = swell(voice.n_frames, time + 0.45 * beat, 0.25, 0.35)
                nods[span, 1] -= rng.uniform(0.5, 1.0) * shape
            time += LISTENING_SECONDS + rng.exponential(LISTENING_SECONDS)
    return np.asarray(NODS) * nods


def _phrases(voice: Voice) -> Float64:
    """Pitch of the ends and starts of phrases [shape=(T,)], degrees."""
    pitch = np.zeros(voice.n_frames)
    for phrase in voice.phrases:
        seconds = (phrase.stop - phrase.start) / FRAME_RATE
        slope = min(0.7, seconds / 2)
        final = -0.5 * FINAL_DEGREES if phrase.is_question else FINAL_DEGREES
        end, start = phrase.stop / FRAME_RATE, phrase.start / FRAME_RATE
        for degrees, swelling in (
            (final, swell(voice.n_frames, end, slope, 0.8, 0.1)),
            (INITIAL_DEGREES, swell(voice.n_frames, start + 0.1, 0.35, slope)),
        ):
            span, shape = swelling
            pitch[span] += degrees * shape
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
