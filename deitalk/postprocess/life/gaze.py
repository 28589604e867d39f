"""Gaze: fixations on a listener with micro-saccades, and aversions in thought.

- Speakers look away at the start of an utterance and in hesitations, and look back at its end
  (Kendon 1967); they think with the eyes averted (Glenberg et al. 1998; Doherty-Sneddon and Phelps
  2005). Aversions while speaking last about 2 s and come every 5 s (Andrist et al. 2014), some of
  them within long phrases; they are 5 to 12 degrees here, what a listener at a metre and a half
  sees as a look away, not a turn.
- A saccade of a degree a takes 2.2 a + 21 ms (Carpenter 1988): one or two frames.
- Micro-saccades of up to a degree, one or two a second (Rolfs 2009; Martinez-Conde et al. 2004);
  fixations of the listener's face last a third of a second to two.
- The eyes turn against the head, so that the gaze holds its target (vestibulo-ocular reflex).

Angles are degrees: to the character's left, and up. Letters: T frames at 30 per second.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.life.tracks import STILL_SECONDS
from deitalk.postprocess.life.voice import Voice
from rig.arrays import Float32, Float64

SIDE_DEGREES, UP_DEGREES, DOWN_DEGREES = 40.0, 30.0, 40.0
"""Turn of an eye for a control at 1 (`rig.conversion.arkit`)."""
AVERSION_DEGREES = (5.0, 12.0)
AVERSION_SECONDS = (1.4, 0.4)
"""Median, and sigma of the logarithm."""
START_SHARE, PAUSE_SHARE = 0.45, 0.6
"""How often the gaze is averted before a phrase that follows a pause, and in a pause."""
WITHIN_SECONDS, WITHIN_SHARE = (4.75, 1.4), 0.6
"""Seconds of speech from one place for an aversion within a phrase to the next (mean and standard
deviation, Andrist et al. 2014; 3 at least), and how often the gaze is averted there."""
LEAST_BETWEEN = 3.0
"""Seconds from the end of an aversion to the next one."""
FACE_DEGREES = (0.9, 0.7)
"""Standard deviation of the fixations on the listener's face, to the side and up."""
FIXATION_SECONDS = (0.75, 0.45)
MICRO_DEGREES, MICRO_PER_SECOND = 0.25, 1.3
BLINK_DEGREES, BLINK_SHARE = 4.5, 0.4
"""A shift from so many degrees brings a blink, so often."""
LID_SHARE = 0.12
"""Closure of the lids for a look straight down at the end of the range, besides the lids' own
following of the eyes in the rig (Becker and Fuchs 1988)."""


class Aversion(NamedTuple):
    """A look away."""

    start: float
    """Seconds."""
    stop: float
    side: float
    """Degrees to the character's left."""
    up: float


def plan_aversions(voice: Voice, rng: np.random.Generator, avoids: float = 0.0) -> list[Aversion]:
    """Draw the times and directions at which the gaze is averted.

    Parameters
    ----------
    voice : Voice
        Phrases and pauses of the recording.
    rng : numpy.random.Generator
        Equal generators give equal looks.
    avoids : float, range -1 to 1
        Preference for the character's left.
    """
    last = voice.n_frames / FRAME_RATE - STILL_SECONDS
    candidates = [(start / FRAME_RATE, PAUSE_SHARE) for start, _ in voice.pauses(0.45) if start]
    candidates += [(p.start / FRAME_RATE - 0.35, START_SHARE) for p in voice.phrases]
    for phrase in voice.phrases:
        time = phrase.start / FRAME_RATE + draw_wait(rng)
        while time < phrase.stop / FRAME_RATE - 0.5:
            candidates.append((time, WITHIN_SHARE))
            time += draw_wait(rng)
    aversions: list[Aversion] = []
    for time, share in sorted(candidates):
        start = max(time + rng.uniform(0, 0.3), 0.3)
        length = AVERSION_SECONDS[0] * np.exp(AVERSION_SECONDS[1] * rng.standard_normal())
        is_drawn, direction = rng.random() < share, draw_direction(rng, avoids)
        free = aversions[-1].stop + LEAST_BETWEEN if aversions else 0.0
        if is_drawn and start >= free and start + length < last:
            aversions.append(Aversion(start, start + float(length), *direction))
    return aversions


def draw_wait(rng: np.random.Generator) -> float:
    """Seconds of speech to the next place for an aversion within a phrase."""
    mean, spread = WITHIN_SECONDS
    return float(max(mean + spread * rng.standard_normal(), 3.0))


