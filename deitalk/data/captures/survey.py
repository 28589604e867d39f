"""Measures of captures by clip, take and actor; every clip is read once."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import Recording
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import speech_activity
from deitalk.data.captures.channels import ChannelFaults, asymmetry, channel_faults, swapped_takes
from deitalk.data.captures.conventions import Relations
from deitalk.data.captures.exchanged import Exchanged
from deitalk.data.captures.expressions import RULE, style_scores
from deitalk.data.captures.rest_pose import rest_pose
from deitalk.data.clips import Clip, read_known
from deitalk.data.offset import (
    ClipLags,
    ClipSignals,
    TakeSync,
    clip_lags,
    clip_signals,
    far_lag,
    fit_rate,
    predicted_curves,
    take_sync,
)
from rig import ControlSet, RigCurves
from rig.arrays import Bool, Float32, Float64
from rig.controls import DEFAULT_ID

AROUND_SPEECH_SECONDS = 0.2
"""Frames so near to speech are not silent: the mouth opens before and shuts after the sound."""
UNLIKE = 0.1
"""Score by which another emotion's must exceed that of a take's label."""


@dataclass(frozen=True)
class ClipSurvey:
    """Measures of one clip."""

    clip: Clip
    seconds: float
    speech_seconds: float
    faults: ChannelFaults
    lags: ClipLags | None
    known: Bool
    scores: Float64
    """Scores of happy, sad, angry and surprised during speech [shape=(4,)]."""
    asymmetry: Float64
    voiced: Float64
    """Pitch of the voiced frames, semitones over 100 Hz."""
    signals: ClipSignals | None = None
    """Signals of captured and predicted curves, where they can be laid over each other."""
    other_rate: tuple[float, float] | None = None
    """Rate of the curves, and the one at which they follow the sound; None if it is the same."""


MOST_FRAMES = 12_000
"""Frames whose median is a pose: 200 s at 60 per second, 9 MB."""


@dataclass
class Frames:
    """Evenly spread frames of any number: when there are too many, every second one goes."""

    parts: list[Float32] = field(default_factory=list)
    count: int = 0
    step: int = 1

    def add(self, values: Float32) -> None:
        """Take every `step`-th of some frames [shape=(T, C)]."""
        self.parts.append(values[:: self.step].copy())
        self.count += len(self.parts[-1])
        if self.count > MOST_FRAMES:
            self.parts = [self.rows[::2].copy()]
            self.count, self.step = len(self.parts[0]), 2 * self.step

    @property
    def rows(self) -> Float32:
        """All that are kept [shape=(T, C)]."""
        return np.concatenate(self.parts)


@dataclass
class Survey:
    """Measures of all captured clips."""

    controls: ControlSet
    clips: list[ClipSurvey] = field(default_factory=list)
    silent: dict[str, dict[str, Frames]] = field(default_factory=dict)
    """Silent frames by actor and emotion."""
    rates: dict[str, dict[str, float]] = field(default_factory=dict)
    by: str = "model"
    relations: Relations = field(default_factory=Relations)
    exchanged: Exchanged = field(init=False)

    def __post_init__(self) -> None:
        self.exchanged = Exchanged(self.controls)

    def add(self, clip: Clip, recording: Recording, curves: RigCurves) -> None:
        """Measure one clip."""
        board = curves.reorder(self.controls)
        values, known = board.values, read_known(clip.known, self.controls)
        predicted = predicted_curves(recording)
        self.by = "loudness" if predicted is None else "model"
        if predicted is not None:
            self.relations.add(clip, predicted, board, known)
        self.exchanged.add(clip, predicted, board, known)
        speech = speech_activity(recording.waveform) > 0
        speaking = _at(speech, board, clip.offset_seconds, beyond=False)
        margin = round(AROUND_SPEECH_SECONDS * curves.fps)
        loud = _at(speech, board, clip.offset_seconds, beyond=True)
        near = np.convolve(loud, np.ones(2 * margin + 1), mode="same") > 0
        emotions = self.silent.setdefault(clip.speaker, {})
        emotions.setdefault(clip.emotion, Frames()).add(values[~near])
        self.rates.setdefault(clip.speaker, {})[clip.emotion] = curves.fps
        prosody = measure_prosody(recording.waveform, recording.n_frames)
        place: Any = {"known": known, "offset": clip.offset_seconds, "start": clip.span[0]}
        rate = fit_rate(board, recording.waveform, predicted=predicted, **place)
        self.clips.append(
            ClipSurvey(
                clip,
                recording.duration,
                float(prosody.active.sum()) / FRAME_RATE if speaking.any() else 0.0,
                channel_faults(values, curves.fps, known, self.controls, speaking),
                clip_lags(board, recording.waveform, predicted=predicted, **place),
                known,
                style_scores(values, speaking, self.controls).astype(np.float64)
                if self.controls.id == DEFAULT_ID
                else np.zeros(len(RULE)),  # no rule is known of another rig
                asymmetry(values, known, self.controls),
                prosody.pitch[prosody.voiced],
                clip_signals(board, predicted=predicted, **place),
                None if rate is None else (curves.fps, rate),
            )
        )  # fmt: skip

    def by_take(self) -> dict[str, list[ClipSurvey]]:
        """Clips of every take."""
        return _grouped(self.clips, lambda c: c.clip.take)

    def by_actor(self) -> dict[str, list[ClipSurvey]]:
        """Clips of every actor."""
        return _grouped(self.clips, lambda c: c.clip.speaker)

    def sync(self) -> dict[str, TakeSync | None]:
        """Offset and drift of every take."""
        return {
            take: take_sync([c.lags for c in clips if c.lags is not None], by=self.by)
            for take, clips in self.by_take().items()
        }

    def far(self, take: str) -> float | None:
        """Lag of a take of more than a second behind its sound, seconds; None if none is clear."""
        signals = (clip.signals for clip in self.clips if clip.clip.take == take)
        return far_lag([each for each in signals if each is not None])

    def misread(self) -> dict[str, tuple[float, float]]:
        """Takes that follow their sound at another rate: the rate of the curves, and that one."""
        return {c.clip.take: c.other_rate for c in self.clips if c.other_rate is not None}

    def rests(self) -> dict[str, Float32]:
        """Pose at rest of the actors whose silence shows it."""
        poses = {
            actor: rest_pose(
                {emotion: frames.rows for emotion, frames in emotions.items()},
                self.rates[actor],
                self.controls,
            )
            for actor, emotions in self.silent.items()
        }
        return {actor: pose for actor, pose in poses.items() if pose is not None}

    def dead(self) -> Bool:
        """Controls that a source can record and that never move in any clip [shape=(C,)]."""
        known = np.any([c.known for c in self.clips], axis=0)
        moving = np.any([c.faults.moving for c in self.clips], axis=0)
        dead: Bool = known & ~moving
        return dead

    def swapped(self) -> list[str]:
        """Takes whose left and right are swapped in whole or in part."""
        found = []
        for take, clips in self.by_take().items():
            for measure in ("gaze", "sideways"):
                known = [v for c in clips if np.isfinite(v := getattr(c.faults, measure))]
                if known and float(np.median(known)) < -0.5:
                    found.append(take)
                    break
        for clips in self.by_actor().values():
            takes = _grouped(clips, lambda c: c.clip.take)
            means = [np.mean([c.asymmetry for c in own], axis=0) for own in takes.values()]
            found += [list(takes)[place] for place in swapped_takes(means)]
        return list(dict.fromkeys(found))

    def unlike(self) -> list[tuple[str, str, str]]:
        """Takes whose face shows another emotion than their label: take, label, seen."""
        names = list(RULE)
        found = []
        for clips in self.by_actor().values():
            rest = np.min([c.scores for c in clips], axis=0)
            for take, own in _grouped(clips, lambda c: c.clip.take).items():
                label = own[0].clip.emotion
                scores = np.mean([c.scores for c in own], axis=0) - rest
                mine = scores[names.index(label)] if label in names else 0.0
                best = int(scores.argmax())
                if names[best] != label and scores[best] - mine > UNLIKE and scores[best] > 0.15:
                    found.append((take, label, names[best]))
        return found

    def usable_seconds(self) -> dict[tuple[str, str], float]:
        """Usable seconds by actor and emotion: moving clips of takes that belong to their sound."""
        sync = self.sync()
        seconds: dict[tuple[str, str], float] = defaultdict(float)
        for c in self.clips:
            take = sync[c.clip.take]
            moves = bool(c.faults.moving.any()) and c.faults.frozen_seconds < c.seconds / 4
            is_usable = moves and take is not None and take.is_known and c.speech_seconds > 0
            seconds[c.clip.speaker, c.clip.emotion] += c.seconds if is_usable else 0.0
        return dict(seconds)


def _at(speech: Bool, curves: RigCurves, offset: float, *, beyond: bool) -> Bool:
    """Speech at the frames of curves [shape=(T,)]; `beyond` the clip's sound."""
    places = np.floor((curves.times + offset) * FRAME_RATE + 1e-6).astype(int)
    inside = (places >= 0) & (places < len(speech))
    result: Bool = np.where(inside, speech[np.clip(places, 0, max(len(speech) - 1, 0))], beyond)
    return result


def _grouped(
    clips: Sequence[ClipSurvey], key: Callable[[ClipSurvey], str]
) -> dict[str, list[ClipSurvey]]:
    groups: dict[str, list[ClipSurvey]] = defaultdict(list)
    for clip in clips:
        groups[key(clip)].append(clip)
    return dict(groups)
