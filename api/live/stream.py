"""Sound that comes in pieces to windows for the offline model, and their curves to frames.

The network of the embedded models sees a second to both sides of a frame, so a frame is final when
a second of sound has come after it. Every `HOP_SECONDS` of new sound the last `WINDOW_SECONDS` are
animated; frames that have become final are taken from the result, the first few of them mixed with
what the window before gave for them, so that the curves do not jump. Letters: T frames of a window,
C controls, S samples.
"""

import json
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

import numpy as np
import soxr

from api.errors import Problem
from deitalk.acting import Acting
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.emotions import LABELS
from deitalk.errors import ConfigError
from rig.arrays import Float32

WINDOW_SECONDS = 8.0
HOP_SECONDS = 0.4
LOOKAHEAD_SECONDS = 1.0
"""Sound after a frame that the network sees, and that must have come before the frame is sent."""
RAMP_SECONDS = 0.2
"""Time over which one emotion passes into the next."""
BACKLOG_SECONDS = 5.0
"""Sound that waits; while there is more, the connection is not read."""
BLEND_FRAMES = 6
GRID_SAMPLES = SAMPLE_RATE // 10
"""Windows begin at tenths of a second, where a frame begins too."""
_GRID_FRAMES = FRAME_RATE // 10


@dataclass
class LiveStream:
    """Sound, changes and frames of one session.

    Parameters
    ----------
    sample_rate : int
        Of the client, Hz.
    is_float : bool
        Whether samples are float32; else 16-bit integers. Both little-endian, mono.
    """

    sample_rate: int
    is_float: bool
    samples: Float32 = field(default_factory=lambda: np.zeros(0, np.float32))
    """16 kHz, from `begin` on."""
    begin: int = 0
    next_frame: int = 0
    is_whole: bool = False

    def __post_init__(self) -> None:
        self._resampler = soxr.ResampleStream(self.sample_rate, SAMPLE_RATE, 1, dtype="float32")
        self._rest = b""
        self._arrivals: list[tuple[int, float]] = []
        self._tail: tuple[int, Float32] = (0, np.zeros((0, 0), np.float32))
        self._used = 0
        self.acting = Acting()
        self.emotions: list[tuple[float, dict[str, float]]] = [(0.0, {"neutral": 1.0})]
        self.intensities: list[tuple[float, float]] = [(0.0, 1.0)]

    @property
    def end(self) -> int:
        """Samples at 16 kHz that have come."""
        return self.begin + len(self.samples)

    @property
    def seconds(self) -> float:
        """Sound that has come."""
        return self.end / SAMPLE_RATE

    @property
    def backlog_seconds(self) -> float:
        """Sound that no window has held."""
        return (self.end - self._used) / SAMPLE_RATE

    @property
    def is_due(self) -> bool:
        """Whether a window is to be animated."""
        if self.is_whole:
            return self.end > 0 and self.next_frame < self.n_frames
        return self.backlog_seconds >= HOP_SECONDS and self._final_frames() > self.next_frame

    @property
    def n_frames(self) -> int:
        """Frames of the sound that has come."""
        return -(-self.end * FRAME_RATE // SAMPLE_RATE)

    def feed(self, data: bytes) -> None:
        """Take samples; a part of one is kept for the next call.

        Raises
        ------
        Problem
            422 for samples that are not finite.
        """
        data = self._rest + data
        size = 4 if self.is_float else 2
        whole = len(data) - len(data) % size
        self._rest = data[whole:]
        if self.is_float:
            chunk = np.frombuffer(data[:whole], "<f4").astype(np.float32)
            if not np.isfinite(chunk).all() or (np.abs(chunk) > 1e6).any():
                raise Problem(422, "samples must be finite, within 1", "audio_unusable")
        else:
            chunk = np.frombuffer(data[:whole], "<i2").astype(np.float32) / np.float32(32768)
        self._append(self._resampler.resample_chunk(chunk))

    def finish(self) -> None:
        """Take the end of the sound."""
        self._append(self._resampler.resample_chunk(np.zeros(0, np.float32), last=True))
        self.is_whole = True

    def change(self, acting: Acting) -> None:
        """Act otherwise from the sound on that comes next.

        Raises
        ------
        ConfigError
            For keyframes: each window has times of its own.
        """
        if len(acting.track.times) > 1:
            raise ConfigError("keyframes need a model for voices, such as live; name an emotion")
        weights = zip(LABELS, acting.track.weights[0].tolist(), strict=True)
        self.emotions.append((self.seconds, {name: w for name, w in weights if w}))
        self.intensities.append((self.seconds, acting.intensity))
        self.acting = acting

    def window(self) -> tuple[int, Float32, dict[str, Any]]:
        """Return the first frame of the window that is due, its samples and its acting's fields."""
        first = max(0, self.end - round(WINDOW_SECONDS * SAMPLE_RATE))
        first = min(first, max(0, self.next_frame * SAMPLE_RATE // FRAME_RATE - 3 * SAMPLE_RATE))
        first -= first % GRID_SAMPLES
        self._drop(first)
        self._used = self.end
        start = first / SAMPLE_RATE
        shown = self.next_frame / FRAME_RATE
        fields = self.acting.settings | {
            "emotion": json.dumps(self._keys(start)),
            "intensity": _last(self.intensities, shown),
            "life": "off",
            "look_at": "0,0",
        }
        return first // GRID_SAMPLES * _GRID_FRAMES, self.samples[first - self.begin :], fields

    def take(self, first: int, values: Float32) -> tuple[int, Float32, list[float]]:
        """Return the frames of a window that have become final.

        Parameters
        ----------
        first : int
            Number of the window's first frame.
        values : array [shape=(T, C)]
            Its curves.

        Returns
        -------
        first : int
            Number of the first of them.
        values : array [shape=(T, C)]
        late : list of float
            Seconds since each frame's sound came.
        """
        begin = self.next_frame
        last = first + len(values)
        end = last if self.is_whole else min(self._final_frames(), last)
        frames = values[begin - first : end - first].copy()
        tail_first, tail = self._tail
        known = tail[begin - tail_first : begin - tail_first + BLEND_FRAMES][: len(frames)]
        for k, row in enumerate(known):
            share = (k + 1) / (len(known) + 1)
            frames[k] = share * frames[k] + (1 - share) * row
        self.next_frame = max(end, begin)
        self._tail = (self.next_frame, values[self.next_frame - first :])
        now = monotonic()
        return begin, frames, [now - self._arrival(begin + k) for k in range(len(frames))]

    def _final_frames(self) -> int:
        return int((self.seconds - LOOKAHEAD_SECONDS) * FRAME_RATE)

    def _append(self, chunk: Float32) -> None:
        self.samples = np.concatenate([self.samples, chunk])
        self._arrivals.append((self.end, monotonic()))

    def _arrival(self, frame: int) -> float:
        """Time at which the last sample of a frame came."""
        sample = (frame + 1) * SAMPLE_RATE // FRAME_RATE
        return next((at for end, at in self._arrivals if end >= sample), self._arrivals[-1][1])

    def _drop(self, first: int) -> None:
        """Drop sound before a sample, and arrivals before the next frame."""
        if first > self.begin:
            self.samples = self.samples[first - self.begin :].copy()
            self.begin = first
        sample = self.next_frame * SAMPLE_RATE // FRAME_RATE
        self._arrivals = [arrival for arrival in self._arrivals if arrival[0] >= sample]
        start = first / SAMPLE_RATE
        self.emotions = _from(self.emotions, start)
        self.intensities = _from(self.intensities, start)

    def _keys(self, start: float) -> list[dict[str, Any]]:
        """Emotion keyframes of a window, their times relative to its start."""
        keys: list[dict[str, Any]] = []
        before: dict[str, float] | None = None
        last = -np.inf
        for at, weights in self.emotions:
            time = max(at - start, last + 0.01)
            if before is not None:
                keys += _key(time, before)
                time += RAMP_SECONDS
            keys += _key(time, weights)
            before, last = weights, time
        return keys


def _key(time: float, weights: dict[str, float]) -> list[dict[str, Any]]:
    return [
        {"time": round(time, 4), "emotion": name, "strength": weight}
        for name, weight in weights.items()
    ]


def _last(changes: "list[tuple[float, Any]]", time: float) -> Any:
    return next((value for at, value in reversed(changes) if at <= time), changes[0][1])


def _from(changes: "list[tuple[float, Any]]", time: float) -> "list[tuple[float, Any]]":
    """Changes from a time on, and the one that holds at it."""
    earlier = [change for change in changes if change[0] <= time]
    return [*earlier[-1:], *changes[len(earlier) :]]
