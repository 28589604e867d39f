"""Analysis of voices that have not ended: activity, gates, prosody, intensity and held sounds.

All functions take arrays or tensors. Letters: B streams, n frames of a call, K frequency bands,
W samples of a window.
"""

from typing import NamedTuple

import numpy as np

from deitalk.array_functions import Array, join, library
from deitalk.audio.held_sound import Held, HeldState, first_held, follow_held
from deitalk.audio.prosody import Prosody, measure_windows
from deitalk.audio.voice_activity import BAND_EDGES_HZ, window_levels
from deitalk.config.rules import HoldPose, RulesConfig
from deitalk.live.activity import ActivityState, RunningActivity
from deitalk.live.intensity import Measures, RunningIntensity, follow_means
from deitalk.models.protocol import SpectraGrid
from deitalk.postprocess.factors import LEARNT_USUAL, opening_factor
from rig.arrays import Float32


class FrameMeasures(NamedTuple):
    """Measures of the sound of frames."""

    levels: Array
    """Levels of the bands, dB [shape=(B, n, K)]."""
    tones: Array
    """Tonality [shape=(B, n)]."""
    prosody: Array
    """`Measures` side by side [shape=(B, n, 5)]."""

    @classmethod
    def of_windows(cls, windows: Float32, device: str = "cpu") -> "FrameMeasures":
        """Measure windows [shape=(B, n, W)], on a device; the measures are arrays."""
        rows, count = windows.reshape(-1, windows.shape[-1]), windows.shape[1]
        if device == "cpu":
            return cls.of_rows(window_levels(rows), measure_windows(rows.astype(np.float64)), count)
        import torch

        sent = torch.from_numpy(rows).to(device)
        measured = cls.of_rows(window_levels(sent), measure_windows(sent), count)
        return cls(*(np.asarray(part.cpu()) for part in measured))

    @classmethod
    def of_rows(cls, levels: Array, prosody: Prosody, count: int) -> "FrameMeasures":
        """Take the measures of B `count` windows one after the other."""
        tracks = prosody.level, prosody.tilt, prosody.pitch, prosody.periodicity, prosody.sonority
        rows = library(levels).stack(tracks, axis=1)
        return cls(
            levels.reshape(-1, count, levels.shape[-1]),
            prosody.tone.reshape(-1, count),
            rows.reshape(-1, count, len(tracks)),
        )


class Analysis(NamedTuple):
    """Measures of the frames of the network's rows, and gates of those whose curves come out."""

    measures: Measures
    """Prosody [shape=(B, n)] each."""
    speaking: Array
    """Frames of speech [shape=(B, n)]; a lone one is a click."""
    intensity: Array
    """Intensity of the voice [shape=(B, n), range 0 to 1.2]."""
    opening: Array
    """Factor on the opening of the mouth [shape=(B, n)]."""
    mouth: Array
    """Gate of the mouth, the grid's `rules_ahead` frames before [shape=(B, n), range 0 to 1]."""
    expression: Array
    """Share of the expression of the same frames."""
    held: Held
    """Where a held sound keeps its pose [shape=(B, n)]."""


State = tuple[Array, ...]
"""State of streams, arrays that begin with the stream: the first `N_SOUND` of the sound, the others
of what the network has read of it."""
N_ACTIVITY = len(ActivityState._fields)
N_SOUND = N_ACTIVITY + len(HeldState._fields) + 1


class VoiceAnalysis:
    """Analysis of streams by the rules of one model.

    Parameters
    ----------
    rules : RulesConfig
    grid : SpectraGrid
        Of the model: sound is measured when the network reads it.
    device : str
        Where windows are measured.
    """

    def __init__(self, rules: RulesConfig, grid: SpectraGrid, device: str = "cpu") -> None:
        self.device, self.rules, self.delay = device, rules, grid.delay
        self.activity = RunningActivity(rules.gates, grid.delay + grid.rules_ahead)
        self.hold = rules.hold_pose or HoldPose()
        rule = rules.voice_intensity
        self.intensity = None if rule is None else RunningIntensity(rule)

    def first(self, batch: int) -> State:
        """State of streams before their first frame."""
        intensity = () if self.intensity is None else self.intensity.first(batch)
        measured = np.zeros((batch, self.delay, len(Measures._fields)))
        held = first_held(batch, len(BAND_EDGES_HZ) - 1)
        means = np.full((batch, 2), LEARNT_USUAL)
        return (*self.activity.first(batch), *held, measured, means, *intensity)

    def begin(self, windows: Float32, state: State) -> State:
        """Take the first frames, as many as the grid's `delay` [shape=(B, delay, W)]."""
        none = np.zeros(windows.shape[:2], np.float32)
        _, after = self(
            FrameMeasures.of_windows(windows, self.device), none, none, none[:, 0], state
        )
        return (*after[:N_SOUND], *state[N_SOUND:])

    def __call__(
        self, measured: FrameMeasures, network: Array, effort: Array, rest: Array, state: State
    ) -> tuple[Analysis, State]:
        """Analyse the next frames.

        Parameters
        ----------
        measured : FrameMeasures
            Of the frames that are `delay` after those of the network's rows.
        network, effort : array [shape=(B, n)]
            Of the rows: predicted intensity, and strength of the voice.
        rest : array [shape=(B,), range 0 to 1]
            Share of the expression that stays in silence.
        state : State
            From `begin`, or from the call before.
        """
        activity = ActivityState(*state[:N_ACTIVITY])
        past, before = HeldState(*state[N_ACTIVITY : N_SOUND - 1]), state[N_SOUND - 1]
        means, intensity = state[N_SOUND], state[N_SOUND + 1 :]
        count = network.shape[1]
        held, past = follow_held(measured.levels, measured.tones, self.hold, past, self.delay)
        on, mouth, expression, activity = self.activity(
            measured.levels, held.sounding, rest, activity
        )
        rows = join((before, measured.prosody), 1)
        measures = Measures(*(rows[:, :count, k] for k in range(len(Measures._fields))))
        # Activity of the rows and of the frames beside them, of which the last n + 4 flags are.
        on = on[:, -count - self.delay - 1 :]
        speaking = on[:, 1 : count + 1] & (on[:, :count] | on[:, 2 : count + 2])
        voice = network
        if self.intensity is not None:
            voice, intensity = self.intensity(network, measures, speaking, effort, intensity)
        both = library(network).stack((voice, network), axis=-1)
        near, means = follow_means(both, speaking, means)
        opening = opening_factor(self.rules.scale_opening, near[..., 0], near[..., 1])
        found = Analysis(measures, speaking, voice, opening, mouth, expression, held)
        return found, (*activity, *past, rows[:, count:], means, *intensity)
