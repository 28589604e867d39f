"""Cues of voices that have not ended, which move what is above the mouth.

The motion is that of `deitalk.postprocess.life.motion`; here are its cues as they become known,
the causal form of `deitalk.postprocess.life.voice`. An accent is a peak of level and pitch over
their means so far, a stress one of the sonority; both are known a frame or two after the peak.
Phrases are known when they have ended for `JOINED_SECONDS`.

Streams are side by side, and their state is in the caller's hands. Letters: B streams, n frames of
a call.
"""

import math
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.vocal_strength import LEVEL_DB, PITCH_SEMITONES, VOICED
from deitalk.live.intensity import FORGET_FRAMES, Measures
from deitalk.postprocess.life.voice import (
    ACCENT_DISTANCE,
    FULL_PROMINENCE,
    FULL_STRESS_DB,
    JOINED_SECONDS,
    LEAST_PROMINENCE,
    LEAST_STRESS_DB,
    LISTENING_EVERY,
    LISTENING_SECONDS,
    PAUSES,
    SONORITY_DB,
    STRESS_DISTANCE,
    Cue,
)
from rig.arrays import Bool, Float64, Int64

SMOOTHING, SONORITY_SMOOTHING = 0.4, 0.6
"""Share of a new frame in level and pitch, which smooths over a syllable, and in the sonority."""
LOUDEST_FALLS_DB = 0.75 / FRAME_RATE
"""Decrease per frame of the loudest sonority, from which `SONORITY_DB` counts."""
MOST_TARGET = 3.0
"""Limit of level and pitch together, standard deviations."""
NONE = -1
"""Frame of a phrase, or of speech, where there is none."""
ACCENTS, STRESSES = 0, 1
"""Columns of the peaks."""
SMOOTHINGS = np.array([SMOOTHING, SONORITY_SMOOTHING])
DISTANCES = np.array([ACCENT_DISTANCE, STRESS_DISTANCE])
LEAST_RISES = np.array([LEAST_PROMINENCE, LEAST_STRESS_DB])
FULL_RISES = np.array([FULL_PROMINENCE, FULL_STRESS_DB])
PAUSE_SIZES = np.zeros(round(LISTENING_SECONDS * FRAME_RATE))
"""Length of the pause that is a cue, by the frames that it has lasted; 0: none."""
for _size in PAUSES:
    PAUSE_SIZES[round(_size * FRAME_RATE)] = _size


