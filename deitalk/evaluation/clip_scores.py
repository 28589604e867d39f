"""Scores of one clip, collected over the clips of a group.

A clip is scored twice: as `deitalk animate` returns it, and by the network alone. Which differences
come from the network and which from the rules after it shows only where both are given. A causal
model is scored by the frames that it gives while the recording is spoken.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from deitalk.audio.frames import frame_centres
from deitalk.audio.load import Recording, load_audio
from deitalk.audio.prosody import level_db
from deitalk.data.clips import Clip
from deitalk.evaluation.lip_closures import (
    JAW,
    ClosureScores,
    closure_scores,
    held_closures,
    mouth_opening,
    opening_in_silence,
    smoothness,
    summarise_closures,
)
from deitalk.evaluation.phone_gestures import (
    GESTURES,
    Peaks,
    gesture_curve,
    gesture_peaks,
    global_lag_ms,
    jaw_in_contact,
    lag_scores,
    phone_table,
    shut_frames,
    shut_table,
)
from deitalk.evaluation.prosody_response import follow
from deitalk.evaluation.validation import (
    ARTICULATION,
    Example,
    articulation,
    knows_contact,
    lips_together,
    load_example,
)
from deitalk.live.animator import live_frames
from deitalk.metrics import correlation, emotion_parameter_error, lip_parameter_error
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import Performance
from rig.arrays import Bool, Float32, Float64


def loudness(waveform: Float32, n_frames: int) -> Float32:
    """Level of the recording on a scale of 40 dB [shape=(T,), range 0 to 1]: the baseline."""
    level = level_db(waveform, frame_centres(np.arange(n_frames)))
    top = np.percentile(level, 95)
    scaled: Float32 = np.clip(1 + (level - top) / 40, 0, 1).astype(np.float32)
    return scaled


class Tally:
    """Scores collected over the clips of one group."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        self.closures: list[ClosureScores] = []
        self.baseline: list[ClosureScores] = []
        self.held: list[bool] = []
        self.lags: dict[str, list[Float64]] = {"jaw": [], "lips": []}
        self.peaks: dict[str, list[Peaks]] = {name: [] for name in GESTURES}
        self.shut: list[dict[str, tuple[int, int]]] = []

    def summary(self) -> dict[str, Any]:
        """Means over clips, and pooled closures."""
        names = sorted({name for row in self.rows for name in row})
        out: dict[str, Any] = {"clips": len(self.rows)}
        for name in names:
            values = np.array(
                [row[name] for row in self.rows if np.isfinite(row.get(name, np.nan))]
            )
            out[name] = float(values.mean()) if len(values) else float("nan")
        found = summarise_closures(self.closures, self.held)
        baseline = summarise_closures(self.baseline)
        return out | {
            "bilabial_window_auc": found.window_auc,
            "bilabial_frame_auc": found.frame_auc,
            "bilabial_hits_at_5_percent": found.hit_rate,
            "found_bilabials_held_at_0.9": found.reached,
            "bilabials": found.n_closures,
            "vowels": found.n_vowels,
            "loudness_bilabial_window_auc": baseline.window_auc,
            "shut_on_other_sounds": shut_table(self.shut)["all"]["shut"],
            "jaw_lag_ms": global_lag_ms(self.lags["jaw"]),
            "lips_lag_ms": global_lag_ms(self.lags["lips"]),
        }

    def phones(self) -> dict[str, dict[str, dict[str, float]]]:
        """Per gesture and phone: number, hits and AUC."""
        return {name: phone_table(self.peaks[name], g) for name, g in GESTURES.items()}


class ClipToScore(NamedTuple):
    """A recording with its targets."""

    neutral: Clip
    """Scored for everything but the upper face; of another emotion if it has no neutral target."""
    acted: Clip
    """Scored for the upper face: neutral brows have no error worth measuring."""


class Scores(NamedTuple):
    """Scores of one group, of both predictions."""

    animated: Tally
    network: Tally


def animated(recording: Recording, emotion: str, model: DEITalk, *, raw: bool) -> Performance:
    """Animate one recording without blinks; with a causal model and rules, as it is spoken."""
    performance = animate(recording, emotion, model=model, life="off", rules=not raw)
    if raw or not model.is_causal:
        return performance
    values = live_frames(recording.waveform, model, emotion=emotion, life="off")
    return replace(performance, curves=replace(performance.curves, values=values))


