"""Whether curves come early or late against their sound: of a clip, and of a take with its drift.

Jaw, contacts, rounding, spreading and lips of the capture are correlated with the same groups of
the curves that `default` predicts of the recording, at lags of up to a second; the squares of the
correlations are summed over groups, and over the clips of a take along lines of lag by time. The
sum peaks sharper and at fewer wrong places than the correlation of any one group. Of another rig
than the board the first principal components of its curves replace the groups; where there is no
model, the level of the band that vowels fill replaces its curves.

Measured on clips of 5 to 15 s (40 of a hand-animated rig, 44 of lips on video, 20 of a built
corpus) that were moved by 1 to 15 thirtieths of a second, against the same clips unmoved: the
move is found to a third of a frame (11 ms) in 99.6, 100 and 100 %. Unmoved clips scatter by 10 to
15 ms each, and pooled over a speaker on video by -4 to 10 ms: as much as people's mouths and
sound.

Letters: T frames at 120 per second, L lags, K clips.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import Recording
from deitalk.audio.prosody import level_db
from rig import RigCurves
from rig.arrays import Bool, Float32, Float64
from rig.controls import DEFAULT_ID

RATE = 120
REACH = RATE
"""Frames of the largest lag, a second."""
LAGS = np.arange(-REACH, REACH + 1) / RATE
"""Seconds [shape=(L,)]."""
LARGEST_SECONDS = 0.6
"""Largest lag of a clip, and of the middle of a take."""
VOWEL_BAND_HZ = (100.0, 1870.0)
MODEL_SECONDS = 60.0
"""Longest part of a clip, from its beginning, that the model reads."""
GROUPS = {
    "jaw": ("CTRL_C_jaw.ty",),
    "contact": ("lipsTogether",),
    "round": ("purse", "funnel"),
    "forward": ("towards",),
    "spread": ("mouth_stretch.",),
    "corners": ("cornerPull",),
    "upper": ("upperLipRaise",),
    "lower": ("lowerLipDepress",),
    "press": ("lipPress", "mouth_press"),
}
"""Parts of names of the controls whose mean is one signal."""
SMOOTH_SECONDS = 0.3
"""Slower movement is removed: postures and expressions."""
COMPONENTS = 3
"""Principal components of another rig: jaw, rounding, lips; six and more find fewer lags."""
STILL = 1e-3
LEAST_SECONDS = 2.0
LEAST_CORRELATION = 0.3
"""Root mean square over the groups; the takes above have .38 and more."""
SHIFTED_SECONDS = 0.015
"""Lag from which on a take is shifted, half a frame: more than people's and the model's own."""
CLIP_ERROR_SECONDS = 0.015
"""Standard deviation of the lag of a clip of 5 s."""
DRIFTS = np.arange(-1500, 1501, 50) * 1e-6
LEAST_DRIFT = 150e-6
DRIFT_SPAN_SECONDS = 60.0
"""Time between first and last clip from which on a drift is looked for."""
DRIFT_CLIPS = 4
DRIFT_GAIN = 0.03
"""Share that the sum must gain by a drift."""
CLIP_SHIFT_SECONDS = 5 / 60
"""Lag from which on a single clip may be called shifted."""
GAIN = (0.03, 0.12, 0.6)
"""Correlation that the lag of a single clip must gain: a part for all clips, a part divided by the
number of groups (one alone peaks at wrong places more often), and a share of what is missing to 1.
The tests hold: no clip of a built corpus is called shifted, and of those moved by 100 ms or more
at least 90 % are; of real mouths on video, of which the jaw alone is known, at most 7 % are."""
RATIOS = (0.4, 0.5, 0.8, 5 / 6, 0.96, 25 / 24, 1.2, 1.25, 2.0, 2.5)
"""Ratios of two rates of 24, 25, 30, 48, 50, 60 and 120 Hz."""
RATIO_LEAST, RATIO_GAIN, RATIO_LEAD = 0.38, 0.12, 0.06
"""Correlation at another rate, which it must gain over the take's own, and over all others. Five
takes of a hand-animated rig, 12 s of each, gain .17 to .42 at their own rate and .08 over the next;
curves of another sound reached .35."""
RATIO_SECONDS = 3.0
FIRST_SECONDS = 2.0
"""Latest start of a clip that is tested at other rates, at which later ones lie elsewhere."""
FAR_RATE = 30
"""Frames per second at which a take is laid over its sound at any lag."""
FAR_OVERLAP_SECONDS = 15.0
"""Least of both that overlaps."""
FAR_LEAST, FAR_LEAD = 0.4, 0.08
"""Least correlation at such a lag, and over that of all others that are a second and more away. Of
takes moved by 5 and 30 s it was .48 and .50, .1 over the next; of another sound .34, and .04."""
NTSC_DRIFT = 1 / 1001
"""29.97 against 30, 48 against 48.048 kHz."""


@dataclass(frozen=True)
class ClipLags:
    """Estimate of the lag from one clip."""

    scores: Float64
    """Sum of the groups' signed squared correlations by lag [shape=(L,)]; positive lags: the curves
    are late."""
    n_groups: int
    centre: float
    """Middle of the clip in its take, seconds."""
    seconds: float

    @property
    def lag(self) -> float:
        """Lag of the curves behind the sound, seconds."""
        return sharpest_peak(self.scores)

    @property
    def correlation(self) -> float:
        """Root mean square over the groups at the best lag."""
        return float(np.sqrt(max(self.scores.max(), 0.0) / self.n_groups))

    @property
    def is_clear(self) -> bool:
        """Whether the best lag gains enough correlation over lag 0 (`GAIN`)."""
        still, best = np.sqrt(
            np.maximum([self.scores[REACH], self.scores.max()], 0) / self.n_groups
        )
        return bool(best - still > GAIN[0] + GAIN[1] / self.n_groups + GAIN[2] * (1 - best))

    @property
    def is_shifted(self) -> bool:
        """Whether the clip by itself is early or late."""
        return abs(self.lag) >= CLIP_SHIFT_SECONDS and self.is_clear


@dataclass(frozen=True)
class ClipSignals:
    """Groups of a clip, at `FAR_RATE` from its start in the take on."""

    start: float
    captured: Float32
    """[shape=(G, T)]; groups that the source cannot know are 0."""
    wanted: Float32
    """The same of a model's curves of the sound [shape=(G, T)]."""


