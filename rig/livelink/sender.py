"""Curves and live frames sent by a monotonic clock; late ones are skipped, the end is at rest."""

import math
import socket
import time
from collections.abc import Callable
from contextlib import suppress
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
    curves, clock, stop = prepared(curves, protocol), clock or Clock(), stop or Event()
    fps, index, n_sent, n_skipped, worst = curves.fps, 0, 0, 0, 0.0
    end = math.inf if loop else len(curves)
    with connected(address) as link:

        def put(index: int, values: Float32) -> None:
            for datagram in protocol.datagrams(first_frame + index, index / fps, fps, values):
                with suppress(ConnectionRefusedError):  # no receiver yet: UDP goes on
                    link.send(datagram)

        if on_start is not None:
            on_start()
        start = clock.now()
        try:
            while index < end and not stop.is_set():
                due = start + index / fps
                if (wait := due - clock.now()) > 0:
                    clock.sleep(wait)
                late = clock.now() - due
                missed = int(min(max(late * fps, 0), end - 1 - index))  # the last is always sent
                n_skipped, index = n_skipped + missed, index + missed
                at = index % len(curves)
                put(index, curves.values[at])
                worst = max(worst, late - missed / fps)
                n_sent, index = n_sent + 1, index + 1
                if on_frame is not None:
                    on_frame(at)
        except KeyboardInterrupt:
            pass
        finally:
            values = rest_values(curves.control_set, curves.names)
            for i in range(REST_REPEATS):
                put(index + i, values)
        return SendReport(n_sent, n_skipped, clock.now() - start, worst)


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
