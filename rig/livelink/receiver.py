"""Live Link Face packets, and their recording, for tests and captures.

Bound to the loopback by default, so that no port is open to the network.
"""

import itertools
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rig.conversion.arkit import arkit_controls, udp_order
from rig.curves.timecode import TICKS_PER_DAY, TICKS_PER_SECOND
from rig.errors import FormatError
from rig.formats.livelink_csv import LiveLinkTake
from rig.livelink.packet import PORT, Packet, decode

MAX_DATAGRAM = 65_535
POLL_SECONDS = 0.2
MAX_PACKETS = 120 * 3600 * 4
"""Four hours at 120 Hz: a recording is bounded."""
MAX_OTHERS = 16
"""Other subjects that a recording names."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Packets of one subject, in the order of their times.

    Parameters
    ----------
    subject : str
        Of the first packet, unless one was given.
    packets : tuple of Packet
        Sorted, each time once.
    n_lost, n_late, n_garbage, n_other : int
        Frame numbers that never came; packets that came after a later one; datagrams that are no
        packet; packets of other subjects.
    others : tuple of str
        Names of other subjects, at most `MAX_OTHERS`.
    """

    subject: str
    packets: tuple[Packet, ...]
    n_lost: int = 0
    n_late: int = 0
    n_garbage: int = 0
    n_other: int = 0
    others: tuple[str, ...] = ()

    def to_take(self) -> LiveLinkTake:
        """Return the recording as a Live Link Face take, with the packets' own times.

        Raises
        ------
        FormatError
            If nothing was received.
        """
        if not self.packets:
            if self.others:
                raise FormatError(
                    f"no packet of {self.subject!r} was received, but {self.n_other} of "
                    f"{', '.join(map(repr, self.others))}; name one of these"
                )
            raise FormatError("no packet was received; check host, port and firewall")
        ticks = np.array([round(p.seconds * TICKS_PER_SECOND) for p in self.packets], np.int64)
        order = np.argsort(udp_order())
        values = np.stack([packet.values[order] for packet in self.packets]).astype(np.float64)
        keep = np.concatenate([[True], np.diff(ticks) > 0])
        day = ticks[0] // TICKS_PER_DAY * TICKS_PER_DAY
        return LiveLinkTake(ticks[keep] - day, values[keep], arkit_controls().names)


class Receiver:
    """A UDP port that receives packets; a context manager.

    Parameters
    ----------
    host : str
        Address to bind; the loopback by default, ``0.0.0.0`` for the whole network.
    port : int
        11111 is Live Link Face's; 0 takes a free one, see `port`.

    Raises
    ------
    FormatError
        If the port cannot be bound.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = PORT) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            self._socket.bind((host, port))
        except (OSError, OverflowError, TypeError, UnicodeError) as error:
            self._socket.close()
            reason = getattr(error, "strerror", None) or error
            raise FormatError(f"cannot listen on {host}:{port}: {reason}") from error
        self._socket.settimeout(POLL_SECONDS)
        self.port: int = self._socket.getsockname()[1]
        self.n_garbage = 0

    def __enter__(self) -> "Receiver":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the port."""
        self._socket.close()

    def packets(
        self,
        *,
        seconds: float | None = None,
        idle_seconds: float | None = None,
        is_over: Callable[[], bool] = lambda: False,
    ) -> Iterator[Packet]:
        """Yield packets as they come; other datagrams are counted and skipped.

        Parameters
        ----------
        seconds : float, optional
            Longest time in all; for ever if not given.
        idle_seconds : float, optional
            Longest time without a packet, once one has come.
        is_over : callable
            Called before every packet and five times a second; True ends.
        """
        end = None if seconds is None else time.monotonic() + seconds
        idle_end: float | None = None
        while not is_over() and all(t is None or time.monotonic() < t for t in (end, idle_end)):
            try:
                data = self._socket.recv(MAX_DATAGRAM)
            except TimeoutError:
                continue
            try:
                packet = decode(data)
            except FormatError:
                self.n_garbage += 1
                continue
            if idle_seconds is not None:
                idle_end = time.monotonic() + idle_seconds
            yield packet

    def record(
        self,
        *,
        subject: str | None = None,
        seconds: float | None = None,
        idle_seconds: float | None = None,
        is_over: Callable[[], bool] = lambda: False,
    ) -> Recording:
        """Collect packets of one subject until a limit or an interrupt.

        Parameters
        ----------
        subject : str, optional
            Subject of the packets to take; that of the first packet by default.
        seconds, idle_seconds : float, optional
            See `packets`.
        is_over : callable
            See `packets`.
        """
        taken: list[Packet] = []
        n_other, others = 0, dict[str, None]()
        try:
            for packet in self.packets(seconds=seconds, idle_seconds=idle_seconds, is_over=is_over):
                subject = subject or packet.subject
                if packet.subject != subject:
                    n_other += 1
                    if len(others) < MAX_OTHERS:
                        others[packet.subject] = None
                    continue
                taken.append(packet)
                if len(taken) >= MAX_PACKETS:
                    break
        except KeyboardInterrupt:
            pass
        by_time = {packet.seconds: packet for packet in taken}
        packets = tuple(by_time[seconds] for seconds in sorted(by_time))
        frames = {packet.frame for packet in packets}
        n_lost = max(frames) - min(frames) + 1 - len(frames) if frames else 0
        latest = itertools.accumulate((packet.seconds for packet in taken), max)
        n_late = sum(packet.seconds < last for packet, last in zip(taken, latest, strict=True))
        return Recording(
            subject or "", packets, n_lost, n_late, self.n_garbage, n_other, tuple(others)
        )