def clip_signals(
    curves: RigCurves, *, predicted: RigCurves | None, known: Bool, offset: float, start: float
) -> ClipSignals | None:
    """Signals of a clip; parameters as of `clip_lags`. None of another rig, or without a model."""
    if predicted is None or curves.control_set != DEFAULT_ID:
        return None
    at = np.arange(int(min(curves.duration, predicted.duration) * FAR_RATE)) / FAR_RATE
    names = {curves.names[i] for i in np.flatnonzero(known)}
    captured = _signals(curves, names, curves.times + offset, at)
    wanted = _signals(predicted, names, predicted.times, at)
    rows = np.zeros((2, len(GROUPS), len(at)), np.float32)
    for place, group in enumerate(GROUPS):
        for row, signals in zip(rows, (captured, wanted), strict=True):
            row[place] = signals.get(group, 0.0)
    return ClipSignals(start, *rows)


def far_lag(clips: Sequence[ClipSignals]) -> float | None:
    """Lag of a take's curves behind its sound, seconds, of any size; None if none is clear.

    All groups of the whole take are correlated where curves and sound overlap.
    """
    from scipy.signal import fftconvolve

    if not clips:
        return None
    size = max(round(c.start * FAR_RATE) + c.captured.shape[1] for c in clips)
    captured, wanted = np.zeros((2, len(GROUPS), size))
    there = np.zeros(size)
    for clip in clips:
        first = round(clip.start * FAR_RATE)
        part = slice(first, first + clip.captured.shape[1])
        there[part] = 1
        for rows, own in ((captured, clip.captured), (wanted, clip.wanted)):
            rows[:, part] = own - own.mean(axis=1, keepdims=True)

    def over(a: Float64, b: Float64) -> Float64:
        found: Float64 = fftconvolve(a, b[::-1])
        return found

    overlap = over(there, there)
    total, count = np.zeros(2 * size - 1), 0
    for a, b in zip(captured, wanted, strict=True):
        if min(a.std(), b.std()) > STILL:
            size_of = np.sqrt(np.maximum(over(a * a, there) * over(there, b * b), 1e-12))
            r = over(a, b) / size_of
            total, count = total + np.sign(r) * r**2, count + 1
    total[overlap < FAR_OVERLAP_SECONDS * FAR_RATE] = 0
    if not count:
        return None
    found = np.sqrt(np.maximum(total / count, 0))
    best = int(found.argmax())
    others = np.delete(found, slice(max(best - FAR_RATE, 0), best + FAR_RATE + 1))
    is_clear = found[best] >= max(FAR_LEAST, others.max(initial=0.0) + FAR_LEAD)
    return (best - (size - 1)) / FAR_RATE if is_clear else None


