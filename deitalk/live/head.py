"""Turn and shift of the head, and the neck, on a voice that has not ended.

The causal form of `deitalk.postprocess.life.head` and `neck`. Nods begin when the peak of a
syllable is known, and are lowest about 0.2 s after it. The end of a phrase is known late, and the
start of the next one not at all: the head sinks within the pause, the breath comes after 0.6 s of
it, and after 0.9 s the head rises and waits there for the next phrase.

Letters: n frames of a call, S styles.
"""

import math

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import EMOTIONS, by_emotion
from deitalk.live.tracks import RunningNoise, RunningSwells, begun
from deitalk.live.voice import VoiceRow
from deitalk.postprocess.life.head import (
    BREATH_CM,
    BREATH_DEGREES,
    BREATH_SECONDS,
    FINAL_DEGREES,
    INHALE_CM,
    INHALE_DEGREES,
    INITIAL_DEGREES,
    LISTENING_DEGREES,
    LISTENING_SECONDS,
    LIVELINESS,
    NOD_RAISE,
    POSTURE,
    POSTURE_SECONDS,
    QUIET,
    SHIFT_CM,
    SHIFT_SECONDS,
    STIR,
    STIR_SECONDS,
    SWAY,
    SWAY_SECONDS,
    VIGOUR,
    VIGOUR_SECONDS,
    draw_nod,
)
from deitalk.postprocess.life.neck import (
    INHALE,
    INHALE_SECONDS,
    LEAST_WAIT,
    SWALLOW,
    SWALLOW_EVERY,
    SWALLOW_PAUSE,
)
from deitalk.postprocess.life.traits import Traits
from rig.arrays import Float32, Float64
from rig.curves import HEAD

FINAL_SECONDS = (0.4, 0.1, 1.2)
"""Attack, hold and decay of the lowering when a phrase is known to have ended."""
LIFT_SECONDS = (0.35, 0.0, 1.2)
INHALES_AFTER, READY_AFTER = 0.6, 0.9
"""Seconds of a pause after which the breath is drawn, and the head rises."""
READY_SECONDS = 0.35
"""Time constant of that rise, and of its end with the next phrase."""
YAW, PITCH, UP, BREATH, SWALLOWS = 0, 1, 4, 6, 7
CHANNELS = 8
"""The columns of `rig.curves.HEAD`, breath and swallowing of the neck."""
_LIVELY = np.array([LIVELINESS.get(name, 1.0) for name in EMOTIONS])
_POSTURE = by_emotion(POSTURE)
_SLOW = np.array(
    [SWAY_SECONDS] * 3 + [STIR_SECONDS] * 3 + [SHIFT_SECONDS] * 3 + [1.5, VIGOUR_SECONDS]
)


