"""What is heard of voices that have not ended: activity, gates, prosody and intensity.

Letters: B streams, n frames of a call, W samples of a window.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.held_sound import EARLY, Held, HeldState, first_held, follow_held
from deitalk.audio.prosody import measure_windows, tonality
from deitalk.audio.voice_activity import BAND_EDGES_HZ, window_levels
from deitalk.config.rules import HoldPose, RulesConfig
from deitalk.live.activity import GATE_AHEAD, ActivityState, RunningActivity
from deitalk.live.intensity import IntensityState, Measures, RunningIntensity, follow_means
from deitalk.postprocess.factors import LEARNT_USUAL, opening_factor
from deitalk.postprocess.tracks import LIVE_AHEAD
from rig.arrays import Bool, Float32, Float64

MEASURED_AHEAD = GATE_AHEAD - LIVE_AHEAD
"""Frames after a row of the network whose sound is measured when it is."""
N_MEASURES = 31
assert MEASURED_AHEAD == EARLY


class Heard(NamedTuple):
    """What is heard at the frames of the network's rows, and gates `LIVE_AHEAD` before them."""

    measures: Measures
    """Prosody [shape=(B, n)] each."""
    speaking: Bool
    """Frames of speech [shape=(B, n)]; a lone one is a click."""
    intensity: Float32
    """Intensity of the voice [shape=(B, n), range 0 to 1.2]."""
    opening: Float32
    """Factor on the opening of the mouth [shape=(B, n)]."""
    mouth: Float32
    """Gate of the mouth `LIVE_AHEAD` frames before [shape=(B, n), range 0 to 1]."""
    expression: Float32
    """Share of the expression of the same frames."""
    held: Held
    """Where a held sound keeps its pose [shape=(B, n)]."""


HearingState = tuple[np.ndarray, ...]
"""Arrays that begin with the stream."""


class RunningHearing:
    """Hearing of streams with the rules of one model.

    Parameters
    ----------
    rules : RulesConfig
    """

    def __init__(self, rules: RulesConfig) -> None:
        self.rules, self.activity = rules, RunningActivity(rules.gates)
        self.hold = rules.hold_pose or HoldPose()
        rule = rules.voice_intensity
        self.intensity = None if rule is None else RunningIntensity(rule)

    def first(self, batch: int) -> HearingState:
        """State of streams before their first frame."""
        opens = self.rules.scale_opening
        usual = (0.0, 0.0) if opens is None else (opens.usual, LEARNT_USUAL)
        intensity = () if self.intensity is None else self.intensity.first(batch)
        measured = np.zeros((batch, MEASURED_AHEAD, N_MEASURES))
        means = np.tile(usual, (batch, 1))
        held = first_held(batch, len(BAND_EDGES_HZ) - 1)
        return (*self.activity.first(batch), *held, measured, means, *intensity)

    def begin(self, windows: Float32, state: HearingState) -> HearingState:
        """Hear the first `MEASURED_AHEAD` frames [shape=(B, `MEASURED_AHEAD`, W)]."""
        levels, measured = measure(windows)
        activity, held, _, means, intensity = self._split(state)
        found, held = follow_held(levels, _tones(measured), self.hold, held)
        rest = np.zeros(len(levels), np.float32)
        *_, activity = self.activity(levels, found.sounding, rest, activity)
        return (*activity, *held, measured, means, *intensity)

    def __call__(
        self,
        windows: Float32,
        network: Float32,
        effort: Float32,
        rest: Float32,
        state: HearingState,
    ) -> tuple[Heard, HearingState]:
        """Hear the next frames.

        Parameters
        ----------
        windows : array [shape=(B, n, W)]
            Sound of the frames that are `MEASURED_AHEAD` after those of the network's rows.
        network, effort : array [shape=(B, n)]
            Of the rows: predicted intensity, and strength of the voice.
        rest : array [shape=(B,), range 0 to 1]
            Share of the expression that stays in silence.
        state : HearingState
            From `begin`, or from the call before.
        """
        activity, past, before, means, intensity = self._split(state)
        count = windows.shape[1]
        levels, measured = measure(windows)
        held, past = follow_held(levels, _tones(measured), self.hold, past)
        on, mouth, expression, activity = self.activity(levels, held.sounding, rest, activity)
        measured = np.concatenate((before, measured), axis=1)
        measures = Measures.of(measured[:, :count])
        # Activity of the rows and of the frames beside them, of which the last n + 4 flags are.
        on = on[:, -count - MEASURED_AHEAD - 1 :]
        speaking = on[:, 1 : count + 1] & (on[:, :count] | on[:, 2 : count + 2])
        voice = network
        if self.intensity is not None:
            voice, intensity = self.intensity(network, measures, speaking, effort, intensity)
        both = np.stack((voice, network), axis=-1).astype(np.float64)
        near, means = follow_means(both, speaking, means)
        opening = opening_factor(self.rules.scale_opening, near[..., 0], near[..., 1])
        heard = Heard(measures, speaking, voice, opening, mouth, expression, held)
        return heard, (*activity, *past, measured[:, count:], means, *intensity)

    def _split(
        self, state: HearingState
    ) -> "tuple[ActivityState, HeldState, Float64, Float64, IntensityState]":
        size = len(ActivityState._fields)
        stop = size + len(HeldState._fields)
        intensity: IntensityState = state[stop + 2 :]  # type: ignore[assignment]
        activity, held = ActivityState(*state[:size]), HeldState(*state[size:stop])
        return activity, held, state[stop], state[stop + 1], intensity


def measure(windows: Float32) -> tuple[Float32, Float64]:
    """Band levels (B, n, K) and prosody (B, n, 31) of windows (B, n, W)."""
    rows, shape = windows.reshape(-1, windows.shape[-1]), windows.shape[:2]
    levels, measured = window_levels(rows), measure_windows(rows.astype(np.float64)).T
    return levels.reshape(*shape, -1), measured.reshape(*shape, -1)


def _tones(measured: Float64) -> Float64:
    """Tonality (B, n) of prosody (B, n, 31)."""
    return tonality(measured[..., 3], measured[..., 4])