@dataclass(frozen=True)
class TakeSync:
    """Offset and drift of one take."""

    lag: float
    """Lag of the curves behind the sound in the middle of the take, seconds."""
    drift: float
    """Seconds of lag gained per second; positive: the curves run slow."""
    middle: float
    """Time in the take to which `lag` belongs, seconds."""
    correlation: float
    error: float
    """Standard error of the lag, seconds."""
    by: str
    """`model` or `loudness`."""

    @property
    def is_known(self) -> bool:
        """Whether curves and sound belong together clearly enough."""
        return self.correlation >= LEAST_CORRELATION

    @property
    def is_shifted(self) -> bool:
        """Whether the take is to be mended."""
        late = abs(self.lag) >= max(SHIFTED_SECONDS, 2 * self.error)
        return self.is_known and (late or self.drift != 0)

    def lag_at(self, seconds: float) -> float:
        """Lag at a time of the take, seconds."""
        return self.lag + self.drift * (seconds - self.middle)


def predicted_curves(recording: Recording) -> RigCurves | None:
    """The embedded model's curves of a recording, neutral; None without a model.

    Of a recording of more than `MODEL_SECONDS` the beginning.
    """
    from deitalk.pipeline.curves import animate

    network = _network()
    if network is None:
        return None
    short = replace(recording, waveform=recording.waveform[: int(MODEL_SECONDS * SAMPLE_RATE)])
    return animate(short, "neutral", model=network, life="off", rules=False).curves


@lru_cache(maxsize=1)
def _network() -> Any:
    from deitalk.models.checkpoint import load_model
    from deitalk.models.folder import embedded_models

    if "default" not in embedded_models():
        return None
    network = load_model("default")
    network.lips = None  # without its readout the curves of lips agree more with captured ones
    return network


def clip_lags(
    curves: RigCurves,
    waveform: Float32,
    *,
    predicted: RigCurves | None,
    known: Bool | None = None,
    offset: float = 0.0,
    start: float = 0.0,
) -> ClipLags | None:
    """Correlate a clip with a model's curves of its sound; None if it is short or still.

    Parameters
    ----------
    curves : RigCurves
        Captured board channels, or controls of another rig: their principal components
        then replace the groups.
    waveform : ndarray [shape=(S,)]
        The clip's sound at 16 kHz.
    predicted : RigCurves or None
        A model's curves of the sound; None: the level replaces them.
    known : array of bool [shape=(C,)] or None
        Columns of `curves` that the source can know.
    offset : float
        Of the curves after the sound, seconds.
    start : float
        Of the clip in its take, seconds.
    """
    seconds = min(len(waveform) / SAMPLE_RATE, curves.duration)
    if seconds < LEAST_SECONDS:
        return None
    at = np.arange(int(seconds * RATE)) / RATE
    columns = range(len(curves.names)) if known is None else np.flatnonzero(known)
    names = {curves.names[i] for i in columns}
    if predicted is None:
        # Level of the vowels' band at given seconds, 0 (40 dB below the loudest) to 1.
        level = level_db(vowel_band(waveform), (at * SAMPLE_RATE).astype(int))
        scaled: Float64 = np.clip(1 + (level - level.max(initial=-100)) / 40, 0, 1)
        wanted: Mapping[str, Float64] = {"jaw": scaled}
    else:
        on_board = curves.control_set == DEFAULT_ID
        wanted = _signals(
            predicted, names if on_board else set(predicted.names), predicted.times, at
        )
    if curves.control_set != DEFAULT_ID:
        return _rig_lags(curves, names, curves.times + offset, at, list(wanted.values()), start)
    captured = _signals(curves, names, curves.times + offset, at)
    groups = [
        _lag_correlations(_quick(captured[name]), _quick(wanted[name]))
        for name in captured.keys() & wanted.keys()
        if np.ptp(captured[name]) > STILL and np.ptp(wanted[name]) > STILL
    ]
    if not groups:
        return None
    scores: Float64 = np.sum([np.sign(r) * r**2 for r in groups], axis=0)
    return ClipLags(scores, len(groups), start + seconds / 2, seconds)


