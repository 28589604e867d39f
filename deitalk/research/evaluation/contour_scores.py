"""Rank correlation of intensity with labels, and of simple measures of the voice beside it.

Two labels. The corpus' own (`deitalk.research.corpus.performance`) holds ``NATURAL_WEIGHT`` times
the prosody index, which is a term of the prediction too: a score on it is circular, and the index
alone, which is printed beside, reaches nearly the same. The other is the contour along which
`apply_contour` changes level, treble, pitch and speed of a recording: it is known exactly, and no
measure of the voice is in it. Labels of people: `deitalk.research.evaluation.acted`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import Recording
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import speech_activity
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from deitalk.pipeline.performance import Performance
from deitalk.research.evaluation.contours import (
    apply_contour,
    contour_at,
    level_curve,
    prosody_index,
    random_contour,
    spearman,
)
from rig.arrays import Float32, Float64

EMOTION = "happy"
CONTOURS = 4
"""Random contours per recording; one contour of a few seconds has a large error."""


def follow(performance: Performance, network: Float32, label: Float32) -> dict[str, float]:
    """Spearman's rank correlation with a label, within speech.

    Parameters
    ----------
    performance : Performance
        A take as `deitalk animate` returns it: ``intensity_rho``.
    network : ndarray [shape=(T,)]
        Intensity of the network alone: ``network_rho``.
    label : ndarray [shape=(T,)]
        Intensity, or a contour. The recording's prosody index alone is ``index_rho``, its level
        at a fixed gain ``level_rho``.
    """
    waveform = performance.recording.waveform
    within = speech_activity(waveform) > 0
    n = min(len(within), len(label))
    tracks: dict[str, Float32 | Float64] = {
        "intensity_rho": performance.predicted,
        "network_rho": network,
        "index_rho": prosody_index(measure_prosody(waveform, len(within))),
        "level_rho": level_curve(waveform, len(within)),
    }
    return {name: spearman(label[:n], track[:n], within[:n]) for name, track in tracks.items()}


def contours_report(model: DEITalk, recordings: Sequence[Recording]) -> dict[str, float]:
    """Recordings modified along random contours: correlations of intensity with the contour.

    Returns
    -------
    dict
        Means over recordings of the scores of `follow`, `CONTOURS` contours each;
        ``above_level``, ``above_index``: intensity less level and less index, with standard errors
        over recordings (``..._error``).
    """
    rows = [_contours_of(model, recording, seed) for seed, recording in enumerate(recordings)]
    columns = {name: [row[name] for row in rows] for name in rows[0]} if rows else {}
    report = {name: _mean(values) for name, values in columns.items()}
    for other in ("level", "index"):
        rise = np.subtract(columns.get("intensity_rho", []), columns.get(f"{other}_rho", []))
        report |= {f"above_{other}": _mean(rise), f"above_{other}_error": _error(rise)}
    return report


def _contours_of(model: DEITalk, recording: Recording, seed: int) -> dict[str, float]:
    """`follow` of one recording, averaged over its contours."""
    rows = []
    for number in range(CONTOURS):
        take, contour = wandering(recording, CONTOURS * seed + number)
        performance = animate(take, EMOTION, model=model, life="off")
        network = animate(take, EMOTION, model=model, rules=False).predicted
        rows.append(follow(performance, network, contour))
    return {name: _mean([row[name] for row in rows]) for name in rows[0]}


def wandering(recording: Recording, seed: int) -> tuple[Recording, Float32]:
    """Recording along a random contour, and the contour [shape=(T,)]."""
    contour = random_contour(recording.duration, np.random.default_rng(seed))
    waveform, (source, moved) = apply_contour(recording.waveform, contour)
    take = replace(recording, waveform=waveform)
    times = np.interp(np.arange(take.n_frames) / FRAME_RATE, moved, source)
    return take, contour_at(contour, times).astype(np.float32)


def _mean(values: Sequence[float] | Float64) -> float:
    finite = _finite(values)
    return float(finite.mean()) if len(finite) else float("nan")


def _error(values: Sequence[float] | Float64) -> float:
    """Standard error of a mean."""
    finite = _finite(values)
    return float(finite.std(ddof=1) / np.sqrt(len(finite))) if len(finite) > 1 else float("nan")


def _finite(values: Sequence[float] | Float64) -> Float64:
    numbers = np.asarray(values, np.float64)
    return numbers[np.isfinite(numbers)]
