"""Scores of one clip, collected over the clips of a group.

A clip is scored twice: as `deitalk animate` returns it, and by the network alone. Which differences
come from the network and which from the rules after it shows only where both are given. A causal
model is scored by the frames that it gives while the recording is spoken.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import Recording, load_audio
from deitalk.audio.voice_activity import speech_activity
from deitalk.data.clips import Clip
from deitalk.errors import DataError
from deitalk.evaluation.scores import (
    correlation,
    emotion_parameter_error,
    lip_parameter_error,
)
from deitalk.evaluation.smoothness import (
    Example,
    knows_contact,
    lips_together,
    load_example,
    loudness,
    smoothness,
)
from deitalk.evaluation.validation import JAW, ClosureScores, closure_scores, summarise_closures
from deitalk.live.animator import LiveAnimator
from deitalk.models.curve_model import DEITalk
from deitalk.models.protocol import CausalNetwork
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import Performance
from deitalk.postprocess.phones import (
    BILABIALS,
    SILENCE,
    WIDEN_FRAMES,
    Phones,
)
from deitalk.research.evaluation.contour_scores import follow
from deitalk.research.evaluation.gestures import (
    GESTURES,
    MAX_LAG_FRAMES,
    Peaks,
    gesture_curve,
    gesture_peaks,
    jaw_in_contact,
    phone_table,
    shut_frames,
    shut_table,
)
from deitalk.research.training.validation import ARTICULATION, articulation
from rig import ControlSet, read_curves
from rig.arrays import Bool, Float32, Float64


def lag_scores(target: Float32, predicted: Float32) -> Float64:
    """Correlation with the prediction shifted by -4 to 4 frames [shape=(9,)]."""
    edge = MAX_LAG_FRAMES
    if len(target) <= 3 * edge:
        return np.full(2 * edge + 1, np.nan)
    middle = target[edge:-edge]
    last = len(predicted) - edge
    return np.array(
        [correlation(middle, predicted[edge + k : last + k]) for k in range(-edge, edge + 1)]
    )


def global_lag_ms(scores: Sequence[Float64]) -> float:
    """Common lag of all clips: the peak of their mean `lag_scores`, interpolated by a parabola.

    Positive if the prediction is late.
    """
    known = [row for row in scores if np.isfinite(row).all()]
    if not known:
        return float("nan")
    mean = np.mean(known, axis=0)
    best = int(mean.argmax())
    offset = 0.0
    if 0 < best < len(mean) - 1:
        before, top, after = mean[best - 1 : best + 2]
        bend = before - 2 * top + after
        offset = 0.5 * float(before - after) / float(bend) if bend < 0 else 0.0
    return 1000 * (best - MAX_LAG_FRAMES + offset) / FRAME_RATE


class Tally:
    """Scores collected over the clips of one group."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        self.closures: list[ClosureScores] = []
        self.labelled: list[ClosureScores] = []
        """Closures of clips with at most `MOST_UNLABELLED` of their speech labelled silence."""
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
        labelled, baseline = map(summarise_closures, (self.labelled, self.baseline))
        return out | {
            "bilabial_window_auc": found.window_auc,
            "bilabial_frame_auc": found.frame_auc,
            "bilabial_hits_at_5_percent": found.hit_rate,
            "bilabial_hits_in_labelled_clips": labelled.hit_rate,
            "labelled_clips": len(self.labelled),
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
    if unlabelled_speech(speech_activity(example.waveform), example.phones) <= MOST_UNLABELLED:
        tally.labelled.append(tally.closures[-1])
    tally.held += held_closures(lips, example.phones)
    tally.shut.append(shut_frames(lips, example.phones))
    if example.known[jaw]:
        tally.lags["jaw"].append(lag_scores(target[:, jaw], predicted[:, jaw]))
    if knows_contact(example.known, controls):
        tally.lags["lips"].append(lag_scores(aim, lips))
    for name, gesture in GESTURES.items():
        curve = gesture_curve(predicted, controls, gesture)
        tally.peaks[name].append(gesture_peaks(curve, example.phones, gesture))


BESIDE_SECONDS = 0.15
"""Speech so near to a phone counts as labelled."""
MOST_UNLABELLED = 0.15
"""Share of speech without phones from which on the words do not fit: hesitations, repetitions,
words that the aligner squeezed together."""


def unlabelled_speech(activity: Float32, phones: Phones) -> float:
    """Share of a recording's speech that its phones label as silence; 0 without speech.

    Parameters
    ----------
    activity : ndarray [shape=(T,)]
        1 in speech, else 0 (`speech_activity`), which depends on the sound alone.
    phones : sequence of (start, end, name)
        Seconds.
    """
    times = np.arange(len(activity)) / FRAME_RATE
    speech = activity > 0
    labelled = np.zeros(len(times), bool)
    for start, end, name in phones:
        if name != SILENCE:
            labelled |= (times >= start - BESIDE_SECONDS) & (times < end + BESIDE_SECONDS)
    return float((speech & ~labelled).sum() / max(speech.sum(), 1))


def held_closures(lips: Float32, phones: Phones, level: float = 0.9) -> list[bool]:
    """For every bilabial, whether the curve is at least `level` for two frames of its window."""
    times = np.arange(len(lips)) / FRAME_RATE
    out = []
    slack = WIDEN_FRAMES / FRAME_RATE + 1e-9
    for start, end, name in phones:
        window = (times >= start - slack) & (times <= end + slack)
        if name in BILABIALS and window.any():
            high = lips[window] >= level
            out.append(bool((high[1:] & high[:-1]).any()))
    return out


OPENING = (JAW, "CTRL_L_mouth_upperLipRaise.ty", "CTRL_R_mouth_upperLipRaise.ty",
           "CTRL_L_mouth_lowerLipDepress.ty", "CTRL_R_mouth_lowerLipDepress.ty")  # fmt: skip
"""Controls whose mean is the mouth's opening."""


LONG_SECONDS = 0.6
"""Least length of a pause in which the mouth should close."""


def mouth_opening(curves: Float32, controls: ControlSet) -> Float32:
    """Mean of jaw, upper-lip and lower-lip opening [shape=(T,)]."""
    mean: Float32 = curves[:, [controls.index(name) for name in OPENING]].mean(axis=1)
    return mean


def opening_in_silence(opening: Float32, phones: Phones) -> float:
    """Mean opening in long pauses over its 95th percentile in speech.

    Pauses are those of the phones' times, not of the detector that closes the mouth in them. Their
    first 0.25 s and last 0.15 s, in which people relax and prepare, do not count.

    Parameters
    ----------
    opening : ndarray [shape=(T,)]
        At 30 frames per second.
    phones : sequence of (start, end, name)
        Seconds.

    Returns
    -------
    float
        NaN without a pause of `LONG_SECONDS`, or without speech.
    """
    times = np.arange(len(opening)) / FRAME_RATE
    silent, speaking = np.zeros(len(opening), bool), np.zeros(len(opening), bool)
    for start, end, name in phones:
        if name != SILENCE:
            speaking |= (times >= start) & (times < end)
        elif end - start > LONG_SECONDS:
            silent |= (times > start + 0.25) & (times < end - 0.15)
    if not silent.any() or not speaking.any():
        return float("nan")
    return float(opening[silent].mean() / (np.percentile(opening[speaking], 95) + 1e-9))


def captured_smoothness(path: Path, controls: ControlSet) -> dict[str, float]:
    """`smoothness` of captured curves at 30 frames per second, over controls of the rig.

    Raises
    ------
    DataError
        If no control moves.
    """
    curves = read_curves(path).resample(30.0)
    places = [i for i, name in enumerate(curves.names) if name in controls.names]
    measured = smoothness(curves.values[:, places]) if places else {}
    if not measured:
        raise DataError(f"{path}: no control of {controls.id} moves; give a take of speech")
    return measured


def live_frames(
    waveform: Float32, model: "str | Path | DEITalk | CausalNetwork", **options: Any
) -> Float32:
    """Frames of a whole recording, as they are given while it is spoken [shape=(T, C)].

    Parameters
    ----------
    waveform : array [shape=(S,)]
        As for `LiveAnimator.feed`.
    model, options
        As for `LiveAnimator`, of one stream.
    """
    animator = LiveAnimator(model, **options)
    frames: Float32 = np.concatenate((animator.feed(waveform), animator.finish()))
    return frames