def fit_rate(
    curves: RigCurves,
    waveform: Float32,
    *,
    predicted: RigCurves | None,
    known: Bool | None = None,
    offset: float = 0.0,
    start: float = 0.0,
) -> float | None:
    """Rate at which the first clip of a take follows its sound, if it clearly is not its own.

    Parameters are those of `clip_lags`; None for later clips and short ones, and without a model.
    """
    seconds = len(waveform) / SAMPLE_RATE
    if predicted is None or start > FIRST_SECONDS or seconds < RATIO_SECONDS:
        return None
    found: dict[float, float] = {}
    for ratio in (1.0, *RATIOS):
        lags = clip_lags(
            replace(curves, fps=curves.fps / ratio),
            waveform,
            predicted=predicted,
            known=known,
            offset=(start + offset) * ratio - start,
            start=start,
        )
        found[ratio] = 0.0 if lags is None else lags.correlation
    best = max(RATIOS, key=lambda ratio: found[ratio])
    others = max(value for ratio, value in found.items() if ratio != best)
    is_clear = found[best] >= max(found[1.0] + RATIO_GAIN, others + RATIO_LEAD, RATIO_LEAST)
    return curves.fps / best if is_clear else None


def take_sync(clips: Sequence[ClipLags], *, by: str = "model") -> TakeSync | None:
    """Offset and drift that all clips of a take agree on; None without clips."""
    if not clips:
        return None
    weights = np.array([clip.seconds for clip in clips])
    centres = np.array([clip.centre for clip in clips])
    middle = float((weights * centres).sum() / weights.sum())
    can_drift = len(clips) >= DRIFT_CLIPS and np.ptp(centres) >= DRIFT_SPAN_SECONDS
    still = _along(clips, weights, centres - middle, 0.0)
    drift, best = 0.0, still
    if can_drift:
        sums = [_along(clips, weights, centres - middle, drift) for drift in DRIFTS]
        place = int(np.argmax([s.max() for s in sums]))
        gain = sums[place].max() - still.max()
        if abs(DRIFTS[place]) >= LEAST_DRIFT and gain >= DRIFT_GAIN * still.max():
            drift = float(DRIFTS[place])
            if abs(abs(drift) - NTSC_DRIFT) <= 2.5e-4:
                drift = float(np.sign(drift)) * NTSC_DRIFT
            best = _along(clips, weights, centres - middle, drift)
    lag = sharpest_peak(best)
    n_groups = float((weights * [clip.n_groups for clip in clips]).sum() / weights.sum())
    correlation = float(np.sqrt(max(best.max(), 0.0) / n_groups))
    own = np.array(
        [sharpest_peak(clip.scores, near=lag + drift * (clip.centre - middle)) for clip in clips]
    )
    off = own - (lag + drift * (centres - middle))
    spread = max(1.4826 * float(np.median(np.abs(off))), CLIP_ERROR_SECONDS)
    return TakeSync(lag, drift, middle, correlation, spread / len(clips) ** 0.5, by)


