"""Measures of a recording that both products use: activity, gates, level, strength, intensity.

::

    recording -> speech activity -> gate of the mouth, share of the expression
              -> level-normalised sound -> the network's analysis -> neutral, emotional reading
              -> prosody -> intensity of the voice -> applied intensity
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from deitalk.acting import Acting
from deitalk.array_functions import Array, as_number, library, mean_of, single, smoothed
from deitalk.audio.frames import frame_count, frame_times
from deitalk.audio.held_sound import Held, held_sound
from deitalk.audio.load import Recording, checked_waveform
from deitalk.audio.prosody import Prosody, measure_prosody
from deitalk.audio.vocal_strength import strength_frames, vocal_strength
from deitalk.audio.voice_activity import (
    band_levels,
    level_gain,
    normalise_level,
    speech_activity,
)
from deitalk.config.rules import Gates, HoldPose, VoiceIntensity
from deitalk.models.protocol import Tracks
from deitalk.postprocess.factors import expression_scale
from deitalk.postprocess.feeling import Phrases, felt_intensity, voice_intensity
from deitalk.postprocess.gates import expression_share, mouth_gate
from rig.arrays import Float32, Float64

EFFORT_SHARE, EFFORT_FRAMES = 0.7, 15.0
"""Share of a network's readout in the strength, and sigma of what counts around a frame."""
PHRASE_FRAMES = 10.0
"""Frames of a phrase at which its strength counts half."""
WITHIN_SHARE = 0.3
"""Share of what the strength changes within a phrase."""
CUT_FRAMES = 6
"""Frames of silence (0.2 s) at the end up to which a recording counts as cut in its speech."""


@dataclass(frozen=True, eq=False)
class Speech:
    """A recording with its speech activity; frames are at 30 Hz.

    Parameters
    ----------
    waveform : array [shape=(S,)]
        16 kHz, any level.
    activity : array [shape=(T,)]
        1 in speech, else 0.
    gates : Gates or None
        Times of the gates; None: they stay open.
    before, after : array
        Activity of the sound before and after it, on which the gates depend too; none by default.
    """

    waveform: Float32
    activity: Float32
    gates: Gates | None = field(default_factory=Gates)
    before: Float32 = field(default_factory=lambda: np.zeros(0, np.float32))
    after: Float32 = field(default_factory=lambda: np.zeros(0, np.float32))

    @classmethod
    def of(cls, waveform: Any, gates: Gates | None = Gates()) -> "Speech":
        """Measure a waveform.

        Raises
        ------
        AudioError
            If it is not one row of finite samples.
        """
        samples = checked_waveform(waveform)
        return cls(samples, speech_activity(samples), gates)

    @classmethod
    def of_recording(cls, recording: Recording, gates: Gates | None = Gates()) -> "Speech":
        """Measure a recording, whose activity is known already.

        Raises
        ------
        AudioError
            If its waveform is not one row of finite samples.
        """
        samples = checked_waveform(recording.waveform)
        return cls(samples, recording.activity, gates)

    @property
    def n_frames(self) -> int:
        """T, number of frames."""
        return frame_count(len(self.waveform))

    @property
    def times(self) -> Float64:
        """Time of each frame [shape=(T,), seconds]."""
        return frame_times(self.n_frames)

    @property
    def gain(self) -> float:
        """Factor that brings the speech to the level of the training."""
        return level_gain(self.waveform, activity=self.activity)

    @property
    def sound(self) -> Float32:
        """The waveform with its speech at the level of the training [shape=(S,)]."""
        return normalise_level(self.waveform, activity=self.activity)

    @property
    def is_cut(self) -> bool:
        """Whether the recording ends in speech."""
        return bool(self.activity[-1 - CUT_FRAMES :].any())

    @cached_property
    def mouth(self) -> Float32:
        """Mouth gate [shape=(T,), range 0 to 1]."""
        if self.gates is None:
            return np.ones(self.n_frames, np.float32)
        return self._of_take(mouth_gate(self._around, self.gates))

    def share(self, rest: float) -> Float32:
        """Share of the expression shown, of which `rest` stays in silence [shape=(T,)]."""
        if self.gates is None:
            return np.ones(self.n_frames, np.float32)
        return self._of_take(expression_share(self._around, rest, self.gates))

    @property
    def _around(self) -> Float32:
        """Activity with that of the sound before and after."""
        return np.concatenate((self.before, self.activity, self.after))

    def _of_take(self, gate: Float32) -> Float32:
        """Select the frames of the recording itself."""
        return gate[len(self.before) : len(self.before) + self.n_frames]

    @cached_property
    def prosody(self) -> Prosody:
        """Level, spectral tilt and pitch of each frame."""
        return measure_prosody(self.waveform, self.n_frames)

    def held(self, rule: HoldPose | None) -> Held:
        """Frames in which a held sound keeps its pose [each shape=(T,)]."""
        return held_sound(band_levels(self.waveform), self.prosody.tone, rule or HoldPose())

    @cached_property
    def _followed_strength(self) -> tuple[float, Float32]:
        return vocal_strength().follow(strength_frames(self.prosody, self.activity))

    @property
    def strength(self) -> float:
        """Strength of the whole voice at any gain, dB above the usual."""
        return float(self._followed_strength[0])

    def strengths(self, effort: Float32 | None = None) -> tuple[float, Float32]:
        """Strength of the whole voice, and of each frame's phrase [shape=(T,)], dB.

        The latter changes little within a phrase.

        Of a short phrase, which is measured badly, it is nearer to the whole. With a network's
        readout of the effort [shape=(T,), dB] the two are averaged.
        """
        strength, rows = phrase_strengths(*self._followed_strength, self.activity > 0, effort)
        return float(strength), rows


