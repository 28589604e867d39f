"""Long takes to clips: cut in pauses, never inside a word.

Letters: T frames at 30 per second.
"""

from collections.abc import Sequence

import numpy as np

from deitalk.audio.frames import FRAME_RATE, runs
from rig.arrays import Bool, Float32, Float64

LONGEST_SECONDS = 15.0
PAD_SECONDS = 0.4
"""Silence that is kept before and after the speech of a clip."""
LISTENING_SECONDS = 1.5
"""A pause from which on the face listens: it ends a clip, and is left out unless it is kept."""
QUIET_SECONDS = 0.2
"""Length of the quietest part at which speech without a pause is cut."""
SHORTEST_SECONDS = 0.5

Span = tuple[float, float]


def cut_at_silences(
    speaking: Bool | Float32,
    level: Float64,
    seconds: float,
    *,
    longest: float = LONGEST_SECONDS,
    keep_listening: bool = False,
) -> list[Span]:
    """Spans of clips in seconds.

    Parameters
    ----------
    speaking : array [shape=(T,)]
        Of `deitalk.audio.voice_activity.speech_activity`; its gaps are pauses, closures of stop
        consonants are not.
    level : array [shape=(T,)]
        Level of the sound, dB; speech longer than `longest` without a pause is cut where 0.2 s are
        quietest.
    seconds : float
        Length of the take; nothing lies beyond it.
    longest : float
        Most seconds of a clip.
    keep_listening : bool
        Keep pauses of more than 1.5 s, as clips of their own or ends of clips.

    Returns
    -------
    list of (start, stop)
        Rising, without overlap; every frame of speech is in one of them.
    """
    active: Bool = np.asarray(speaking, np.float32) > 0.5
    active = active[: max(int(seconds * FRAME_RATE), 1)]
    spoken = (runs(active) / FRAME_RATE).tolist()
    parts = [part for a, b in spoken for part in _divided((a, b), level, longest)]
    if keep_listening:
        # The whole take in clips whose borders lie in pauses.
        ends = [0.0, *(stop for _, stop in parts)]
        starts = [*(start for start, _ in parts), seconds]
        borders: list[float] = []
        for quiet, loud in zip(ends, starts, strict=True):
            pad = min(PAD_SECONDS, (loud - quiet) / 2)
            count = max(int(loud - quiet - 2 * pad), 1) + 1
            borders += np.linspace(quiet + pad, loud - pad, count).tolist()
        spans: list[Span] = []
        start = 0.0
        while seconds - start > longest:
            stop = max(b for b in borders if b <= start + longest + 1e-9)
            spans.append((start, stop))
            start = stop
        spans.append((start, seconds))
        return [(a, b) for a, b in spans if b - a >= SHORTEST_SECONDS]
    groups: list[list[Span]] = []
    for start, stop in parts:
        last = groups[-1] if groups else None
        if (
            last is not None
            and start - last[-1][1] <= LISTENING_SECONDS
            and stop - last[0][0] + 2 * PAD_SECONDS <= longest
        ):
            last.append((start, stop))
        else:
            groups.append([(start, stop)])
    # Spans with silence around them, at most half of what lies between two.
    spans = [(group[0][0], group[-1][1]) for group in groups]
    padded = []
    for place, (start, stop) in enumerate(spans):
        before = spans[place - 1][1] if place else 0.0
        after = spans[place + 1][0] if place + 1 < len(spans) else seconds
        front = min(PAD_SECONDS, (start - before) / (2 if place else 1))
        back = min(PAD_SECONDS, (after - stop) / (2 if place + 1 < len(spans) else 1))
        padded.append((max(start - front, 0.0), min(stop + max(back, 0.0), seconds)))
    return [(a, b) for a, b in padded if b - a >= SHORTEST_SECONDS]


def within_captured(spans: Sequence[Span], seen: Bool, fps: float) -> list[Span]:
    """Parts of spans in which every frame was captured, of at least `SHORTEST_SECONDS`.

    Parameters
    ----------
    spans : sequence of (start, stop)
        Seconds.
    seen : array of bool [shape=(T,)]
        Frames that were captured.
    fps : float
        Frames per second.
    """
    captured = (runs(seen) / fps).tolist()
    parts = [(max(a, start), min(b, stop)) for a, b in spans for start, stop in captured]
    return [(a, b) for a, b in parts if b - a >= SHORTEST_SECONDS]


def _divided(run: Span, level: Float64, longest: float) -> list[Span]:
    """A run of speech in parts that fit a clip."""
    start, stop = run
    room = longest - 2 * PAD_SECONDS
    if stop - start <= room:
        return [run]
    count = int(np.ceil((stop - start) / (0.8 * room)))
    width = round(QUIET_SECONDS * FRAME_RATE)
    smooth = np.convolve(level, np.ones(width) / width, mode="same")
    middle = start + (stop - start) / count
    reach = 0.25 * room
    first = int((middle - reach) * FRAME_RATE)
    last = min(int((middle + reach) * FRAME_RATE), int((start + room) * FRAME_RATE), len(smooth))
    cut = (first + int(smooth[first:last].argmin())) / FRAME_RATE
    return [(start, cut), *_divided((cut, stop), level, longest)]
