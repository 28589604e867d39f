"""Whether the curves of a clip come early or late against its sound.

Speech opens the jaw. Two signals are compared with the jaw at lags of -0.5 to 0.5 s: the level of
the band that vowels fill, which costs nothing, and the jaw that the embedded model gives the
recording, which differs between closed and open vowels. A clip is called shifted only if both are
shifted: loud consonants, short clips and long pauses mislead the level alone.

Letters: T frames at 60 per second, L lags.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import Recording
from deitalk.audio.vocal_strength import level_db
from rig import ControlSet, RigCurves
from rig.arrays import AnyFloat, Bool, Float32, Float64

# Scores of a prediction: the paper's errors, detection scores and correlation (DEITalk §4.2).
#
# Letters: T frames, C controls, N events.


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


RATE = 60
REACH = 30
"""Frames of the largest lag, 0.5 s."""
VOWEL_BAND_HZ = (100.0, 1870.0)
SUSPECT_FRAMES = 3
"""Lag of the level from which on the model is used."""
SHIFTED_FRAMES = 5
"""Lag from which on a clip may be called shifted: 83 ms."""
GAIN = (0.03, 0.6)
"""Correlation that the lag must gain: a part for all clips, and a share of what is missing to 1.
The tests hold: no clip of a built corpus is called shifted, and of those moved by 100 ms or more at
least 80 % are; of real mouths on video at most 7 % are."""
LAG_SECONDS = 0.012
"""The model's jaw follows people's, which is so much later than that of most captures."""
MODEL_SECONDS = 60.0
"""Of a longer clip the model gets the beginning."""
JAW = "CTRL_C_jaw.ty"


def loudness(waveform: Float32) -> Float64:
    """Level at 60 frames per second [shape=(T,), range 0 (-40 dB) to 1 (the loudest)]."""
    frames = np.arange(len(waveform) * RATE // SAMPLE_RATE)
    level = level_db(waveform, frames * SAMPLE_RATE // RATE)
    top = level.max(initial=-100)
    scaled: Float64 = np.clip(1 + (level - top) / 40, 0, 1)
    return scaled


def vowel_band(waveform: Float32) -> Float32:
    """The recording without what lies outside of `VOWEL_BAND_HZ` [shape=(S,)]."""
    spectrum = np.fft.rfft(waveform)
    hertz = np.fft.rfftfreq(len(waveform), 1 / SAMPLE_RATE)
    spectrum[(hertz < VOWEL_BAND_HZ[0]) | (hertz > VOWEL_BAND_HZ[1])] = 0
    return np.fft.irfft(spectrum, len(waveform)).astype(np.float32)


def lag_correlations(signal: Float64, jaw: Float64) -> Float64:
    """Correlation of what overlaps at every lag [shape=(L,)]; positive lags: curves come late.

    NaN for clips under 2 s, and where one of both never moves.
    """
    n = min(len(signal), len(jaw))
    signal, jaw = signal[:n], jaw[:n]
    if n < 4 * REACH or not (np.ptp(signal) > 1e-9 and np.ptp(jaw) > 1e-9):
        return np.full(2 * REACH + 1, np.nan)
    found = [
        correlation(signal[max(0, -k) : n - max(0, k)], jaw[max(0, k) : n - max(0, -k)])
        for k in range(-REACH, REACH + 1)
    ]
    lags: Float64 = np.nan_to_num(np.array(found))
    return lags


def model_lags(recording: Recording, level_lags: Float64, jaw: Float64) -> Float64 | None:
    """Correlation of the jaw with that of the embedded model by lag; None without suspicion.

    Parameters
    ----------
    recording : Recording
        The clip's sound.
    level_lags : ndarray [shape=(L,)]
        From `lag_correlations` with the level.
    jaw : ndarray [shape=(T,)]
        The clip's jaw on the audio's axis.

    Returns
    -------
    ndarray [shape=(L,)] or None
        `level_lags` themselves where the package has no embedded model.
    """
    if not np.isfinite(level_lags).all() or abs(peak(level_lags)) < SUSPECT_FRAMES:
        return None
    predicted = _predicted_jaw(_Key(recording))
    return level_lags if predicted is None else lag_correlations(predicted, jaw[: len(predicted)])


def peak(lags: Float64) -> int:
    """Lag of the largest correlation, in frames."""
    return int(lags.argmax()) - REACH


def is_clear(lags: Float64) -> bool:
    """Whether the best lag gains enough correlation over lag 0 (`GAIN`)."""
    best = float(lags.max())
    return bool(best - lags[REACH] > GAIN[0] + GAIN[1] * (1 - best))


def is_shifted(lags: Float64) -> bool:
    """Whether the best lag is far from 0 and clear; unknown lags (NaN) are not."""
    known = bool(np.isfinite(lags).all())
    return known and abs(peak(lags)) >= SHIFTED_FRAMES and is_clear(lags)


class _Key:
    """A recording that a cache can find again: two clips often share one."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording

    def __hash__(self) -> int:
        return id(self.recording)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and other.recording is self.recording


def predicted_curves(recording: Recording) -> RigCurves | None:
    """The embedded model's curves of a recording, neutral; None without a model.

    Of a recording of more than `MODEL_SECONDS` the beginning.
    """
    from deitalk.pipeline.curves import animate

    network = _network()
    if network is None:
        return None
    short = replace(recording, waveform=recording.waveform[: int(MODEL_SECONDS * SAMPLE_RATE)])
    return animate(short, "neutral", model=network).curves


@lru_cache(maxsize=8)
def _predicted_jaw(key: _Key) -> Float64 | None:
    """The embedded model's jaw at 60 frames per second [shape=(T,)]; None without a model."""
    curves = predicted_curves(key.recording)
    if curves is None:
        return None
    seconds = min(key.recording.duration, MODEL_SECONDS)
    at = np.arange(int(seconds * RATE)) / RATE
    jaw: Float64 = np.interp(at + LAG_SECONDS, curves.times, curves[JAW].astype(np.float64))
    return jaw


@lru_cache(maxsize=1)
def _network() -> Any:
    from deitalk.models.checkpoint import load_model
    from deitalk.models.folder import embedded_models

    return load_model("default") if "default" in embedded_models() else None