def _rig_lags(
    curves: RigCurves,
    names: set[str],
    times: Float64,
    at: Float64,
    wanted: Sequence[Float64],
    start: float,
) -> ClipLags | None:
    """Lags of another rig: how much of the groups its first components explain."""
    columns = [curves[name].astype(np.float64) for name in curves.names if name in names]
    moving = [_quick(np.interp(at, times, c)) for c in columns if np.ptp(c) > STILL]
    targets = [_quick(signal) for signal in wanted if np.ptp(signal) > STILL]
    if len(moving) < COMPONENTS or not targets:
        return None
    captured, target = np.stack(moving, axis=1), np.stack(targets, axis=1)
    parts = np.linalg.svd(captured - captured.mean(axis=0), full_matrices=False)[0]
    parts, n = parts[:, :COMPONENTS], len(at)
    scores = np.zeros(2 * REACH + 1)
    for place, k in enumerate(range(-REACH, REACH + 1)):
        if n - abs(k) < n / 2:
            continue
        a, b = parts[max(0, k) : n - max(0, -k)], target[max(0, -k) : n - max(0, k)]
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        explained = np.linalg.qr(a)[0].T @ b
        scores[place] = ((explained**2).sum(axis=0) / np.maximum((b * b).sum(axis=0), 1e-12)).sum()
    seconds = n / RATE
    return ClipLags(scores, len(targets), start + seconds / 2, seconds)


def _signals(curves: RigCurves, names: set[str], times: Float64, at: Float64) -> dict[str, Float64]:
    """Means of the groups' controls at given seconds, of controls in `names`."""
    found = {}
    for group, parts in GROUPS.items():
        members = [n for n in curves.names if n in names and any(part in n for part in parts)]
        if members:
            mean = np.mean([curves[name].astype(np.float64) for name in members], axis=0)
            found[group] = np.interp(at, times, mean)
    return found


def vowel_band(waveform: Float32) -> Float32:
    """The recording without what lies outside of `VOWEL_BAND_HZ` [shape=(S,)]."""
    spectrum = np.fft.rfft(waveform)
    hertz = np.fft.rfftfreq(len(waveform), 1 / SAMPLE_RATE)
    spectrum[(hertz < VOWEL_BAND_HZ[0]) | (hertz > VOWEL_BAND_HZ[1])] = 0
    return np.fft.irfft(spectrum, len(waveform)).astype(np.float32)


def _quick(signal: Float64) -> Float64:
    from scipy.ndimage import gaussian_filter1d  # takes a fifth of a second

    slow: Float64 = gaussian_filter1d(signal, SMOOTH_SECONDS * RATE, mode="nearest")
    return signal - slow


def _lag_correlations(captured: Float64, wanted: Float64) -> Float64:
    """Correlation of what overlaps at every lag [shape=(L,)]; 0 where less than half does."""
    n = len(captured)
    found = np.zeros(2 * REACH + 1)
    for place, k in enumerate(range(-REACH, REACH + 1)):
        if n - abs(k) < n / 2:
            continue
        a, b = captured[max(0, k) : n - max(0, -k)], wanted[max(0, -k) : n - max(0, k)]
        a, b = a - a.mean(), b - b.mean()
        size = np.sqrt((a @ a) * (b @ b))
        found[place] = (a @ b) / size if size > 1e-9 else 0.0
    return found


def _along(clips: Sequence[ClipLags], weights: Float64, centres: Float64, drift: float) -> Float64:
    """Mean of the clips' scores by the lag in the middle of the take [shape=(L,)]."""
    lags = LAGS
    total = np.zeros(len(lags))
    for clip, weight, centre in zip(clips, weights, centres, strict=True):
        total += weight * np.interp(lags + drift * centre, lags, clip.scores, left=0.0, right=0.0)
    mean: Float64 = total / weights.sum()
    return mean


def sharpest_peak(scores: Float64, near: float | None = None) -> float:
    """Lag of the largest score in seconds, between frames by a parabola.

    `near` limits it to 60 ms around a lag, else it is at most `LARGEST_SECONDS`.
    """
    lags = LAGS
    allowed = np.abs(lags) <= LARGEST_SECONDS if near is None else np.abs(lags - near) <= 0.06
    if not allowed.any():
        return float(near or 0.0)
    place = int(np.where(allowed, scores, -np.inf).argmax())
    if not 0 < place < len(scores) - 1:
        return float(lags[place])
    before, top, after = scores[place - 1 : place + 2]
    bend = before - 2 * top + after
    step = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(lags[place] + np.clip(step, -1, 1) / RATE)
