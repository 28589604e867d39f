"""Frames that come as they are made, sent at an even pace: jitter buffer and clock.

Frame k leaves at ``base + k / fps`` of a monotonic clock. The base follows the arrivals of the
last seconds, as late as `IN_TIME` of them: at once to a later time, slowly to an earlier one, so
that frames neither wait long nor leave in bursts, and a sender whose clock differs from that of
the sound drifts by no frame. The few frames that come later leave when they come.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rig.arrays import Float32
from rig.curves import HEAD, RigCurves
from rig.livelink.protocols import LiveProtocol, prepared, rest_values, with_head
from rig.livelink.sender import REST_REPEATS, Clock, connected

IN_TIME = 0.95
"""Share of the arrivals that the base waits for: one stall does not delay the seconds after it."""
MARGIN_SECONDS = 0.002
"""Between the last of these arrivals and the time a frame leaves."""
MEMORY_FRAMES = 90
"""Arrivals that the base follows (3 s)."""
SLEW = 0.0005
"""Largest step of the base to an earlier time, seconds a frame (15 ms a second)."""
MOST_SECONDS = 0.1
"""Longest time that the last frame that came may wait; older ones are skipped instead."""


@dataclass(frozen=True)
class LiveReport:
    """Statistics of a live sending.

    Parameters
    ----------
    n_sent, n_skipped, n_failed : int
        Frames sent, frames left out because their time had passed, and frames that the network
        did not take.
    waited : tuple of float
        Seconds from the arrival of a frame to its sending: median and greatest of the last 30 s.
    """

    n_sent: int
    n_skipped: int
    n_failed: int
    waited: tuple[float, float]


class LiveSender:
    """Sender of frames that come as they are made, in one thread.

    Parameters
    ----------
    protocol : LiveProtocol
        See `rig.livelink.protocols`.
    address : tuple of str and int
        Host and port.
    names : sequence of str
        Controls of the columns.
    control_set : str
        Their control set; converted to that of the protocol.
    fps : float
        Frames per second.
    first_frame : int
        Number of the first frame.
    sends_head : bool
        Append HeadYaw, HeadPitch and HeadRoll to columns that are sent as they are; a protocol of
        another control set has its own.
    clock : Clock, optional
        Other sources of time.
    note : callable
        Called with a line when the network takes no more frames, and when it takes them again.

    Raises
    ------
    FormatError
        If the address cannot be reached.
    """

    def __init__(
        self,
        protocol: LiveProtocol,
        address: tuple[str, int],
        names: tuple[str, ...],
        control_set: str,
        fps: float,
        *,
        first_frame: int = 0,
        sends_head: bool = False,
        clock: Clock | None = None,
        note: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.protocol, self.names, self.control_set, self.fps = protocol, names, control_set, fps
        self.address, self.first_frame, self.note = address, first_frame, note
        self.sends_head = sends_head
        self.clock = clock or Clock()
        self.link = connected(address)
        self.waiting: deque[tuple[int, float, Float32]] = deque()
        """Number, arrival and values of frames that were not sent."""
        self.offsets: deque[float] = deque(maxlen=MEMORY_FRAMES)
        self.waits: deque[float] = deque(maxlen=round(30 * fps))
        self.base = 0.0
        self.n_pushed = self.n_sent = self.n_skipped = self.n_failed = 0
        self.is_lost = False

    def push(self, values: Float32, head: Float32 | None = None, *, catch_up: bool = True) -> None:
        """Take the next frames [shape=(n, C)] and their head track [shape=(n, 6)].

        Without `catch_up` they may come long before their time, as the last ones of a recording.
        """
        if not len(values):
            return
        rows, now = self._converted(values, head), self.clock.now()
        for row in rows:
            self.offsets.append(now - self.n_pushed / self.fps)
            self.waiting.append((self.n_pushed, now, row))
            latest = float(np.quantile(self.offsets, IN_TIME)) + MARGIN_SECONDS
            self.base = latest if self.n_pushed == 0 else max(latest, self.base - SLEW)
            self.n_pushed += 1
        if catch_up:
            self.base = min(self.base, self.offsets[-1] + MOST_SECONDS)

    def wait(self) -> float | None:
        """Time until the next frame is due, seconds, 0 or more; None if there is none."""
        if not self.waiting:
            return None
        return max(self._due(self.waiting[0][0]) - self.clock.now(), 0.0)

    def send_due(self) -> None:
        """Send the frames whose time has come; those whose successor is due are skipped."""
        now = self.clock.now()
        while self.waiting and self._due(self.waiting[0][0]) <= now:
            number, came, row = self.waiting.popleft()
            if self.waiting and self._due(self.waiting[0][0]) <= now:
                self.n_skipped += 1
                continue
            self.waits.append(now - came)
            self._send(number, row)

    def drain(self) -> None:
        """Send what is left, each frame at its time."""
        while (wait := self.wait()) is not None:
            self.clock.sleep(wait)
            self.send_due()

    def rest(self) -> None:
        """Send the face at rest, in the frames that follow."""
        values = rest_values(self.control_set, self.names)[None]
        row = self._converted(values, np.zeros((1, len(HEAD)), np.float32))[0]
        for k in range(REST_REPEATS):
            self._send(self.n_pushed + k, row)

    def close(self) -> None:
        """Close the socket."""
        self.link.close()

    def report(self) -> LiveReport:
        """Return the statistics so far."""
        waits = np.array(self.waits or [0.0])
        waited = float(np.median(waits)), float(waits.max())
        return LiveReport(self.n_sent, self.n_skipped, self.n_failed, waited)

    def _due(self, number: int) -> float:
        return self.base + number / self.fps

    def _converted(self, values: Float32, head: Float32 | None) -> Float32:
        curves = RigCurves(
            values, self.names, fps=self.fps, control_set=self.control_set, head=head
        )
        if self.protocol.control_set in (None, self.control_set):
            return with_head(curves).values if self.sends_head else values
        return prepared(curves, self.protocol).values

    def _send(self, number: int, row: Float32) -> None:
        seconds = number / self.fps
        frame = self.first_frame + number
        try:
            for datagram in self.protocol.datagrams(frame, seconds, self.fps, row):
                self.link.send(datagram)
        except ConnectionRefusedError:
            pass  # no receiver yet: UDP goes on
        except OSError as error:
            self.n_failed += 1
            if not self.is_lost:
                self.is_lost = True
                host, port = self.address
                reason = error.strerror or error
                self.note(f"{host}:{port} cannot be reached: {reason}; frames are sent on")
            return
        self.n_sent += 1
        if self.is_lost:
            self.is_lost = False
            self.note("frames are taken again")
