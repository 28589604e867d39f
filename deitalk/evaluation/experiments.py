"""Experiments on a few recordings: all emotions, modified prosody, noise.

All recordings are animated by `deitalk.pipeline.curves.animate` without blinks.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from deitalk.audio.load import Recording, load_audio
from deitalk.audio.noise import SNRS_DB, mix
from deitalk.audio.voice_activity import speech_activity
from deitalk.data.clips import Clip
from deitalk.emotions import EMOTIONS, IntensityCurve
from deitalk.emotions.rules import face_distance, lip_range, recognise
from deitalk.evaluation.lip_closures import closure_scores, summarise_closures
from deitalk.evaluation.opening import JAW, mouth_opening
from deitalk.evaluation.prosody_response import (
    STEP_Z,
    constant,
    halves,
    level_curve,
    modified,
    spearman,
    wandering,
)
from deitalk.evaluation.validation import lips_together, load_example
from deitalk.metrics import correlation
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import Performance
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64

FULL = IntensityCurve(np.array([0.0, 1.0]), np.array([1.0, 1.0]))
"""Intensity 1 throughout."""
LIVELY_EMOTION = "happy"
LEAST_FRAMES = 15
"""Least frames of speech of a compared half: half a second."""
CONTOURS = 4
"""Random contours per recording; one contour of a few seconds has a large error."""


def emotion_report(model: DEITalk, recordings: Sequence[Recording]) -> dict[str, Any]:
    """Animate every recording in every emotion: distances, recognition, range of the lips.

    Returns
    -------
    dict
        ``distances`` (pair: control units), ``named`` (emotion: {recognised: share}),
        ``recognised`` (share), ``neutral_stays`` (share), and ``range``, ``range_strong`` and
        ``range_jaw`` (emotion: median factor on the neutral range): mouth's opening at predicted
        intensity, at intensity 1 throughout, and the jaw alone at intensity 1.
    """
    controls = model.controls
    faces: dict[str, list[Float32]] = {emotion: [] for emotion in EMOTIONS}
    named: dict[str, list[str]] = {emotion: [] for emotion in EMOTIONS}
    ranges: dict[str, list[float]] = {emotion: [] for emotion in EMOTIONS}
    strong: dict[str, list[float]] = {emotion: [] for emotion in EMOTIONS}
    jaws: dict[str, list[float]] = {emotion: [] for emotion in EMOTIONS}
    for recording in recordings:
        speaking = speech_activity(recording.waveform) > 0
        for emotion in EMOTIONS:
            curves = _act(recording, emotion, model).curves.values
            faces[emotion].append(curves)
            named[emotion].append(recognise(curves, speaking, controls))
            ranges[emotion].append(lip_range(mouth_opening(curves, controls), speaking))
            full = _act(recording, emotion, model, FULL).curves.values
            strong[emotion].append(lip_range(mouth_opening(full, controls), speaking))
            jaws[emotion].append(lip_range(full[:, controls.index(JAW)], speaking))
    right = [name == emotion for emotion in EMOTIONS for name in named[emotion]]
    return {
        "recordings": len(recordings),
        "distances": _distances(faces),
        "named": {e: {o: named[e].count(o) / len(named[e]) for o in EMOTIONS} for e in EMOTIONS},
        "recognised": float(np.mean(right)),
        "neutral_stays": float(np.mean([name == "neutral" for name in named["neutral"]])),
        "range": _factors(ranges, ranges["neutral"]),
        "range_strong": _factors(strong, ranges["neutral"]),
        "range_jaw": _factors(jaws, jaws["neutral"]),
    }


def _act(
    recording: Recording, emotion: str, model: DEITalk, curve: IntensityCurve | None = None
) -> Performance:
    return animate(recording, emotion, model=model, intensity_curve=curve, idle=False)


def _distances(faces: dict[str, list[Float32]]) -> dict[str, float]:
    return {
        f"{first}-{second}": float(
            np.mean([face_distance(a, b) for a, b in zip(faces[first], faces[second], strict=True)])
        )
        for i, first in enumerate(EMOTIONS)
        for second in EMOTIONS[i + 1 :]
    }


def _factors(ranges: dict[str, list[float]], neutral: list[float]) -> dict[str, float]:
    base = np.array(neutral)
    known = base > 1e-3
    if not known.any():
        return {}
    return {
        emotion: float(np.median(np.array(values)[known] / base[known]))
        for emotion, values in ranges.items()
        if emotion != "neutral"
    }


def lively_report(model: DEITalk, recordings: Sequence[Recording]) -> dict[str, float]:
    """Compare recordings of raised and lowered prosody.

    Returns
    -------
    dict
        ``opens`` and ``expresses``: share of pairs in which the raised one has the wider mean
        opening, and the stronger mean expression; ``within_``: one half of a recording raised
        against the other, and the same half lowered (level is relative to the recording);
        ``whole_``: the whole recording; both over the frames of speech of the unmodified
        recording, so that the same words are compared. ``pairs_``: number of compared pairs.
        ``intensity_rho``, ``saliency_rho``, ``level_rho``: mean Spearman with the prosody index of
        recordings modified along random contours, within speech; ``..._contour``: with the
        contour alone, without the voice's own prosody. ``above_level``: difference of intensity
        and level, and ``..._error``: its standard error over recordings.
    """
    pairs: dict[str, list[bool]] = {}
    rhos: dict[str, list[float]] = {}
    for seed, recording in enumerate(recordings):
        _compare_whole(model, recording, pairs)
        _compare_halves(model, recording, pairs)
        for name, value in _follow_contours(model, recording, seed).items():
            rhos.setdefault(name, []).append(value)
    shares = {name: float(np.mean(values)) for name, values in pairs.items()}
    counts = {f"pairs_{kind}": len(pairs.get(f"{kind}_opens", ())) for kind in ("whole", "within")}
    errors = {f"{name}_error": _error(rhos[name]) for name in rhos if name.startswith("above")}
    return counts | shares | {name: _mean(values) for name, values in rhos.items()} | errors


def _follow_contours(model: DEITalk, recording: Recording, seed: int) -> dict[str, float]:
    """`follow` of one recording, averaged over its contours."""
    rhos: dict[str, list[float]] = {}
    for number in range(CONTOURS):
        take, contour, label = wandering(recording, CONTOURS * seed + number)
        performance = _act(take, LIVELY_EMOTION, model)
        for end, target in (("", label), ("_contour", contour)):
            for name, value in follow(performance, target).items():
                rhos.setdefault(name + end, []).append(value)
    means = {name: _mean(values) for name, values in rhos.items()}
    for end in ("", "_contour"):
        means[f"above_level{end}"] = means[f"intensity_rho{end}"] - means[f"level_rho{end}"]
    return means


def follow(performance: Performance, label: Float32) -> dict[str, float]:
    """Spearman of intensity, saliency and level with a label, within speech."""
    waveform = performance.recording.waveform
    within = speech_activity(waveform) > 0
    n = min(len(within), len(label))
    level = level_curve(waveform, len(within))
    tracks = {
        "intensity_rho": performance.predicted,
        "saliency_rho": performance.saliency,
        "level_rho": level,
    }
    return {name: spearman(label[:n], track[:n], within[:n]) for name, track in tracks.items()}


def _compare_whole(model: DEITalk, recording: Recording, pairs: dict[str, list[bool]]) -> None:
    spoken = speech_activity(recording.waveform) > 0
    opened, expressed = [], []
    for z in (STEP_Z, -STEP_Z):
        take, _, frames = modified(recording, constant(z, recording.duration))
        performance = _act(take, LIVELY_EMOTION, model)
        opened.append(_opening(performance, spoken[frames], model.controls))
        expressed.append(_expression(performance, spoken[frames]))
    _count(pairs, "whole_opens", *opened)
    _count(pairs, "whole_expresses", *expressed)


def _count(pairs: dict[str, list[bool]], name: str, raised: float, lowered: float) -> None:
    """Record whether the raised take has more; nothing if one of the two is not finite."""
    if np.isfinite(raised) and np.isfinite(lowered):
        pairs.setdefault(name, []).append(raised > lowered)


def _compare_halves(model: DEITalk, recording: Recording, pairs: dict[str, list[bool]]) -> None:
    spoken = speech_activity(recording.waveform) > 0
    opened, expressed = np.zeros((2, 2)), np.zeros((2, 2))
    for row, z in enumerate((STEP_Z, -STEP_Z)):
        take, contour, frames = modified(recording, halves(z, recording.duration))
        performance = _act(take, LIVELY_EMOTION, model)
        for half, sign in enumerate((1, -1)):
            mask = spoken[frames] & (contour * sign * z > 0)
            opened[row, half] = _opening(performance, mask, model.controls)
            expressed[row, half] = _expression(performance, mask)
    for name, values in (("within_opens", opened), ("within_expresses", expressed)):
        _count(pairs, name, values[0, 0], values[1, 0])
        _count(pairs, name, values[1, 1], values[0, 1])


def _opening(performance: Performance, mask: Bool, controls: ControlSet) -> float:
    return _mean_within(mouth_opening(performance.curves.values, controls), mask)


def _expression(performance: Performance, mask: Bool) -> float:
    """Distance of the face from its neutral reading: control units, mean of the frames."""
    away = performance.curves.values - performance.neutral.values
    return _mean_within(np.sqrt(np.square(away).sum(axis=1)), mask)


def _mean_within(values: Float32, mask: Bool) -> float:
    return float(values[mask].mean()) if mask.sum() >= LEAST_FRAMES else float("nan")


def noise_report(
    model: DEITalk,
    clips: Sequence[Clip],
    noises: Sequence[Float32],
    progress: Callable[[], None] = lambda: None,
) -> dict[str, dict[str, float]]:
    """Bilabials and jaw, clean and in noise; keys are ``clean`` and decibels."""
    steps: tuple[float | None, ...] = (None, *SNRS_DB)
    examples = [(load_audio(clip.audio), load_example(clip, model.controls)) for clip in clips]
    report = {}
    for snr in steps:
        scores, jaws = [], []
        for i, (recording, example) in enumerate(examples):
            mixture = recording
            if snr is not None:
                noisy = mix(recording.waveform, noises[i % len(noises)], snr)
                mixture = replace(recording, waveform=noisy)
            curves = _act(mixture, example.emotion, model).curves.values[: len(example.curves)]
            scores.append(closure_scores(lips_together(curves, model.controls), example.phones))
            place = model.controls.index(JAW)
            jaws.append(correlation(example.curves[: len(curves), place], curves[:, place]))
            progress()
        found = summarise_closures(scores)
        report["clean" if snr is None else f"{snr:g} dB"] = {
            "bilabial_window_auc": found.window_auc,
            "bilabial_hits_at_5_percent": found.hit_rate,
            "jaw_r": _mean(jaws),
        }
    return report


def _mean(values: "Sequence[float] | Float32") -> float:
    finite = _finite(values)
    return float(finite.mean()) if len(finite) else float("nan")


def _error(values: Sequence[float]) -> float:
    """Standard error of a mean."""
    finite = _finite(values)
    return float(finite.std(ddof=1) / np.sqrt(len(finite))) if len(finite) > 1 else float("nan")


def _finite(values: "Sequence[float] | Float32") -> Float64:
    numbers = np.asarray(values, np.float64)
    return numbers[np.isfinite(numbers)]