def draw_direction(rng: np.random.Generator, avoids: float) -> tuple[float, float]:
    """Degrees to the left and up of a look up and to a side in thought, or down and to a side."""
    size = rng.uniform(*AVERSION_DEGREES)
    elevation = np.radians(rng.choice((-1.0, 1.0), p=(0.55, 0.45)) * rng.uniform(5, 50))
    sign = 1.0 if rng.random() < 0.5 * (1 + avoids) else -1.0
    return float(sign * size * np.cos(elevation)), float(size * np.sin(elevation))


def gaze_degrees(
    n_frames: int, aversions: list[Aversion], rng: np.random.Generator
) -> tuple[Float32, list[float]]:
    """Direction of the gaze, and the times of the large shifts that bring a blink.

    Returns
    -------
    array [shape=(T, 2)]
        Degrees to the character's left and up, relative to the listener; 0 in the first 0.3 s and
        in the last half second.
    list of float
        Seconds.
    """
    end = n_frames / FRAME_RATE - STILL_SECONDS - 0.1
    times, targets = [0.0], [np.zeros(2)]
    time = 0.3 + rng.uniform(0, 0.4)
    pending = list(aversions)
    while time < end:
        away = pending[0] if pending and pending[0].start <= time + 0.05 else None
        if away is not None:
            pending.pop(0)
            time = _look_away(away, times, targets, rng)
            continue
        times.append(time)
        targets.append(rng.normal(0, FACE_DEGREES))
        step = FIXATION_SECONDS[0] * np.exp(FIXATION_SECONDS[1] * rng.standard_normal())
        following = pending[0].start if pending else np.inf
        time = min(time + max(step, 0.3), max(following, time + 1 / FRAME_RATE))
    times.append(max(end, times[-1] + 1 / FRAME_RATE))
    targets.append(np.zeros(2))
    steps = np.linalg.norm(np.diff(targets, axis=0), axis=1)
    shifts = [t for t, s in zip(times[1:], steps, strict=True) if s >= BLINK_DEGREES]
    blinking = [t for t in shifts if rng.random() < BLINK_SHARE]
    track = _saccades(n_frames, times, targets) + _micro(n_frames, end, rng)
    track[max(n_frames - int(STILL_SECONDS * FRAME_RATE), 0) :] = 0
    return track.astype(np.float32), blinking


def _look_away(
    away: Aversion, times: list[float], targets: list[Float64], rng: np.random.Generator
) -> float:
    """Append the fixations of an aversion; return its end."""
    time = max(away.start, times[-1] + 1 / FRAME_RATE)
    while time < away.stop:
        times.append(time)
        targets.append(np.array([away.side, away.up]) + rng.normal(0, 0.5, 2))
        time += rng.uniform(0.4, 1.1)
    return max(away.stop, times[-1] + 1 / FRAME_RATE)


def _saccades(n_frames: int, times: list[float], targets: list[Float64]) -> Float64:
    """Move from target to target by saccades [shape=(T, 2)]."""
    frames = np.arange(n_frames) / FRAME_RATE
    steps = np.diff(targets, axis=0, prepend=[targets[0]])
    lengths = 0.021 + 0.0022 * np.linalg.norm(steps, axis=1)
    now = np.searchsorted(times, frames, side="right") - 1
    left = 1 - np.clip((frames - np.asarray(times)[now]) / lengths[now], 0, 1)
    track: Float64 = np.asarray(targets)[now] - (left * left * (3 - 2 * left))[:, None] * steps[now]
    return track


def _micro(n_frames: int, end: float, rng: np.random.Generator) -> Float64:
    """Micro-saccades about a fixation [shape=(T, 2)]."""
    starts, places, frame = [0], [np.zeros(2)], 10.0
    while frame < end * FRAME_RATE:
        starts.append(int(frame))
        places.append(0.4 * places[-1] + rng.normal(0, MICRO_DEGREES, 2))
        frame += FRAME_RATE * max(rng.exponential(1 / MICRO_PER_SECOND), 0.15)
    starts.append(max(int(end * FRAME_RATE), starts[-1]))
    places.append(np.zeros(2))
    track: Float64 = np.asarray(places)[
        np.searchsorted(starts, np.arange(n_frames), side="right") - 1
    ]
    return track


def as_controls(degrees: Float32 | Float64) -> Float32:
    """Values of the controls ``eye.tx`` and ``eye.ty`` for degrees; both [shape=(T, 2)]."""
    side = degrees[:, 0] / SIDE_DEGREES
    up = degrees[:, 1] / np.where(degrees[:, 1] > 0, UP_DEGREES, DOWN_DEGREES)
    return np.stack([side, up], axis=1).astype(np.float32)
