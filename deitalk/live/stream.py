"""One voice that has not ended: its sound, what is measured of it, and its frames.

Letters: S samples, n frames of a call, P spectra a frame, W samples of a spectrum, C controls.
"""

from typing import NamedTuple

import numpy as np

from deitalk.acting import Acting
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.voice_activity import WINDOW
from deitalk.config.rules import RulesConfig
from deitalk.emotions import EmotionTrack
from deitalk.live import rules as running
from deitalk.live.life import RunningLife
from deitalk.live.rules import (
    BEHIND,
    GATE_AHEAD,
    DueRows,
    RawRows,
    RunningActivity,
    RunningRules,
    rows_before,
)
from deitalk.models.protocol import SpectraGrid
from deitalk.postprocess.curve_rules import LEAST_PREDICTED, Expression
from deitalk.postprocess.voice_intensity import Measures, RunningIntensity
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64, Int64
from rig.curves import HEAD
from rig.curves.edit import gain_factors, scale_from_rest

RAMP_SECONDS = 0.2
"""Time over which one emotion, or intensity, passes into the next."""
MEASURED_AHEAD = GATE_AHEAD - running.AHEAD
"""Frames after a row of the network whose activity is known when it is."""


class Change(NamedTuple):
    """Emotion and intensity from a time of the sound on."""

    seconds: float
    emotion: EmotionTrack
    intensity: float


class Sound:
    """The last samples of a stream at 16 kHz."""

    def __init__(self) -> None:
        self.samples, self.begin = np.zeros(0, np.float32), 0

    @property
    def end(self) -> int:
        """Samples that have come."""
        return self.begin + len(self.samples)

    def append(self, samples: Float32) -> None:
        """Take the next samples."""
        self.samples = np.concatenate((self.samples, samples))

    def windows(self, starts: Int64, size: int) -> Float32:
        """`size` samples from each start on [shape=(n, size)]; silence before the first sample."""
        first = int(starts[0])
        piece = self.samples[max(first - self.begin, 0) :]
        if first < 0:
            piece = np.concatenate((np.zeros(-first, np.float32), piece))
        rows = np.lib.stride_tricks.sliding_window_view(piece, size)
        return np.asarray(rows[starts - first])

    def drop(self, before: int) -> None:
        """Drop samples before a place."""
        if before - self.begin > SAMPLE_RATE:
            self.samples = self.samples[before - self.begin :].copy()
            self.begin = before


