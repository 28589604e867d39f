"""Warnings of a preview from the sound and its phones.

Values at their limits, jitter and lengths are checked by the page (``web/src/take.ts``).
Letters: T frames, V vertices.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.data import checks as check
from deitalk.data import offset
from deitalk.preview.source import PreviewSource
from rig.arrays import AnyFloat, Float32, Float64
from rig.face import Head, build_head

OPEN_CM = 0.1
"""Largest gap along the rims of the lips in a closed bilabial, cm."""
MOST_LAG_FRAMES = 2.0


class Finding(NamedTuple):
    """A warning and its time."""

    time: float
    """Seconds."""
    text: str


def find_warnings(source: PreviewSource) -> list[Finding]:
    """Bilabials that do not close, and curves that are early or late, in order of time.

    Curves of a rig other than the board have neither jaw nor lips of a known name, and no warnings.
    """
    if not source.is_board:
        return []
    return sorted([*offset_warnings(source), *bilabial_warnings(source)])


def offset_warnings(source: PreviewSource) -> list[Finding]:
    """Warn if the jaw's best lag to the loudness is more than two frames.

    The measure is that of ``deitalk data check`` without its model: the better lag must gain
    enough correlation (`deitalk.data.offset.is_clear`). Recordings under 2 s are not checked.
    """
    if not source.sample_rate:
        return []
    samples = _at_16_khz(source.samples, source.sample_rate)
    jaw = check.jaw_motion(source.curves, 0.0, len(samples) / SAMPLE_RATE)
    lags = offset.lag_correlations(offset.loudness(offset.vowel_band(samples)), jaw)
    if not np.isfinite(lags).all() or not offset.is_clear(lags):
        return []
    seconds = offset.peak(lags) / offset.RATE
    if abs(seconds) * source.curves.fps <= MOST_LAG_FRAMES:
        return []
    early_or_late = "late" if seconds > 0 else "early"
    text = f"curves are {abs(seconds) * 1000:.0f} ms {early_or_late} (jaw against loudness)"
    return [Finding(0.0, text)]


def bilabial_warnings(source: PreviewSource) -> list[Finding]:
    """Warnings for every m, b or p without contact of the embedded head's lips; needs phones."""
    if not source.phones:
        return []
    from deitalk.phones import BILABIALS, WIDEN_FRAMES

    fps, found = source.curves.fps, []
    head = build_head(0)
    for start, end, name in source.phones:
        phone = name.upper().rstrip("012")
        if phone not in BILABIALS:
            continue
        first = max(int(np.floor(start * fps)) - WIDEN_FRAMES, 0)
        frames = source.curves.values[first : int(np.ceil(end * fps)) + WIDEN_FRAMES + 1]
        if not len(frames):
            continue
        gap = float(lip_gaps(head, frames).min())
        if gap > OPEN_CM:
            text = f"{phone.lower()} does not close: {gap * 10:.1f} mm between the lips"
            found.append(Finding(float(start), text))
    return found


def lip_gaps(head: Head, values: AnyFloat) -> Float64:
    """Widest distance between the rims of the lips (T,), cm, of control values (T, 185)."""
    upper, lower = head.features.lip_rims()
    skin = head.pose(values)[:, head.slices["skin"]].astype(np.float64)
    gaps: Float64 = np.linalg.norm(skin[:, lower] - skin[:, upper], axis=-1).max(1)
    return gaps


def _at_16_khz(samples: Float32, rate: int) -> Float32:
    import soxr

    if rate == SAMPLE_RATE:
        return samples
    resampled: Float32 = soxr.resample(samples, rate, SAMPLE_RATE)
    return resampled