class CueState(NamedTuple):
    """What is kept of streams between two calls."""

    means: Float64
    """Of level and pitch in speech [shape=(B, 2)]."""
    weights: Float64
    """Frames that they count for."""
    peaks: Float64
    """Smoothed value, the one before, and the lowest since the last peak, of level and pitch and of
    the sonority [shape=(B, 3, 2)]."""
    since: Int64
    """Frames since the last peak [shape=(B, 2)]."""
    loudest: Float64
    """Loudest sonority, which falls slowly [shape=(B,)]."""
    frame: Int64
    """That comes next [shape=(B,)]."""
    begun: Int64
    """First of the phrase, or `NONE` [shape=(B,)]."""
    spoken: Int64
    """Last of speech, or `NONE` [shape=(B,)]."""


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
            np.zeros((batch, 2)),
            np.zeros((batch, 2)),
            peaks,
            np.tile(DISTANCES, (batch, 1)),
            np.full(batch, -100.0),
            np.zeros(batch, np.int64),
            none,
            none.copy(),
        )

    def __call__(
        self, measures: Measures, speaking: Bool, state: CueState
    ) -> tuple[list[tuple[int, Cue]], CueState]:
        """Cues that the next frames make known, each after the number of its stream.

        Parameters
        ----------
        measures : Measures
            Prosody of the frames [shape=(B, n)] each.
        speaking : array of bool [shape=(B, n)]
            Frames of speech.
        state : CueState
            From `first`, or from the call before.
        """
        found: list[tuple[int, Cue]] = []
        for k in range(speaking.shape[1]):
            row = Measures(*(track[:, k] for track in measures))
            known = np.maximum(state.frame - self.ahead, 0) / FRAME_RATE
            state = self._phrases(speaking[:, k], known, state, found)
            state = self._peaks(row, speaking[:, k], known, state, found)
            state = state._replace(frame=state.frame + 1)
        return found, state

    def _phrases(
        self, speaks: Bool, known: Float64, state: CueState, found: list[tuple[int, Cue]]
    ) -> CueState:
        """Append the cues of phrases and pauses."""
        frame, now = state.frame, state.frame / FRAME_RATE
        # A phrase starts, or has lasted whole seconds.
        starts = speaks & (state.begun == NONE)
        begun = np.where(starts, frame, state.begun)
        spoken = np.where(speaks, frame, state.spoken)
        length = frame - begun
        for k in np.flatnonzero(starts).tolist():
            found.append((k, Cue("start", now[k], known[k], math.inf)))
        for k in np.flatnonzero(speaks & ~starts & (length % FRAME_RATE == 0)).tolist():
            found.append((k, Cue("speech", now[k], known[k], int(length[k]) // FRAME_RATE)))
        # It has ended for long enough; a pause has lasted one of its lengths.
        silent = ~speaks & (spoken != NONE)
        pause, start = frame - spoken, (spoken + 1) / FRAME_RATE
        ends = silent & (begun != NONE) & (pause / FRAME_RATE > JOINED_SECONDS)
        for k in np.flatnonzero(ends).tolist():
            size = start[k] - begun[k] / FRAME_RATE
            found.append((k, Cue("end", start[k], known[k], size)))
        sizes = PAUSE_SIZES[np.minimum(pause, len(PAUSE_SIZES) - 1)]
        listened = pause / FRAME_RATE - LISTENING_SECONDS
        beats = (listened >= 0) & (listened % LISTENING_EVERY < 0.5 / FRAME_RATE)
        sizes = np.where(pause < len(PAUSE_SIZES), sizes, beats * pause / FRAME_RATE)
        for k in np.flatnonzero(silent & (sizes > 0)).tolist():
            found.append((k, Cue("pause", start[k], known[k], sizes[k])))
        return state._replace(begun=np.where(ends, NONE, begun), spoken=spoken)

    def _peaks(
        self,
        row: Measures,
        speaks: Bool,
        known: Float64,
        state: CueState,
        found: list[tuple[int, Cue]],
    ) -> CueState:
        """Append the cues of accents and stresses, which were at the frame before."""
        # Level and pitch over their means so far, and the sonority above the quietest speech.
        counts = np.stack((speaks, speaks & (row.periodicity > VOICED)), axis=-1)
        values = np.stack((row.level, row.pitch), axis=-1)
        weights = np.where(counts, np.minimum(state.weights + 1, FORGET_FRAMES), state.weights)
        moved = state.means + (values - state.means) / np.maximum(weights, 1)
        means = np.where(counts, moved, state.means)
        above = np.where(counts, (values - means) / (LEVEL_DB, PITCH_SEMITONES), 0).sum(axis=-1)
        loudest = np.maximum(state.loudest - LOUDEST_FALLS_DB, row.sonority)
        lively = np.clip(above / 2**0.5, -MOST_TARGET, MOST_TARGET)
        target = np.stack((lively, np.maximum(row.sonority, loudest - SONORITY_DB)), axis=-1)
        # Peaks that rise far enough above the lowest value since the last one.
        last, before, valley = np.moveaxis(
            np.where(np.isnan(state.peaks), target[:, None], state.peaks), 1, 0
        )
        value = last + SMOOTHINGS * (target - last)
        rise, since = last - valley, state.since + 1
        is_peak = (before < last) & (last > value) & (since >= DISTANCES) & (rise >= LEAST_RISES)
        valley = np.where(is_peak, value, np.minimum(valley, value))
        time = np.maximum(state.frame - 1, 0) / FRAME_RATE
        size = np.minimum(rise / FULL_RISES, 1.0)
        for k in np.flatnonzero(is_peak[:, ACCENTS]).tolist():
            found.append((k, Cue("accent", time[k], known[k], size[k, ACCENTS])))
        for k in np.flatnonzero(is_peak[:, STRESSES] & (state.begun != NONE)).tolist():
            high = value[k, ACCENTS]
            found.append((k, Cue("stress", time[k], known[k], size[k, STRESSES], high)))
        return state._replace(
            means=means,
            weights=weights,
            peaks=np.stack((value, last, valley), axis=1),
            since=np.where(is_peak, 0, since),
            loudest=loudest,
        )