class Stream:
    """One stream.

    Parameters
    ----------
    grid : SpectraGrid
        Of the network.
    controls : ControlSet
        Columns of the curves.
    rules : RulesConfig
        Rules after the network.
    acting : Acting
        At the start.
    life : RunningLife or None
        Blinks, gaze, brows, head and neck.
    style : str
        One of the network's actors, or empty.
    """

    def __init__(
        self,
        grid: SpectraGrid,
        controls: ControlSet,
        rules: RulesConfig,
        acting: Acting,
        life: RunningLife | None,
        style: str = "",
    ) -> None:
        self.grid, self.controls, self.settings, self.life = grid, controls, rules, life
        self.style = style
        expression = Expression(controls, rules)
        self.rules, self.rows = RunningRules(expression), rows_before(expression)
        self.activity = RunningActivity(rules.gates)
        self.intensity = RunningIntensity(rules.voice_intensity)
        self.speaking: Bool = np.zeros(1, bool)
        """Activity from the frame before the next row on."""
        self.prosody: Float64 = np.zeros((31, 0))
        """Measures from the next row on."""
        self.sound, self.changes = Sound(), [Change(0.0, acting.track, acting.intensity)]
        self.acting, self.gain = acting, gain_factors(controls, acting.gain)
        self.groups = self.n_measured = self.n_frames = 0
        self.n_total: int | None = None
        self.frames: list[Float32] = []
        self.heads: list[Float32] = []

    def change(self, acting: Acting, rules: RulesConfig) -> None:
        """Act otherwise from the sound on that comes next; at once before any."""
        before, self.acting = self.acting, acting
        change = Change(self.sound.end / SAMPLE_RATE, acting.track, acting.intensity)
        if (acting.emotion, acting.intensity) != (before.emotion, before.intensity):
            self.changes = [*self.changes, change] if self.sound.end else [change]
        self.gain = gain_factors(self.controls, acting.gain)
        if self.life is not None and acting.look_at != before.look_at:
            self.life.look_at(acting.look_at, frame_count(self.sound.end))
        if rules != self.settings:
            self._follow(rules)

    def _follow(self, rules: RulesConfig) -> None:
        """Apply other rules to the frames that come next."""
        self.settings, self.rules = rules, RunningRules(Expression(self.controls, rules))
        self.activity.gates, self.intensity.rule = rules.gates, rules.voice_intensity

    def finish(self) -> None:
        """Take the end of the sound: silence follows, until the last frame is known."""
        self.n_total = frame_count(self.sound.end)
        self.sound.append(np.zeros(round(1.5 * SAMPLE_RATE), np.float32))

    def n_ready(self) -> int:
        """Groups of spectra whose samples have come and that were not taken."""
        if self.n_total is not None:
            return self.n_total + running.AHEAD + self.grid.delay - self.groups
        rate, length = self.grid.rate, self.grid.length
        frames = MEASURED_AHEAD - 1 - self.grid.delay
        measured = frames * SAMPLE_RATE // FRAME_RATE + WINDOW // 2 + SAMPLE_RATE // rate
        # centre of the last spectrum that is whole, and whose group can be measured
        last = self.sound.end - max(length - length // 2, measured)
        spectra = int((last + 0.5) * rate / SAMPLE_RATE) + 2
        while spectra > 0 and round((spectra - 1) * SAMPLE_RATE / rate) > last:
            spectra -= 1
        return max(spectra // self.grid.spectra - self.groups, 0)

    def take(self, count: int) -> tuple[Float32, Float32]:
        """Take the next groups.

        Returns
        -------
        windows : array [shape=(count P, W)]
        emotion : array [shape=(count, 9)]
            Of the frames that the network reads with them.
        """
        grid = self.grid
        index = np.arange(self.groups * grid.spectra, (self.groups + count) * grid.spectra)
        centres = np.round(index * SAMPLE_RATE / grid.rate).astype(np.int64)
        windows = self.sound.windows(centres - grid.length // 2, grid.length)
        frames = np.arange(self.groups, self.groups + count) - self.grid.delay
        self.groups += count
        return windows, self._directed(frames)[0]

    def unmeasured(self) -> Float32:
        """Windows (m, `WINDOW`) of the frames to be measured before the network's next rows."""
        stop = self.groups - self.grid.delay + MEASURED_AHEAD
        frames = np.arange(self.n_measured, stop)
        self.n_measured = stop
        return self.sound.windows(frames * SAMPLE_RATE // FRAME_RATE - WINDOW // 2, WINDOW)

    def measure(self, levels: Float32, prosody: Float64) -> None:
        """Take the levels (m, K) and the prosody (31, m) of the windows."""
        self.speaking = np.concatenate((self.speaking, self.activity.feed(levels)))
        self.prosody = np.concatenate((self.prosody, prosody), axis=1)

    def accept(self, neutral: Float32, emotional: Float32, strength: Float32) -> None:
        """Take the network's rows for the groups taken last."""
        stop, network = self.groups - self.grid.delay, strength
        frames = np.arange(stop - len(neutral), stop)
        measures, speaking = self._measured(len(frames))
        voice = self.intensity.feed(network, measures, speaking)
        if self.life is not None:
            self.life.feed(measures, speaking)
        emotion, factor = self._directed(frames)
        scale, applied = factor, voice * factor
        if self.settings.voice_intensity is not None:
            scale = (applied / np.maximum(network, LEAST_PREDICTED)).astype(np.float32)
        new = RawRows(neutral, emotional, network, voice, scale, emotion, applied)
        self.rows = self.rows.joined(new)
        self._drop()

    def due(self) -> DueRows | None:
        """What the frames that are known now depend on; None if there are none."""
        count = len(self.rows.scale) - BEHIND - running.AHEAD
        if self.n_total is not None:
            count = min(count, self.n_total - self.n_frames)
        if count <= 0:
            return None
        due = self.rules.due(self.rows, self.activity.gate(count))
        self.rows = self.rows.since(count)
        self.n_frames += count
        return due

    def emit(self, curves: Float32, due: DueRows) -> None:
        """Take the curves of the frames that were due."""
        head = np.zeros((len(curves), len(HEAD)), np.float32)
        if self.life is not None:
            shown = due.own.applied * due.gates.expression
            head = self.life.add_to(curves, due.own.neutral, due.own.emotion * shown[:, None])
        curves = np.clip(curves, self.controls.minimum, self.controls.maximum)
        scale_from_rest(curves, self.gain, self.controls)
        self.frames.append(curves)
        self.heads.append(head)

    def collect(self) -> tuple[Float32, Float32]:
        """Frames since the last call [shape=(n, C)], and their track of the head [shape=(n, 6)]."""
        frames, heads = self.frames, self.heads
        self.frames, self.heads = [], []
        if not frames:
            return _none(len(self.controls)), _none(len(HEAD))
        return np.concatenate(frames), np.concatenate(heads)

    def _measured(self, count: int) -> tuple[Measures, Bool]:
        """Prosody of the next frames, and which of them are speech: a lone one is a click."""
        on = self.speaking
        self.speaking = on[count:]
        now, before, after = on[1 : count + 1], on[:count], on[2 : count + 2]
        measured, self.prosody = np.split(self.prosody, [count], axis=1)
        return Measures.of(measured), now & (before | after)

    def _drop(self) -> None:
        """Drop sound and changes that no frame needs any more."""
        spectrum = int(self.groups * SAMPLE_RATE / FRAME_RATE) - self.grid.length
        activity = self.n_measured * SAMPLE_RATE // FRAME_RATE - WINDOW
        self.sound.drop(min(spectrum, activity))
        seconds = (self.groups - self.grid.delay) / FRAME_RATE - RAMP_SECONDS
        while len(self.changes) > 1 and self.changes[1].seconds < seconds:
            self.changes.pop(0)

    def _directed(self, frames: Int64) -> tuple[Float32, Float32]:
        """Emotion (n, 9) and intensity (n,) of frames."""
        times = np.maximum(frames, 0) / FRAME_RATE
        first = self.changes[0]
        emotion = first.emotion.at(times)
        intensity = np.full(len(times), first.intensity, np.float32)
        for change in self.changes[1:]:
            share = np.clip((times - change.seconds) / RAMP_SECONDS, 0, 1).astype(np.float32)
            emotion = emotion + share[:, None] * (change.emotion.at(times) - emotion)
            intensity = intensity + share * (np.float32(change.intensity) - intensity)
        return emotion.astype(np.float32), intensity.astype(np.float32)


def _none(count: int) -> Float32:
    return np.zeros((0, count), np.float32)
