"""Labels of speech and pauses from phone times, and the counts of a detector against them.

Silences longer than 0.2 s are pauses, all else is speech, and the 50 ms around an edge are not
scored. Letters: T rig frames at 30 Hz, N onsets.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE, frame_times
from deitalk.config import Gates
from deitalk.errors import DataError
from deitalk.postprocess.gates import mouth_gate
from rig.arrays import Bool

SHORTEST_PAUSE_SECONDS = 0.2
"""Longest silence within speech, seconds: closures of stop consonants."""
COLLAR_SECONDS = 0.05
"""Distance from the edge of a pause within which frames are not scored, seconds."""
ONSET_SECONDS = 0.1
SHUT = 0.1
"""Mouth gate below which the mouth counts as shut."""


@dataclass(frozen=True)
class Labels:
    """Labels of every frame of a clip; a frame that is neither speech nor pause is not scored."""

    speech: Bool
    """[shape=(T,)]."""
    pause: Bool
    """[shape=(T,)]."""
    settled: Bool
    """Pause frames outside the mouth gate's fades beside speech [shape=(T,)]."""
    onsets: tuple[float, ...]
    """Seconds at which speech begins after a pause [length N]."""


def label_frames(phones: Sequence[tuple[float, float, str]], n_frames: int) -> Labels:
    """Label frames by phone times.

    Parameters
    ----------
    phones : sequence of (start, end, name)
        Sorted, seconds; ``SIL`` is silence.
    n_frames : int
        T; frame i is at i / 30 s.
    """
    times = frame_times(n_frames)
    speech, pause = np.ones(n_frames, bool), np.zeros(n_frames, bool)
    settled, onsets = np.zeros(n_frames, bool), []
    gates, last = Gates(), phones[-1][1] if phones else 0.0
    speech &= times < last
    for start, end in _silences(phones):
        at_edge = start <= 0 or end >= last
        if end - start <= SHORTEST_PAUSE_SECONDS and not at_edge:
            continue
        speech &= (times < start - COLLAR_SECONDS) | (times > end + COLLAR_SECONDS)
        before = -np.inf if start <= 0 else start + COLLAR_SECONDS
        after = np.inf if end >= last else end - COLLAR_SECONDS
        pause |= (times >= before) & (times <= after)
        before += gates.mouth_closes / FRAME_RATE
        after -= gates.mouth_opens / FRAME_RATE
        settled |= (times > before) & (times < after)
        if end < last and end - start > SHORTEST_PAUSE_SECONDS:
            onsets.append(end)
    return Labels(speech, pause, settled, tuple(onsets))


def _silences(phones: Sequence[tuple[float, float, str]]) -> list[tuple[float, float]]:
    """Silences (start, end) in seconds, those that touch joined."""
    found: list[tuple[float, float]] = []
    for start, end, name in phones:
        if name != "SIL":
            continue
        if found and start - found[-1][1] < 1e-3:
            start = found.pop()[0]
        found.append((start, end))
    return found


@dataclass(frozen=True)
class Counts:
    """Counts of a detector over clips; they add up over clips."""

    speech: int = 0
    hits: int = 0
    """Speech frames found."""
    shut: int = 0
    """Speech frames at which the mouth gate shuts the mouth."""
    pause: int = 0
    alarms: int = 0
    """Pause frames taken for speech."""
    settled: int = 0
    open: int = 0
    """Settled pause frames at which the mouth gate is not shut."""
    onsets: int = 0
    missed: int = 0
    """Onsets without an active frame in their first 0.1 s."""
    cpu_seconds: float = 0.0
    audio_seconds: float = 0.0

    def __add__(self, other: "Counts") -> "Counts":
        return Counts(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    @property
    def hit_rate(self) -> float:
        """Share of the speech frames found; NaN without any."""
        return share(self.hits, self.speech)

    @property
    def false_alarm_rate(self) -> float:
        """Share of the pause frames taken for speech; NaN without any."""
        return share(self.alarms, self.pause)

    @property
    def balanced_accuracy(self) -> float:
        """Mean of the shares of speech frames and of pause frames that are right."""
        return (self.hit_rate + 1 - self.false_alarm_rate) / 2

    @property
    def missed_onset_rate(self) -> float:
        """Share of the onsets missed; NaN without any."""
        return share(self.missed, self.onsets)

    @property
    def suitability(self) -> float:
        """Mean of the shares of speech frames, pause frames and onsets that are right."""
        rates = (self.hit_rate, 1 - self.false_alarm_rate, 1 - self.missed_onset_rate)
        known = [rate for rate in rates if not np.isnan(rate)]
        return float(np.mean(known)) if known else float("nan")


def share(part: float, whole: float) -> float:
    """`part` of `whole`; NaN of nothing."""
    return part / whole if whole else float("nan")


def score_activity(activity: NDArray[np.generic], labels: Labels) -> Counts:
    """Count right and wrong frames of one clip.

    Parameters
    ----------
    activity : ndarray [shape=(T,)]
        Above 0.5 where a detector finds speech.
    labels : Labels
        From `label_frames`.

    Raises
    ------
    DataError
        If the lengths differ.
    """
    if len(activity) != len(labels.speech):
        raise DataError(
            f"activity has {len(activity)} frames and the labels {len(labels.speech)}; "
            "both must have T frames at 30 Hz"
        )
    active = np.asarray(activity) > 0.5
    shut = mouth_gate(active) < SHUT
    times = frame_times(len(active))
    starts = [(times >= s - 1e-9) & (times < s + ONSET_SECONDS - 1e-9) for s in labels.onsets]
    return Counts(
        speech=int(labels.speech.sum()),
        hits=int((active & labels.speech).sum()),
        shut=int((shut & labels.speech).sum()),
        pause=int(labels.pause.sum()),
        alarms=int((active & labels.pause).sum()),
        settled=int(labels.settled.sum()),
        open=int((~shut & labels.settled).sum()),
        onsets=len(starts),
        missed=sum(not active[start].any() for start in starts),
    )
