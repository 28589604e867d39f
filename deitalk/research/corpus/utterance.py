"""Labelled speech of every source of the corpus: a waveform and its phones' times."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

SAMPLE_RATE = 16_000


@dataclass(frozen=True)
class Phone:
    """One phone and its time.

    Attributes
    ----------
    start, end : float
        Seconds from the beginning of the waveform.
    name : str
        A member of `deitalk.pipeline.words.transcript.PHONES`; ``SIL`` for silence.
    """

    start: float
    end: float
    name: str


@dataclass(frozen=True)
class Utterance:
    """One piece of speech and its phones.

    Attributes
    ----------
    waveform : float32 array [shape=(S,), 16 kHz, range -1 to 1]
        Mono speech.
    phones : tuple of Phone
        Contiguous and sorted; they cover the waveform from 0 to S / 16000 seconds.
    text : str
        The words spoken.
    style : str
        The emotion of the prosody given to the engine; ``neutral`` for recordings.
    speaker : str
        ``<source>:<voice>``, such as ``espeak:en-us+f3`` or ``librispeech:1272``.
    engine : str
        ``espeak``, ``flite``, ``festival`` or ``recording``.
    language : str
        Language code: ``en``, ``es``, ...
    """

    waveform: np.ndarray
    phones: tuple[Phone, ...]
    text: str
    style: str
    speaker: str
    engine: str
    language: str

    @property
    def duration_seconds(self) -> float:
        """Length of the waveform in seconds."""
        return len(self.waveform) / SAMPLE_RATE


def contiguous(segments: Iterable[tuple[float, float, str]], duration: float) -> tuple[Phone, ...]:
    """Segments without gaps: they cover 0 to `duration` and none is empty.

    Segments beyond `duration` are cut, overlaps end where the next segment starts, gaps become
    ``SIL``, and neighbouring silences are joined.

    Parameters
    ----------
    segments : iterable of (start, end, name)
        Seconds; sorted by start.
    duration : float
        Seconds; greater than 0.

    Returns
    -------
    phones : tuple of Phone
    """
    filled: list[tuple[float, float, str]] = []
    reached = 0.0
    for start, end, name in _without_overlap(list(segments)):
        start, end = max(start, reached), min(end, duration)
        if end - start < 1e-6:
            continue
        if start - reached > 1e-6:
            filled.append((reached, start, "SIL"))
        filled.append((reached if start - reached <= 1e-6 else start, end, name))
        reached = end
    if duration - reached > 1e-6:
        filled.append((reached, duration, "SIL"))
    elif filled:
        filled[-1] = (filled[-1][0], duration, filled[-1][2])
    return tuple(Phone(*segment) for segment in _join_silences(filled))


def _without_overlap(
    segments: Sequence[tuple[float, float, str]],
) -> Iterable[tuple[float, float, str]]:
    """End every segment no later than its successor starts."""
    following = [start for start, _, _ in segments[1:]] + [float("inf")]
    for (start, end, name), next_start in zip(segments, following, strict=False):
        yield start, min(end, next_start), name


def _join_silences(segments: list[tuple[float, float, str]]) -> list[tuple[float, float, str]]:
    """Segments with neighbouring silences joined."""
    joined: list[tuple[float, float, str]] = []
    for start, end, name in segments:
        if joined and name == "SIL" == joined[-1][2]:
            start = joined.pop()[0]
        joined.append((start, end, name))
    return joined
