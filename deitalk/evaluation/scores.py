"""Scores of a prediction: the paper's errors, detection scores and correlation (DEITalk §4.2).

Letters: T frames, C controls, N events.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from rig import ControlSet
from rig.arrays import AnyFloat, Bool


def parameter_error(target: AnyFloat, predicted: AnyFloat, controls: NDArray[np.integer]) -> float:
    """Mean over frames of the largest squared error among some controls (LPE, EPE; §4.2).

    Parameters
    ----------
    target, predicted : ndarray [shape=(T, C)]
        Captured and predicted curves.
    controls : ndarray [shape=(K,)]
        The set: 86 lip controls for LPE, 18 of the upper face for EPE.

    Returns
    -------
    float
        In squared control units; NaN for an empty set.

    Notes
    -----
    Paper silent: which 86 and 18 controls, and what "maximum error l2" squares. LVE, which the
    paper follows, is the largest squared distance among lip vertices, averaged over frames; for a
    scalar control it is the squared error. Values depend on the set and are not comparable with
    the paper's 0.00162 and 0.00079.
    """
    if not len(controls):
        return float("nan")
    return float(np.square(target[:, controls] - predicted[:, controls]).max(axis=1).mean())


def lip_parameter_error(
    target: AnyFloat, predicted: AnyFloat, controls: ControlSet, known: Bool | None = None
) -> float:
    """LPE over the control set's ``lip`` subset, as far as it is `known` [shape=(C,)]."""
    return parameter_error(target, predicted, _known(controls.subset("lip"), known))


def emotion_parameter_error(
    target: AnyFloat, predicted: AnyFloat, controls: ControlSet, known: Bool | None = None
) -> float:
    """EPE over the control set's ``upper_face`` subset, as far as it is `known` [shape=(C,)]."""
    return parameter_error(target, predicted, _known(controls.subset("upper_face"), known))


def _known(places: NDArray[np.intp], known: Bool | None) -> NDArray[np.intp]:
    return places if known is None else places[known[places]]


def correlation(a: AnyFloat, b: AnyFloat) -> float:
    """Pearson's r of two signals; NaN if one of them is constant."""
    a, b = a - a.mean(), b - b.mean()
    norm = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / norm if norm > 1e-9 else float("nan")


def mean_of_finite(values: Iterable[float]) -> float:
    """Mean of the values that are finite; NaN without any."""
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else float("nan")


def area_under_curve(positive: AnyFloat, negative: AnyFloat) -> float:
    """Area under the ROC curve: probability of a positive above a negative; ties count half."""
    if not len(positive) or not len(negative):
        return float("nan")
    ordered = np.sort(negative)
    below = np.searchsorted(ordered, positive, side="left")
    upto = np.searchsorted(ordered, positive, side="right")
    return float((below + upto).mean() / 2 / len(ordered))


def hit_rate(positive: AnyFloat, negative: AnyFloat, false_alarms: float = 0.05) -> float:
    """Share of positives above the threshold that `false_alarms` of the negatives exceed."""
    if not len(positive) or not len(negative):
        return float("nan")
    return float((positive > np.quantile(negative, 1 - false_alarms)).mean())
