"""Accents of brows, lids and cheeks of a voice that has not ended.

The causal form of `deitalk.postprocess.life.brows`. An accent is a peak of level and pitch over
their means so far, which is known a frame or two after it; the look-ahead of the curves makes up
for that, and the brows begin to rise near the accent instead of before it. Questions, which end
with their rise, are not known in time.

Letters: n frames of a call, K stems of control names.
"""

import math

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.prosody import LEVEL_DB, PITCH_SEMITONES, VOICED
from deitalk.config import Idle
from deitalk.live.intensity import Mean, Measures
from deitalk.postprocess.life.brows import (
    ATTACK_SECONDS,
    DECAY_SECONDS,
    DRIFT,
    DRIFT_SECONDS,
    EVENT_SIDE,
    HOLD_SECONDS,
    TAKEN_SHARE,
    BrowEvents,
    move_brows,
)
from deitalk.postprocess.life.motion import MOST_SHOWN
from deitalk.postprocess.life.tracks import RISE_SECONDS
from deitalk.postprocess.life.traits import Traits
from deitalk.postprocess.life.voice import ACCENT_DISTANCE, FULL_PROMINENCE, LEAST_PROMINENCE
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64
from rig.controls import DEFAULT_ID

SMOOTHING = 0.4
"""Share of a new frame in level and pitch, which smooths over a syllable."""
KEPT = math.exp(-1 / (DRIFT_SECONDS * FRAME_RATE))
"""Of the drift from frame to frame: noise through two such filters, one after the other."""
SCALE = np.array(DRIFT) * math.sqrt((1 - KEPT**2) ** 3 / (1 + KEPT**2))
"""Standard deviation of the noise, for a drift of `DRIFT`."""
PART = 3
"""Of the stream's seed: the random numbers of this part."""


class RunningAccents:
    """Accents of one stream, frame by frame."""

    def __init__(self) -> None:
        self.level, self.pitch = Mean(), Mean()
        self.value = self.before = self.valley = 0.0
        self.since = ACCENT_DISTANCE

    def next(self, level: float, pitch: float, periodicity: float, speaks: bool) -> float:
        """Strength of an accent that was at the frame before, 0 to 1; 0 if there was none."""
        target = 0.0
        if speaks:
            target = self.level.add(level) / LEVEL_DB
            if periodicity > VOICED:
                target += self.pitch.add(pitch) / PITCH_SEMITONES
        last = self.value
        self.value += SMOOTHING * (max(-3.0, min(3.0, target / 2**0.5)) - self.value)
        rise, is_peak = last - self.valley, self.before < last > self.value
        self.before, self.since = last, self.since + 1
        self.valley = min(self.valley, self.value)
        if not is_peak or self.since < ACCENT_DISTANCE or rise < LEAST_PROMINENCE:
            return 0.0
        self.valley, self.since = self.value, 0
        return min(rise / FULL_PROMINENCE, 1.0)


class RunningBrows:
    """Motion of one stream above the eyes.

    Parameters
    ----------
    controls : ControlSet
        Columns of the curves; a rig other than the board stays still.
    idle : Idle
        Its factor of the brows.
    seed : int
        Equal seeds give equal motion.
    ahead : int
        Frames measured before a frame's curves are given.
    """

    def __init__(self, controls: ControlSet, idle: Idle, seed: int, ahead: int) -> None:
        self.controls, self.amount = controls, idle.brows
        self.moves = bool(idle.brows) and controls.id == DEFAULT_ID
        events, drift, character = np.random.default_rng([seed, PART]).spawn(3)
        self.events, self.noise, self.traits = events, drift, Traits.of(character)
        self.accents, self.n_frames = RunningAccents(), -ahead
        self.swells: list[tuple[float, tuple[float, float, float], Float64]] = []
        self.rows: list[tuple[Float64, Float64]] = []
        self.drift = np.zeros((2, len(DRIFT)))

    def feed(self, measures: Measures, speaking: Bool) -> None:
        """Take the voice of the next frames [shape=(n,)]."""
        if not self.moves:
            return
        rows = zip(measures.level, measures.pitch, measures.periodicity, speaking, strict=True)
        for level, pitch, periodicity, speaks in rows:
            strength = self.accents.next(level, pitch, periodicity, bool(speaks))
            time = self.n_frames / FRAME_RATE
            if strength:
                self._begin(time, strength)
            if self.n_frames >= 0:
                self.rows.append(self._row(time))
            self.n_frames += 1

    def add_to(self, curves: Float32, neutral: Float32, mixture: Float32) -> None:
        """Add the motion of the next frames, in place.

        Parameters
        ----------
        curves, neutral : array [shape=(n, C)]
            The face that is shown, and the network's neutral reading.
        mixture : array [shape=(n, S)]
            Emotion shown: weights times intensity.
        """
        if not self.moves or not len(curves):
            return
        rows, self.rows = self.rows[: len(curves)], self.rows[len(curves) :]
        accents, drift = (np.array(part) for part in zip(*rows, strict=True))
        events = BrowEvents(accents, np.zeros(len(curves)), drift)
        shown = np.minimum(mixture, MOST_SHOWN)
        side = self.traits.side
        move_brows(curves, neutral, self.controls, events, shown, side, self.amount)

    def _begin(self, time: float, strength: float) -> None:
        """Draw the motion of an accent."""
        is_taken = self.events.random() < TAKEN_SHARE[0] + TAKEN_SHARE[1] * strength
        spans = (ATTACK_SECONDS, HOLD_SECONDS, DECAY_SECONDS)
        attack, hold, decay = (float(self.events.uniform(*span)) for span in spans)
        height = (0.25 + 0.75 * strength) * self.events.uniform(0.7, 1.2)
        uneven = EVENT_SIDE * self.events.standard_normal()
        uneven = self.traits.side + float(np.clip(uneven, -0.15, 0.15))
        if is_taken:
            sides = height * np.array([1 + uneven / 2, 1 - uneven / 2])
            self.swells.append((time, (attack, hold, decay), sides))

    def _row(self, time: float) -> tuple[Float64, Float64]:
        """Swells of the left and the right, and the drift of each stem, at a time."""
        total: Float64 = np.zeros(2)
        for begin, times, sides in self.swells:
            total += _swelling(time - begin, *times) * sides
        self.swells = [s for s in self.swells if time < s[0] + sum(s[1])]
        self.drift[0] = KEPT * self.drift[0] + SCALE * self.noise.standard_normal(len(DRIFT))
        self.drift[1] = KEPT * self.drift[1] + self.drift[0]
        begun = min(time / RISE_SECONDS, 1.0)
        shown = begun * begun * (3 - 2 * begun)
        accents = self.traits.brow_range * (1 - np.exp(-total)) * shown
        return accents, self.drift[1] * shown


def _swelling(time: float, attack: float, hold: float, decay: float) -> float:
    """Rise to 1, hold and fall, in raised cosines."""
    rise = min(max(time / attack, 0.0), 1.0)
    fall = min(max(1 - (time - attack - hold) / decay, 0.0), 1.0)
    return 0.25 * (1 - math.cos(math.pi * rise)) * (1 - math.cos(math.pi * fall))