def phrase_strengths(
    strength: Array, around: Array, speaking: Array, effort: Array | None
) -> tuple[Array, Array]:
    """Strength of the voice, and that of each frame's phrase, as `Speech.strengths`.

    Parameters
    ----------
    strength, around : array or Tensor [shape=() and (T,)]
        From `deitalk.audio.vocal_strength.VocalStrength.follow`.
    speaking : array or Tensor of bool [shape=(T,)]
        Frames of speech.
    effort : array or Tensor [shape=(T,)], optional
        Readout of the network.
    """
    whole, exact = strength, around
    if effort is not None:
        used, xp = as_number(speaking), library(around)
        weight = xp.clip(smoothed(used, EFFORT_FRAMES), 1e-6, None)
        near = smoothed(used * effort, EFFORT_FRAMES) / weight
        strength = _shared(strength, mean_of(effort, speaking))
        exact, around = _shared(around, effort), _shared(around, near)
    phrases = Phrases(speaking)
    count = phrases.sums(speaking * 1.0)
    changed = count / (count + PHRASE_FRAMES) * (phrases.mean(exact) - strength)
    changed = changed + WITHIN_SHARE * (around - phrases.mean(around))
    rows = strength + phrases.inside * changed
    any_speech, where = speaking.any(), library(around).where
    return where(any_speech, strength, whole), single(where(any_speech, rows, whole))


def _shared(strength: Any, effort: Any) -> Any:
    """Mean of the strength by the prosody and of a network's readout, by `EFFORT_SHARE`."""
    return strength + EFFORT_SHARE * (effort - strength)


class Intensities(NamedTuple):
    """Emotional intensity of each frame [shape=(T,)], from the network to the face."""

    saliency: Float32
    """e_sim (DEITalk Eq. 5), -1 to 1."""
    network: Float32
    """Predicted by the network, 0 to 1."""
    held: Float32
    """Intensity already in the emotional reading, 0 to 2; by default `network`."""
    voice: Float32
    """Intensity of the voice, 0 to 1.2."""
    felt: Float32
    """Intensity of the emotion in the voice, 0 to 1.6."""
    share: Float32
    """Share of the expression that is shown, 0 to 1."""
    predicted: Float32
    """`felt` times `share`, 0 to 1.6."""
    applied: Float32
    """`predicted`, or the curve that was given, times the factor, 0 to 6.4."""
    scale: Float32
    """Factor on the difference of the emotional and the neutral reading, of which `share` is
    shown."""


def measure_intensities(
    speech: Speech,
    tracks: Tracks,
    acting: Acting,
    rule: VoiceIntensity | None = VoiceIntensity(),
    held: Callable[[Float32], Float32] = lambda network: network,
    weights: Float32 | None = None,
    factor: Float32 | float = 1.0,
) -> Intensities:
    """Intensity to apply in each frame, from the network, the voice and the acting.

    A network without an intensity module counts as one that predicts 1 everywhere. Without the
    `rule` of the voice's intensity the emotional reading is shown as it is, times the factor.
    `held` gives the intensity already in the emotional reading from the predicted one. Of a script
    come `weights` of the emotions [shape=(T, 9)], in place of the acting's, and a `factor`
    [shape=(T,)] on the intensity. A curve of the intensity and keyframes
    of the emotion are shown as drawn, in silence too.
    """
    network = np.ones(speech.n_frames, np.float32)
    saliency = np.zeros(speech.n_frames, np.float32)
    if tracks.strength is not None and tracks.saliency is not None:
        network, saliency = tracks.strength, tracks.saliency
    voice, curve = network, acting.intensity_curve
    if rule is not None:
        usual = 0.0
        if acting.voice is not None:  # as the network's takes are measured
            usual, effort = acting.voice.strength, acting.voice.effort
            if tracks.effort is not None and effort is not None:
                usual = float(_shared(usual, effort))
        _, around = speech.strengths(tracks.effort)
        voice = voice_intensity(network, speech.prosody, speech.activity > 0, around - usual, rule)
    share = np.ones(speech.n_frames, np.float32)
    if curve is None and not acting.is_keyed:
        share = speech.share(acting.rest)
    felt = voice
    if rule is not None:
        emotions = acting.emotion_track.at(speech.times) if weights is None else weights
        felt = felt_intensity(voice, emotions, rule).astype(np.float32)
    wanted = felt if curve is None else curve.at(speech.times).astype(np.float32)
    whole = np.asarray(wanted * acting.intensity * factor, np.float32)
    holds = held(network)
    scale = expression_scale(whole, holds)
    if rule is None and curve is None:
        scale = np.full(speech.n_frames, acting.intensity, np.float32)
    predicted = felt * (share if curve is None else speech.share(acting.rest))
    applied = whole * share
    return Intensities(saliency, network, holds, voice, felt, share, predicted, applied, scale)
