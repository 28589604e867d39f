"""Send curves in real time by a monotonic clock; late frames are skipped, the end is at rest."""

import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event

from rig.arrays import Float32
from rig.curves import RigCurves
from rig.errors import FormatError
from rig.livelink.protocols import LiveProtocol, prepared, rest_values

REST_REPEATS = 3
"""Packets of the face at rest at the end, since UDP may lose one."""


@dataclass(frozen=True)
class SendReport:
    """Statistics of a sending.

    Parameters
    ----------
    n_sent, n_skipped : int
        Frames sent, and frames left out because their time had passed.
    seconds : float
        Time from the first frame to the end.
    worst_lateness : float
        Greatest delay of a sent frame behind its time, in seconds.
    """

    n_sent: int
    n_skipped: int
    seconds: float
    worst_lateness: float


@dataclass(frozen=True)
class Clock:
    """Source of time; tests have their own."""

    now: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


def send(
    curves: RigCurves,
    protocol: LiveProtocol,
    address: tuple[str, int],
    *,
    loop: bool = False,
    first_frame: int = 0,
    stop: Event | None = None,
    on_start: Callable[[], None] | None = None,
    on_frame: Callable[[int], None] | None = None,
    clock: Clock | None = None,
) -> SendReport:
    """Send curves to a UDP address at their own rate.

    Frame i leaves at start + i / fps of a monotonic clock, so delays do not add up. A frame whose
    successor is already due is skipped. At the end, on `stop` and on an interrupt, the face at rest
    is sent.

    Parameters
    ----------
    curves : RigCurves
        Converted to the control set of the protocol.
    protocol : LiveProtocol
        See `rig.livelink.protocols`.
    address : tuple of str and int
        Host and port.
    loop : bool
        Begin again at the end, with rising frame numbers, until `stop` or an interrupt.
    first_frame : int
        Number of the first frame.
    stop : threading.Event, optional
        Ends the sending.
    on_start : callable, optional
        Called right before the first frame: play the audio, send a signal.
    on_frame : callable, optional
        Called after each frame with its index in the clip.
    clock : Clock, optional
        Other sources of time.

    Raises
    ------
    FormatError
        If there are no frames or the address cannot be reached.
    """
    if not len(curves):
        raise FormatError("there are no frames to send")
    curves = prepared(curves, protocol)
    clock = clock or Clock()
    with connected(address) as link:
        run = _Run(curves, protocol, link, clock, first_frame, loop=loop)
        if on_start is not None:
            on_start()
        run.begin()
        try:
            while run.step(on_frame, stop):
                if run.index >= len(curves) and not loop:
                    break
        except KeyboardInterrupt:
            pass
        finally:
            run.rest()
        return run.report()


class _Run:
    """One sending, frame by frame."""

    def __init__(
        self,
        curves: RigCurves,
        protocol: LiveProtocol,
        link: socket.socket,
        clock: Clock,
        first_frame: int,
        *,
        loop: bool,
    ) -> None:
        self.curves, self.protocol, self.link, self.clock = curves, protocol, link, clock
        self.first_frame, self.loop = first_frame, loop
        self.index = self.n_sent = self.n_skipped = 0
        self.start = self.worst = 0.0

    def begin(self) -> None:
        """Start the clock."""
        self.start = self.clock.now()

    def step(self, on_frame: Callable[[int], None] | None, stop: Event | None) -> bool:
        """Wait for the next frame and send it; return whether to go on."""
        fps = self.curves.fps
        due = self.start + self.index / fps
        if stop is not None and stop.is_set():
            return False
        wait = due - self.clock.now()
        if wait > 0:
            self.clock.sleep(wait)
        late = self.clock.now() - due
        missed = int(late * fps)
        if not self.loop:  # the last frame is sent however late: none follows it
            missed = min(missed, len(self.curves) - 1 - self.index)
        if missed > 0:
            self.n_skipped += missed
            self.index += missed
            late -= missed / fps
        at = self.index % len(self.curves)
        self._send(self.index, self.curves.values[at])
        self.worst = max(self.worst, late)
        self.n_sent += 1
        self.index += 1
        if on_frame is not None:
            on_frame(at)
        return True

    def rest(self) -> None:
        """Send the face at rest, in the frames that follow."""
        values = rest_values(self.curves.control_set, self.curves.names)
        for i in range(REST_REPEATS):
            self._send(self.index + i, values)

    def report(self) -> SendReport:
        """Return the statistics so far."""
        seconds = self.clock.now() - self.start
        return SendReport(self.n_sent, self.n_skipped, seconds, max(self.worst, 0.0))

    def _send(self, index: int, values: Float32) -> None:
        frame = self.first_frame + index
        fps = self.curves.fps
        for datagram in self.protocol.datagrams(frame, index / fps, fps, values):
            try:
                self.link.send(datagram)
            except ConnectionRefusedError:
                pass  # no receiver yet: UDP goes on


def check_address(address: tuple[str, int]) -> None:
    """Refuse a host and port that no datagram can be sent to.

    Raises
    ------
    FormatError
        If the host is unknown or the port is not 1 to 65535.
    """
    connected(address).close()


def connected(address: tuple[str, int]) -> socket.socket:
    """Return a UDP socket that sends to an address; errors as `check_address`."""
    host, port = address
    if not 0 < port < 65536:
        raise FormatError(f"port {port} must be 1 to 65535")
    try:
        family, kind, number, _, target = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        link = socket.socket(family, kind, number)
        link.connect(target)
    except (OSError, UnicodeError) as error:  # the latter for a name that is too long
        reason = getattr(error, "strerror", None) or error
        raise FormatError(f"cannot send to {host}:{port}: {reason}; name another host") from error
    return link
