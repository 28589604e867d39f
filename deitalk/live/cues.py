"""Cues of voices that have not ended, which move what is above the mouth.

The motion is that of `deitalk.postprocess.life.motion`; here are its cues as they become known,
the causal form of `deitalk.postprocess.life.voice`. An accent is a peak of level, pitch and
sonority over their means so far, a stress one of the sonority; both are known a frame or two after
the peak. Phrases are known when they have ended for `JOINED_SECONDS`.

Streams are side by side, and their state is in the caller's hands. Letters: B streams, n frames of
a call.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.prosody import LEVEL_DB, PITCH_SEMITONES, VOICED
from deitalk.live.intensity import FORGET_FRAMES, Measures
from deitalk.postprocess.life.voice import (
    ACCENT_DISTANCE,
    ACCENT_WEIGHTS,
    ACCENTS_PER_SECOND,
    FULL_ACCENT,
    FULL_STRESS_DB,
    JOINED_SECONDS,
    LEAST_STRESS_DB,
    LISTENING_EVERY,
    LISTENING_SECONDS,
    MOST_DEVIATION,
    PAUSES,
    SONORITY_DB,
    SONORITY_SPREAD_DB,
    STRESS_DISTANCE,
    Cues,
)
from rig.arrays import Bool, Float64, Int64

SMOOTHING, SONORITY_SMOOTHING = 0.4, 0.6
"""Share of a new frame in level and pitch, which smooths over a syllable, and in the sonority."""
LOUDEST_FALLS_DB = 0.75 / FRAME_RATE
"""Decrease per frame of the loudest sonority, from which `SONORITY_DB` counts."""
EASIEST_ACCENT, RAISED = 1.2, 1.2
"""Least weighted sum of an accent, and by how much an accent raises it for the next one. Speech
lowers it again, by as much as `ACCENTS_PER_SECOND` raise it: readers have .6 to .9 a second."""
NONE = -1
"""Frame of a phrase, or of speech, where there is none."""
ACCENTS, STRESSES = 0, 1
"""Columns of the peaks."""
SMOOTHINGS = np.array([SMOOTHING, SONORITY_SMOOTHING])
DISTANCES = np.array([ACCENT_DISTANCE, STRESS_DISTANCE])
SPREADS = np.array([LEVEL_DB, PITCH_SEMITONES, SONORITY_SPREAD_DB])
FULL = np.array([FULL_ACCENT, FULL_STRESS_DB])
PAUSE_SIZES = np.zeros(round(LISTENING_SECONDS * FRAME_RATE))
"""Length of the pause that is a cue, by the frames that it has lasted; 0: none."""
for _size in PAUSES:
    PAUSE_SIZES[round(_size * FRAME_RATE)] = _size


class CueState(NamedTuple):
    """State of streams between two calls."""

    means: Float64
    """Means of level, pitch and sonority in speech [shape=(B, 3)]."""
    weights: Float64
    """Frames that they count for."""
    peaks: Float64
    """Smoothed value, the one before, and the lowest since the last peak, of all three weighted and
    of the sonority [shape=(B, 3, 2)]."""
    since: Int64
    """Frames since the last peak [shape=(B, 2)]."""
    least: Float64
    """Least weighted sum of the next accent [shape=(B,)]."""
    loudest: Float64
    """Loudest sonority, which falls slowly [shape=(B,)]."""
    frame: Int64
    """Number of the next frame [shape=(B,)]."""
    begun: Int64
    """First of the phrase, or `NONE` [shape=(B,)]."""
    spoken: Int64
    """Last of speech, or `NONE` [shape=(B,)]."""


class Found(NamedTuple):
    """Whether there is a cue of one kind in each stream, and its numbers [shape=(B,) each]."""

    there: Bool
    time: Float64
    size: Float64
    prominence: Float64
    stop: Float64


class RunningCues:
    """Cues of streams.

    Parameters
    ----------
    ahead : int
        Frames by which a frame is measured before its curves are given.
    """

    def __init__(self, ahead: int) -> None:
        self.ahead = ahead

    def first(self, batch: int) -> CueState:
        """State of streams before their first frame."""
        peaks = np.zeros((batch, 3, 2))
        peaks[:, :, STRESSES] = np.nan  # begins with the first value
        none = np.full(batch, NONE)
        return CueState(
            np.zeros((batch, 3)),
            np.zeros((batch, 3)),
            peaks,
            np.tile(DISTANCES, (batch, 1)),
            np.full(batch, EASIEST_ACCENT),
            np.full(batch, -100.0),
            np.zeros(batch, np.int64),
            none,
            none.copy(),
        )

    def __call__(
        self, measures: Measures, speaking: Bool, state: CueState
    ) -> tuple[Cues, CueState]:
        """Cues that the next frames make known, in the order of the frames.

        Parameters
        ----------
        measures : Measures
            Prosody of the frames [shape=(B, n)] each.
        speaking : array of bool [shape=(B, n)]
            Frames of speech.
        state : CueState
            From `first`, or from the call before.
        """
        parts = []
        for k in range(speaking.shape[1]):
            row = Measures(*(track[:, k] for track in measures))
            known = np.maximum(state.frame - self.ahead, 0) / FRAME_RATE
            phrases, state = self._phrases(speaking[:, k], state)
            peaks, state = self._peaks(row, speaking[:, k], state)
            state = state._replace(frame=state.frame + 1)
            # Of all kinds and streams, those that there are: (kinds, B).
            there, *numbers = (np.stack(part) for part in zip(*phrases, *peaks, strict=True))
            kind, stream = np.nonzero(there)
            time, size, prominence, stop = (part[kind, stream] for part in numbers)
            asked = np.zeros(len(kind), bool)  # questions are known too late
            parts.append(Cues(stream, kind, time, known[stream], size, prominence, stop, asked))
        return Cues.joined(parts), state

    def _phrases(self, speaks: Bool, state: CueState) -> tuple[list[Found], CueState]:
        """Cues of phrases and pauses: `START`, `SPEECH`, `END` and `PAUSE`."""
        frame, now = state.frame, state.frame / FRAME_RATE
        none, to_come = np.zeros(len(frame)), np.full(len(frame), np.nan)
        # A phrase starts, or has lasted whole seconds.
        starts = speaks & (state.begun == NONE)
        begun = np.where(starts, frame, state.begun)
        spoken = np.where(speaks, frame, state.spoken)
        length = frame - begun
        lasts = speaks & ~starts & (length % FRAME_RATE == 0)
        # It has ended for long enough; a pause has lasted one of its lengths.
        silent = ~speaks & (spoken != NONE)
        pause, start = frame - spoken, (spoken + 1) / FRAME_RATE
        ends = silent & (begun != NONE) & (pause / FRAME_RATE > JOINED_SECONDS)
        sizes = PAUSE_SIZES[np.minimum(pause, len(PAUSE_SIZES) - 1)]
        listened = pause / FRAME_RATE - LISTENING_SECONDS
        beats = (listened >= 0) & (listened % LISTENING_EVERY < 0.5 / FRAME_RATE)
        sizes = np.where(pause < len(PAUSE_SIZES), sizes, beats * pause / FRAME_RATE)
        found = [
            Found(starts, now, none, none, to_come),
            Found(lasts, now, length // FRAME_RATE + none, none, to_come),
            Found(ends, start, start - begun / FRAME_RATE, none, to_come),
            Found(silent & (sizes > 0), start, sizes, none, to_come),
        ]
        return found, state._replace(begun=np.where(ends, NONE, begun), spoken=spoken)

    def _peaks(self, row: Measures, speaks: Bool, state: CueState) -> tuple[list[Found], CueState]:
        """`ACCENT` and `STRESS`, which were at the frame before."""
        loudest = np.maximum(state.loudest - LOUDEST_FALLS_DB, row.sonority)
        sonority = np.maximum(row.sonority, loudest - SONORITY_DB)
        # Level, pitch and sonority over their means so far, and the sonority itself.
        voiced = speaks & (row.periodicity > VOICED)
        counts = np.stack((speaks, voiced, speaks), axis=-1)
        values = np.stack((row.level, row.pitch, sonority), axis=-1)
        weights = np.where(counts, np.minimum(state.weights + 1, FORGET_FRAMES), state.weights)
        moved = state.means + (values - state.means) / np.maximum(weights, 1)
        means = np.where(counts, moved, state.means)
        above = np.clip((values - means) / SPREADS, -MOST_DEVIATION, MOST_DEVIATION)
        weighted = (np.where(counts, above, 0) * ACCENT_WEIGHTS).sum(axis=-1)
        target = np.stack((weighted, sonority), axis=-1)
        # Peaks that stand out, and those that rise far enough above the lowest since the last one.
        last, before, valley = np.moveaxis(
            np.where(np.isnan(state.peaks), target[:, None], state.peaks), 1, 0
        )
        value = last + SMOOTHINGS * (target - last)
        since = state.since + 1
        fallen = state.least - RAISED * ACCENTS_PER_SECOND / FRAME_RATE * speaks
        accent = np.maximum(fallen, EASIEST_ACCENT)
        least = np.stack((accent, np.full_like(accent, LEAST_STRESS_DB)), axis=-1)
        height = np.stack((last[:, ACCENTS], (last - valley)[:, STRESSES]), axis=-1)
        is_peak = (before < last) & (last > value) & (since >= DISTANCES) & (height >= least)
        valley = np.where(is_peak, value, np.minimum(valley, value))
        time = np.maximum(state.frame - 1, 0) / FRAME_RATE
        size, high = np.minimum(height / FULL, 1.0), value[:, ACCENTS] / np.hypot(1, 1)
        none, to_come = np.zeros(len(time)), np.full(len(time), np.nan)
        found = [
            Found(is_peak[:, ACCENTS], time, size[:, ACCENTS], none, to_come),
            Found(
                is_peak[:, STRESSES] & (state.begun != NONE), time, size[:, STRESSES], high, to_come
            ),
        ]
        state = state._replace(
            means=means,
            weights=weights,
            peaks=np.stack((value, last, valley), axis=1),
            since=np.where(is_peak, 0, since),
            least=accent + RAISED * is_peak[:, ACCENTS],
            loudest=loudest,
        )
        return found, state