def score_clip(scores: Scores, model: DEITalk, clip: ClipToScore) -> None:
    """Animate one recording with and without rules and collect its scores."""
    recording = load_audio(clip.neutral.audio)
    example = load_example(clip.neutral, model.controls)
    takes = [animated(recording, clip.neutral.emotion, model, raw=raw) for raw in (False, True)]
    acted = takes
    target = example
    if clip.acted != clip.neutral:
        target = load_example(clip.acted, model.controls)
        acted = [animated(recording, clip.acted.emotion, model, raw=raw) for raw in (False, True)]
    level = loudness(recording.waveform, len(example.curves))
    for tally, take, other in zip(scores, takes, acted, strict=True):
        row = _row(tally, take, example, model, level)
        if target.emotion != "neutral":
            row["epe"] = _upper_face(other, target, model)
        tally.rows.append(row)
    if np.isfinite(example.intensity).all():
        followed = follow(takes[0], takes[1].predicted, example.intensity)
        scores.animated.rows[-1] |= followed
        scores.network.rows[-1]["intensity_rho"] = followed["network_rho"]


def _row(
    tally: Tally, take: Performance, example: Example, model: DEITalk, level: Float32
) -> dict[str, float]:
    """Scores of one prediction; closures and gestures are collected."""
    controls = model.controls
    predicted, target = aligned(take, example)
    n_frames = len(predicted)
    row = _errors(target, predicted, example.known, model) | smoothness(predicted)
    jaw = controls.index(JAW)
    if example.known[jaw]:
        row["loudness_jaw_r"] = correlation(target[:, jaw], level[:n_frames])
    row["opening_in_silence"] = opening_in_silence(
        mouth_opening(predicted, controls), example.phones
    )
    _contacts(tally, row, example, predicted, target, model)
    tally.baseline.append(closure_scores(1 - level[:n_frames], example.phones))
    return row


def aligned(take: Performance, example: Example) -> tuple[Float32, Float32]:
    """Predicted and target curves of the same frames [shape=(T, C)]."""
    n_frames = min(len(take.curves.values), len(example.curves))
    return take.curves.values[:n_frames], example.curves[:n_frames]


def _upper_face(take: Performance, example: Example, model: DEITalk) -> float:
    """EPE of an acted take."""
    predicted, target = aligned(take, example)
    return emotion_parameter_error(target, predicted, model.controls, example.known)


def _errors(target: Float32, predicted: Float32, known: Bool, model: DEITalk) -> dict[str, float]:
    """LPE, and r of every articulation channel, where they are known."""
    controls = model.controls
    rs = articulation(target, predicted, known, controls)
    finite = [r for r in rs if np.isfinite(r)]
    channels = {f"r {n.removeprefix('CTRL_')}": r for n, r in zip(ARTICULATION, rs, strict=True)}
    return channels | {
        "jaw_r": rs[0],
        "articulation_r": float(np.mean(finite)) if finite else float("nan"),
        "lpe": lip_parameter_error(target, predicted, controls, known),
    }


def _contacts(
    tally: Tally,
    row: dict[str, float],
    example: Example,
    predicted: Float32,
    target: Float32,
    model: DEITalk,
) -> None:
    """Closures, gestures of single phones, and their timing."""
    controls = model.controls
    lips, aim = lips_together(predicted, controls), lips_together(target, controls)
    jaw = controls.index(JAW)
    row["jaw_in_contact"] = jaw_in_contact(lips, predicted[:, jaw])
    tally.closures.append(closure_scores(lips, example.phones))
    tally.held += held_closures(lips, example.phones)
    tally.shut.append(shut_frames(lips, example.phones))
    if example.known[jaw]:
        tally.lags["jaw"].append(lag_scores(target[:, jaw], predicted[:, jaw]))
    if knows_contact(example.known, controls):
        tally.lags["lips"].append(lag_scores(aim, lips))
    for name, gesture in GESTURES.items():
        curve = gesture_curve(predicted, controls, gesture)
        tally.peaks[name].append(gesture_peaks(curve, example.phones, gesture))
