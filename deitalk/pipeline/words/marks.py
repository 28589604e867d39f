"""What a script says of its words, and what that changes of a take."""

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import parse_emotion
from deitalk.pipeline.words.tags import Kind
from deitalk.postprocess.life.voice import ACCENT_DISTANCE, Accent, Voice
from rig.arrays import Float32

if TYPE_CHECKING:  # needs torch
    from deitalk.pipeline.words.align import FittedWord

RAMP_SECONDS = 0.3
"""Time over which the emotion of a tag comes before its first word and goes after its last."""
LEAST_SOUND, MOST_SOUND = 0.5, 2.0
"""Seconds for which the emotion of a sound that is no word is shown: the pause that it lies in."""
_weights = cache(parse_emotion)


class Mark(NamedTuple):
    """Something said of a part of the words."""

    kind: Kind
    name: str
    value: str
    """Weights of an emotion, factor on the intensity, strength of an accent, seconds of a pause."""
    first: int
    """Word before which it stands, and that it begins with."""
    stop: int
    """Past its last word; `first` of what lies between words."""


class TimedMark(NamedTuple):
    """A mark in the sound."""

    kind: Kind
    name: str
    value: str
    start: float
    end: float
    """Seconds."""


def timed_mark(mark: Mark, words: "Sequence[FittedWord]", seconds: float) -> TimedMark:
    """A mark by the times of the words, in a sound of so many seconds.

    A laugh is laid over the word beside it, which then does not fit: a sound that is no word lies
    between the words that do.
    """
    first, stop = mark.first, mark.stop
    if stop > first:
        return TimedMark(*mark[:3], words[first].start, words[stop - 1].end)
    if mark.kind == "sound":
        first -= bool(first and not words[first - 1].fits)
        stop += bool(stop < len(words) and not words[stop].fits)
    before = words[first - 1].end if first else 0.0
    after = words[stop].start if stop < len(words) else seconds
    if mark.kind == "sound":
        middle, half = (before + after) / 2, min(max(after - before, LEAST_SOUND), MOST_SOUND) / 2
        before, after = max(middle - half, 0.0), min(middle + half, seconds)
    return TimedMark(*mark[:3], before, max(before, after))


def with_emotions(weights: Float32, marks: Sequence[TimedMark], times: Any) -> Float32:
    """Weights of the emotions [shape=(T, 9)] with those of the marks; they come in a ramp."""
    found = weights.astype(np.float64)
    for mark in marks:
        if mark.kind not in ("emotion", "sound") or (
            mark.kind == "sound" and mark.value == "neutral=1"
        ):
            continue
        share = _share(times, mark)[:, None]
        wanted = _weights(mark.value).at(np.zeros(1))
        found = found + share * (wanted - found)
    return np.asarray(found, np.float32)


def levels(marks: Sequence[TimedMark], times: Any) -> Float32:
    """Factor on the intensity of each frame [shape=(T,)]."""
    factor = np.ones(len(times))
    for mark in marks:
        if mark.kind == "voice":
            factor *= 1 + _share(times, mark) * (float(mark.value) - 1)
    return factor.astype(np.float32)


def with_accents(voice: Voice, marks: Sequence[TimedMark]) -> Voice:
    """The events of a voice with the accents of the marks, in place of those within their words."""
    stressed = [mark for mark in marks if mark.kind == "accent"]
    kept = list(voice.accents)
    for mark in stressed:
        middle = round((mark.start + mark.end) / 2 * FRAME_RATE)
        size = float(mark.value)
        span = range(round(mark.start * FRAME_RATE), round(mark.end * FRAME_RATE) + 1)
        inside = [accent for accent in kept if accent.frame in span]
        place = max(inside, key=lambda accent: accent.strength).frame if inside else middle
        gone = ACCENT_DISTANCE if size else 0
        kept = [a for a in kept if a not in inside and abs(a.frame - place) >= gone]
        if size and 0 <= place < voice.n_frames:
            kept.append(Accent(place, size))
    return voice._replace(accents=tuple(sorted(kept)))


def _share(times: Any, mark: TimedMark) -> Any:
    """1 within a mark, with ramps on both sides [shape=(T,)]."""
    rises = np.clip((times - mark.start) / RAMP_SECONDS + 1, 0, 1)
    falls = np.clip((mark.end - times) / RAMP_SECONDS + 1, 0, 1)
    share = np.minimum(rises, falls)
    return share * share * (3 - 2 * share)
