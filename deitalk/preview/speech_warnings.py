"""Warnings of a preview from the sound and its phones.

Values at their limits, jitter and lengths are checked by the page
(``web/src/data/warnings.ts``). Letters: T frames, V vertices.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.data.offset import clip_lags
from deitalk.preview.source import TOLERANCE_SECONDS, PreviewSource
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
    """Bilabials that do not close, curves that are early, late or of another length, by time.

    Of a rig other than the board, which has neither jaw nor lips of a known name, the length alone.
    """
    if not source.is_board:
        return length_warnings(source)
    return sorted([*length_warnings(source), *offset_warnings(source), *bilabial_warnings(source)])


def length_warnings(source: PreviewSource) -> list[Finding]:
    """Warn of a recording whose length differs by more than 0.1 s."""
    seconds, recorded = source.curves.duration, source.audio_seconds
    if not recorded or abs(recorded - seconds) <= TOLERANCE_SECONDS:
        return []
    return [Finding(0.0, f"curves last {seconds:.2f} s, the recording {recorded:.2f} s")]


def offset_warnings(source: PreviewSource) -> list[Finding]:
    """Warn if the jaw's best lag to the level of the vowels is clear and more than two frames.

    The measure is that of ``deitalk data check`` without its model. Recordings under 2 s are not
    checked.
    """
    if not source.sample_rate:
        return []
    import soxr

    if source.sample_rate == SAMPLE_RATE:
        samples = source.samples
    else:
        resampled: Float32 = soxr.resample(source.samples, source.sample_rate, SAMPLE_RATE)
        samples = resampled
    lags = clip_lags(source.curves, samples, predicted=None)
    if lags is None or not lags.is_clear or abs(lags.lag) * source.curves.fps <= MOST_LAG_FRAMES:
        return []
    early_or_late = "late" if lags.lag > 0 else "early"
    text = f"curves are {abs(lags.lag) * 1000:.0f} ms {early_or_late} (jaw against loudness)"
    return [Finding(0.0, text)]


def bilabial_warnings(source: PreviewSource) -> list[Finding]:
    """Warnings for every m, b or p without contact of the embedded head's lips; needs phones."""
    if not source.phones:
        return []
    from deitalk.postprocess.phones import BILABIALS, WIDEN_FRAMES

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
    gaps: Float64 = head.lip_gaps(head.pose(values)).max(axis=1)
    return gaps
