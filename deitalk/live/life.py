"""Blinks, gaze, brows, head and neck of a voice that has not ended.

The causal form of `deitalk.postprocess.life.motion`. Each frame depends on the voice up to `ahead`
frames after it, however the sound came.

Letters: n frames of a call, C controls, S styles.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config import Idle
from deitalk.live.brows import CHANNELS, RunningBrows, brow_events
from deitalk.live.eyes import RunningEyes
from deitalk.live.head import BREATH, SWALLOWS, RunningHead
from deitalk.live.intensity import Measures
from deitalk.live.tracks import begun
from deitalk.live.voice import RunningVoice
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.brows import move_brows
from deitalk.postprocess.life.motion import (
    AGAINST,
    MOST_SHOWN,
    attend,
    move_eyes,
    move_neck,
)
from deitalk.postprocess.life.mouth import lean_mouth, mouth_columns
from deitalk.postprocess.life.neck import neck_tracks
from deitalk.postprocess.life.traits import Traits
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64
from rig.controls import DEFAULT_ID
from rig.curves import HEAD

PART = 3
"""Of the stream's seed: the random numbers of this motion."""
TURN_FRAMES = 6
"""Frames in which the eyes turn to another place, as long as an emotion takes to change."""
_EYES, _BROWS, _HEAD = 4, CHANNELS, 8


class RunningLife:
    """Motion of one stream above the mouth.

    Parameters
    ----------
    controls : ControlSet
        Columns of the curves; on a rig other than the board the head alone moves.
    idle : Idle
        The model's own numbers.
    life : Life
        Factors on them, and the listener's place.
    seed : int
        Equal seeds give equal motion.
    ahead : int
        Frames measured before a frame's curves are given.
    """

    def __init__(self, controls: ControlSet, idle: Idle, life: Life, seed: int, ahead: int) -> None:
        self.controls, self.life = controls, life.times(idle)
        character, *parts = np.random.default_rng([seed, PART]).spawn(4)
        self.traits = Traits.of(character)
        factor = self.traits.blink_interval / max(self.life.blinks, 0.05)
        self.eyes = RunningEyes(idle, factor, self.traits, parts[0])
        self.brows = RunningBrows(self.traits, parts[1])
        self.head = RunningHead(self.traits, parts[2])
        self.voice, self.n_frames = RunningVoice(), -ahead
        self.rows: list[Float64] = []
        self.looks, self.place = np.array(life.look_at), np.array(life.look_at)
        self.turns: list[tuple[int, tuple[float, float]]] = []
        self.turning, self.n_given = 0, 0

    def look_at(self, place: tuple[float, float], frame: int) -> None:
        """Turn to another place of the listener, degrees, within `TURN_FRAMES` from a frame on."""
        self.turns.append((frame, place))

    def feed(self, measures: Measures, speaking: Bool) -> None:
        """Take the voice of the next frames [shape=(n,)]."""
        for row in self.voice.feed(measures, speaking):
            time = self.n_frames / FRAME_RATE
            for part in (self.eyes, self.brows, self.head):
                part.begin(row, time)
            if self.n_frames >= 0:
                parts = (self.eyes.at(time), self.brows.at(time), self.head.at(time))
                self.rows.append(np.concatenate((*parts, [begun(time)])))
            self.n_frames += 1

    def add_to(self, curves: Float32, neutral: Float32, mixture: Float32) -> Float32:
        """Add the motion of the next frames, in place.

        Parameters
        ----------
        curves, neutral : array [shape=(n, C)]
            The face that is shown, and the network's neutral reading.
        mixture : array [shape=(n, S)]
            Emotion shown: weights times intensity.

        Returns
        -------
        array [shape=(n, 6)]
            Track of the head, as in `rig.curves.HEAD`.
        """
        count, life = len(curves), self.life
        if not count:
            return np.zeros((0, len(HEAD)), np.float32)
        rows, self.rows = np.array(self.rows[:count]), self.rows[count:]
        eyes, brows, moves, shown = np.split(rows, np.cumsum((_EYES, _BROWS, _HEAD)), axis=1)
        mixture = np.minimum(mixture, MOST_SHOWN)
        motion, head = self.head.shown(
            life.head * moves[:, : len(HEAD)], mixture, life.head * shown
        )
        if self.controls.id == DEFAULT_ID:
            events, side = brow_events(brows), self.traits.side
            plain = neutral[:, mouth_columns(self.controls)]
            lean_mouth(curves, plain, self.controls, events.accents, side, life.brows)
            move_brows(curves, neutral, self.controls, events, mixture, side, life.brows)
            held = (head - motion)[:, :2] * AGAINST
            gaze = attend(shown * eyes[:, 2:], held, mixture) + motion[:, :2] * AGAINST
            gaze *= life.gaze
            gaze += shown * self._looks(count)
            move_eyes(curves, self.controls, gaze, eyes[:, :2] * bool(life.blinks))
            neck = neck_tracks(
                life.head * moves[:, BREATH], life.head * moves[:, SWALLOWS], head[:, 0]
            )
            move_neck(curves, self.controls, neck)
        return head.astype(np.float32)

    def _looks(self, count: int) -> Float64:
        """Where the listener is in the next frames, degrees [shape=(n, 2)]."""
        looks = np.empty((count, 2))
        for k in range(count):
            while self.turns and self.turns[0][0] <= self.n_given:
                self.place, self.turning = np.array(self.turns.pop(0)[1]), TURN_FRAMES
            self.n_given += 1
            if self.turning:
                self.looks = self.looks + (self.place - self.looks) / self.turning
                self.turning -= 1
            looks[k] = self.looks
        return looks