class RunningHead:
    """Head and neck of one stream.

    Parameters
    ----------
    traits : Traits
        Of the character.
    rng : numpy.random.Generator
        Equal generators give equal motion.
    """

    def __init__(self, traits: Traits, rng: np.random.Generator) -> None:
        self.traits = traits
        self.events, noise = rng.spawn(2)
        self.noise = RunningNoise((*SWAY, *STIR, *SHIFT_CM, 0.6, VIGOUR), _SLOW, noise)
        self.swells = RunningSwells(CHANNELS)
        self.phase = 2 * math.pi * self.events.random()
        self.swallows_at = self.events.exponential(SWALLOW_EVERY)
        self.nods_at: float | None = None
        self.vigour = 1.0
        self.speaks = self.ready = 0.0
        """Share of speech in the last frames, and of the raise in a pause, 0 to 1."""
        self.is_speaking = self.is_ready = False
        self.held = np.zeros((2, len(HEAD)))

    def begin(self, row: VoiceRow, time: float) -> None:
        """Begin the events of a frame."""
        if row.stress:
            nod = draw_nod(row.stress, row.prominence, self.events).scaled(self.vigour)
            turn = np.pad(nod.degrees, (0, CHANNELS - 3))
            self.swells.begin(time, (nod.attack, 0.0, nod.decay), turn)
        if row.ends:
            self._begin(time, FINAL_SECONDS, {PITCH: FINAL_DEGREES})
        if round(row.pause * FRAME_RATE) == round(INHALES_AFTER * FRAME_RATE):
            self._begin(time, LIFT_SECONDS, {UP: INHALE_CM, PITCH: INHALE_DEGREES})
            self._begin(time, (INHALE_SECONDS[0], 0.0, INHALE_SECONDS[1]), {BREATH: INHALE})
        if row.pause >= SWALLOW_PAUSE and time >= self.swallows_at:
            self._begin(time, (SWALLOW[0], SWALLOW[2], SWALLOW[1]), {SWALLOWS: 1.0})
            wait = self.events.exponential(SWALLOW_EVERY - LEAST_WAIT)
            self.swallows_at = time + LEAST_WAIT + wait
        self._listen(row, time)
        self.is_speaking, self.is_ready = row.pause == 0, row.pause >= READY_AFTER

    def at(self, time: float) -> Float64:
        """Motion at a time, each frame once: head and neck of a neutral face [shape=(8,)]."""
        self.speaks += (self.is_speaking - self.speaks) / (POSTURE_SECONDS * FRAME_RATE)
        self.ready += (self.is_ready - self.ready) / (READY_SECONDS * FRAME_RATE)
        noise = self.noise.next()
        self.vigour = math.exp(noise[10])
        total = self.swells.at(time)
        total[:3] += (self.vigour * noise[:3] + noise[3:6]) * (QUIET + (1 - QUIET) * self.speaks)
        total[3:6] += noise[6:9]
        quiet = math.sin(self.phase + 2 * math.pi * time / BREATH_SECONDS + noise[9])
        quiet *= 1 - 0.7 * self.speaks
        total[UP] += BREATH_CM * quiet
        total[PITCH] += BREATH_DEGREES * quiet + INITIAL_DEGREES * self.ready
        total[PITCH] += NOD_RAISE * self.speaks
        total[SWALLOWS] *= 1 - self.speaks
        return total * begun(time)

    def shown(self, motion: Float64, mixture: Float32, amount: Float64) -> tuple[Float64, Float64]:
        """Motion and whole track of the next frames.

        Parameters
        ----------
        motion : array [shape=(n, 6)]
            Of a neutral face.
        mixture : array [shape=(n, S)]
            Emotion shown: weights times intensity.
        amount : array [shape=(n, 1)]
            Factor on the posture.

        Returns
        -------
        motion, head : arrays [shape=(n, 6)]
            Motion as wide as the emotion has it; the same with the posture.
        """
        calm = np.maximum(1 - mixture[:, 1:].sum(axis=1), 0)
        lively = (calm + mixture[:, 1:] @ _LIVELY[1:]) * self.traits.head_range
        moved: Float64 = motion * lively[:, None]
        side = np.array([1, 1, 1 if self.traits.side >= 0 else -1, 1, 1, 1])
        share = 1.4 / (POSTURE_SECONDS * FRAME_RATE)
        postures = []
        for target in mixture @ _POSTURE * side:
            self.held[0] += share * (target - self.held[0])
            self.held[1] += share * (self.held[0] - self.held[1])
            postures.append(self.held[1].copy())
        return moved, moved + amount * np.array(postures).reshape(moved.shape)

    def _listen(self, row: VoiceRow, time: float) -> None:
        """Single and double nods in a long silence."""
        if row.pause < LISTENING_SECONDS:
            self.nods_at = None
        elif self.nods_at is None:
            self.nods_at = time + self.events.exponential(LISTENING_SECONDS)
        elif time >= self.nods_at:
            for beat in range(int(self.events.integers(1, 3))):
                depth = -float(self.events.uniform(*LISTENING_DEGREES))
                self._begin(time + 0.45 * beat, (0.25, 0.0, 0.35), {PITCH: depth})
            wait = self.events.exponential(LISTENING_SECONDS)
            self.nods_at = time + LISTENING_SECONDS + wait

    def _begin(
        self, time: float, times: tuple[float, float, float], heights: dict[int, float]
    ) -> None:
        channels = np.zeros(CHANNELS)
        for channel, height in heights.items():
            channels[channel] = height
        self.swells.begin(time, times, channels)
