"""Distances between the styles of a model, and the range of the mouth in each.

The emotion of a take is an input, so that naming it from the curves cannot fail. What can:
whether two styles differ by more than two recordings of one style do, and how the range of the
mouth changes. Letters: T frames, C controls, R recordings.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from deitalk.audio.load import Recording
from deitalk.audio.voice_activity import speech_activity
from deitalk.emotions import EMOTIONS, IntensityCurve
from deitalk.evaluation.validation import JAW
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from rig.arrays import Bool, Float32
from rig.face import build_head

FULL = IntensityCurve(np.array([0.0, 1.0]), np.array([1.0, 1.0]))
"""Intensity 1 throughout."""


def styles_report(model: DEITalk, recordings: Sequence[Recording]) -> dict[str, Any]:
    """Animate every recording in every emotion, without blinks.

    Parameters
    ----------
    model : DEITalk
        In evaluation mode.
    recordings : sequence of Recording
        At least two, or spreads are NaN.

    Returns
    -------
    dict
        ``recordings``; ``styles`` (emotion: scores of `style_distances`, and ``range``,
        ``range_strong``, ``range_jaw``: median factors on the neutral range of the opening of the
        embedded head's lips at predicted intensity, at intensity 1 throughout, and of the jaw
        control at intensity 1);
        ``distances`` (pair: distance of the mean faces).
    """
    controls = model.controls
    lips = HeadLips(build_head())
    faces: dict[str, list[Float32]] = {emotion: [] for emotion in EMOTIONS}
    ranges: dict[str, dict[str, list[float]]] = {
        name: {emotion: [] for emotion in EMOTIONS}
        for name in ("range", "range_strong", "range_jaw")
    }
    for recording in recordings:
        speaking = speech_activity(recording.waveform) > 0
        if not speaking.any():
            continue
        for emotion in EMOTIONS:
            curves = animate(recording, emotion, model=model, life="off").curves.values
            full = animate(
                recording, emotion, model=model, intensity_curve=FULL, life="off"
            ).curves.values
            faces[emotion].append(curves[speaking].mean(axis=0))
            for name, track in (
                ("range", _lip_opening(lips, curves)),
                ("range_strong", _lip_opening(lips, full)),
                ("range_jaw", full[:, controls.index(JAW)]),
            ):
                ranges[name][emotion].append(lip_range(track, speaking))
    if not faces["neutral"]:
        return {"recordings": 0, "styles": {}, "distances": {}}
    styles, distances = style_distances({name: np.stack(rows) for name, rows in faces.items()})
    for name, values in ranges.items():
        base = ranges["range_jaw" if name == "range_jaw" else "range"]["neutral"]
        for emotion in EMOTIONS:
            styles[emotion][name] = _factor(values[emotion], base)
    return {"recordings": len(faces["neutral"]), "styles": styles, "distances": distances}


@torch.no_grad()
def _lip_opening(lips: HeadLips, curves: Float32) -> Float32:
    """Opening of the embedded head's lips [shape=(T,)]."""
    opening: Float32 = lips(torch.tensor(curves))[:, MEASURES.index("opening")].numpy()
    return opening


def style_distances(
    faces: Mapping[str, Float32],
) -> tuple[dict[str, dict[str, Any]], dict[str, float]]:
    """Distances between styles, against the spread within each.

    Parameters
    ----------
    faces : mapping
        Mean face over the speech of every recording [shape=(R, C)], by style.

    Returns
    -------
    styles : dict
        Per style ``spread`` (root mean square distance of a recording's mean face from the mean of
        the style's others, NaN for one recording), ``nearest`` (the style whose mean is nearest),
        ``distance`` to it, and ``separation``: the distance over the greater spread of the two.
    distances : dict
        ``first-second``: Euclidean distance of two mean faces, control units.
    """
    means = {name: rows.mean(axis=0) for name, rows in faces.items()}
    spreads = {name: _spread_of(rows) for name, rows in faces.items()}
    apart = {
        (a, b): float(np.linalg.norm(means[a] - means[b])) for a in means for b in means if a != b
    }
    styles: dict[str, dict[str, Any]] = {}
    for name in means:
        nearest = min((other for other in means if other != name), key=lambda b: apart[name, b])
        distance, widest = apart[name, nearest], max(spreads[name], spreads[nearest])
        styles[name] = {
            "spread": spreads[name],
            "nearest": nearest,
            "distance": distance,
            "separation": distance / widest if widest > 0 else float("nan"),
        }
    names = list(means)
    pairs = {f"{a}-{b}": apart[a, b] for i, a in enumerate(names) for b in names[i + 1 :]}
    return styles, pairs


def _spread_of(rows: Float32) -> float:
    """Root mean square distance of each row from the mean of all others."""
    count = len(rows)
    if count < 2:
        return float("nan")
    from_others = (rows - rows.mean(axis=0)) * count / (count - 1)
    return float(np.sqrt(np.square(from_others).sum(axis=1).mean()))


def lip_range(opening: Float32, speaking: Bool) -> float:
    """Range from the 5th to the 95th percentile of the mouth's opening during speech."""
    if not speaking.any():
        return float("nan")
    low, high = np.percentile(opening[speaking], (5, 95))
    return float(high - low)


def _factor(values: Sequence[float], base: Sequence[float]) -> float:
    """Median of values over those of the neutral style; NaN if it does not move."""
    known = np.asarray(base) > 1e-3
    if not known.any():
        return float("nan")
    return float(np.median(np.asarray(values)[known] / np.asarray(base)[known]))
