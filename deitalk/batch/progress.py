"""Rate of a batch and the time that is left."""

from collections.abc import Callable
from time import monotonic

Progress = Callable[[float, str], None]
"""Called with the share of the work that is done, 0 to 1, and a text on rate and time left."""


class Pace:
    """Rate since the first result, so that the loading of models does not count.

    Parameters
    ----------
    lines : int
        Lines to animate.
    weight : float
        Their work in any unit, such as the bytes of the recordings.
    clock : callable
        Seconds.
    """

    def __init__(self, lines: int, weight: float, clock: Callable[[], float] = monotonic) -> None:
        self.lines, self.weight = lines, max(weight, 1.0)
        self.done = self.failed = 0
        self._clock, self._done_weight, self._seconds = clock, 0.0, 0.0
        self._first: tuple[float, int, float, float] | None = None

    def add(self, weight: float, seconds: float, *, failed: bool) -> None:
        """Count a result: its work, and the seconds of sound in it."""
        self.done += 1
        self.failed += failed
        self._done_weight += weight
        self._seconds += seconds
        if self._first is None:
            self._first = (self._clock(), self.done, self._done_weight, self._seconds)

    @property
    def share(self) -> float:
        """Share of the work that is done."""
        return min(self._done_weight / self.weight, 1.0)

    def text(self) -> str:
        """Counts, rate and time left, as one line."""
        parts = [f"{self.done} of {self.lines} lines"]
        if self.failed:
            parts.append(f"{self.failed} failed")
        if self._first is not None:
            began, done, weight, seconds = self._first
            took, advance = self._clock() - began, self._done_weight - weight
            if took > 0 and advance > 0:
                parts.append(f"{(self.done - done) / took:.1f} lines/s")
                parts.append(f"{(self._seconds - seconds) / took:.0f} x real time")
                parts.append(
                    f"{clock_text((self.weight - self._done_weight) / advance * took)} left"
                )
        return ", ".join(parts)


def clock_text(seconds: float) -> str:
    """Seconds as ``m:ss`` or ``h:mm:ss``."""
    whole = max(round(seconds), 0)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"
