"""Live Link Face packets, and their recording, for tests and captures.

Bound to the loopback by default, so that no port is open to the network.
"""

import math
import socket
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType

import numpy as np

from rig.arrays import Float32
from rig.conversion.arkit import arkit_controls, udp_order
from rig.curves.timecode import TICKS_PER_DAY, TICKS_PER_SECOND
from rig.errors import FormatError
from rig.formats.livelink_csv import LiveLinkTake

# Live Link Face packets, ARKit mode, version 6, as sent by the iPhone app to UDP port 11111.
#
# Big endian::
#
#     u8  version = 6
#     i32 length, device id (text)
#     i32 length, subject name (text)
#     i32 frame number    f32 sub-frame in [0, 1)
#     i32 rate numerator  i32 rate denominator
#     u8  number of values = 61
#     61 x f32            values in the order of Unreal's EARFaceBlendShape
#
# With an id of d and a name of n bytes that is 270 + d + n bytes. Three mistakes of other senders
# are avoided here: the denominator is never 0 (int(fps / 60) is, at 30 fps, and Unreal then divides
# by it), the sub-frame is not a constant, and negative rotations are not clamped away.


VERSION = 6
MAX_SECONDS = 2.0**32
"""Latest time of a frame, in seconds: 32 bits at one frame per second."""
N_VALUES = 61
MAX_TEXT_BYTES = 512
PORT = 11111
_TIMING = struct.Struct("!ifiiB")
_VALUES = struct.Struct(f"!{N_VALUES}f")


@dataclass(frozen=True, eq=False)
class Packet:
    """One frame of a face.

    Parameters
    ----------
    device, subject : str
        Id of the sender, and the name shown by Unreal.
    frame : int
        Frame number at the rate, 0 to 2**31 - 1.
    subframe : float
        Part of a frame, from 0 up to 1.
    rate : tuple of int
        Numerator and denominator of the frame rate, both above 0.
    values : array [shape=(61,)]
        In packet order, see `rig.conversion.arkit.udp_order`.
    """

    device: str
    subject: str
    frame: int
    subframe: float
    rate: tuple[int, int]
    values: Float32

    @property
    def seconds(self) -> float:
        """Time of the frame: (frame + subframe) / rate."""
        return (self.frame + self.subframe) * self.rate[1] / self.rate[0]


def encode(packet: Packet) -> bytes:
    """Return the datagram.

    Raises
    ------
    FormatError
        If a text is empty or too long, a rate is not above 0, the frame number does not fit, or
        there are not 61 finite values.
    """
    device = _text_bytes(packet.device, "device id")
    subject = _text_bytes(packet.subject, "subject")
    numerator, denominator = packet.rate
    if numerator <= 0 or denominator <= 0:
        raise FormatError(f"frame rate {numerator}/{denominator}: both must be above 0")
    if not (0 <= packet.frame < 2**31 and 0 <= packet.subframe < 1):
        raise FormatError(
            f"frame {packet.frame} + {packet.subframe}: the number must be 0 to 2147483647 and the "
            "sub-frame 0 up to 1"
        )
    values = np.asarray(packet.values, np.float32)
    if values.shape != (N_VALUES,) or not np.isfinite(values).all():
        raise FormatError(f"values of shape {values.shape} must be {N_VALUES} finite numbers")
    timing = _TIMING.pack(packet.frame, packet.subframe, numerator, denominator, N_VALUES)
    return bytes([VERSION]) + device + subject + timing + _VALUES.pack(*values.tolist())


def decode(data: bytes) -> Packet:
    """Return the frame of a datagram.

    Raises
    ------
    FormatError
        If it is of another version, too short or too long, its texts are no text, its rate is not
        above 0, its time is beyond `MAX_SECONDS`, or a value is not finite. Packets of
        a phone without a face in view hold no values and are too short.
    """
    if data[:1] != bytes([VERSION]):
        got = data[0] if data else "nothing"
        raise FormatError(f"datagram begins with {got}; a Live Link Face packet with {VERSION}")
    device, offset = _text_from(data, 1, "device id")
    subject, offset = _text_from(data, offset, "subject")
    wanted = offset + _TIMING.size + _VALUES.size
    if len(data) != wanted:
        raise FormatError(f"datagram has {len(data)} bytes; this packet needs {wanted}")
    frame, subframe, numerator, denominator, n_values = _TIMING.unpack_from(data, offset)
    if n_values != N_VALUES or numerator <= 0 or denominator <= 0 or frame < 0:
        raise FormatError(
            f"packet has frame {frame}, rate {numerator}/{denominator} and {n_values} values; "
            f"{N_VALUES} values and a rate above 0 are needed"
        )
    values = np.array(_VALUES.unpack_from(data, offset + _TIMING.size), np.float32)
    if not (np.isfinite(values).all() and math.isfinite(subframe)):
        raise FormatError("packet holds a value that is not finite")
    packet = Packet(device, subject, frame, subframe, (numerator, denominator), values)
    if not abs(packet.seconds) <= MAX_SECONDS:
        raise FormatError(f"packet's time is {packet.seconds:g} s; at most {MAX_SECONDS:g} s")
    return packet


def _text_bytes(text: str, what: str) -> bytes:
    data = text.encode("utf-8")
    if not 0 < len(data) <= MAX_TEXT_BYTES:
        raise FormatError(f"{what} has {len(data)} bytes; 1 to {MAX_TEXT_BYTES} are allowed")
    return struct.pack("!i", len(data)) + data


def _text_from(data: bytes, offset: int, what: str) -> tuple[str, int]:
    start = offset + 4
    if len(data) < start:
        raise FormatError(f"datagram of {len(data)} bytes ends before its {what}")
    (length,) = struct.unpack_from("!i", data, offset)
    if not 0 <= length <= MAX_TEXT_BYTES or len(data) < start + length:
        raise FormatError(f"{what} of {length} bytes does not fit the datagram of {len(data)}")
    try:
        return data[start : start + length].decode("utf-8"), start + length
    except UnicodeDecodeError as error:
        raise FormatError(f"{what} is no UTF-8 text: {error.reason}") from error


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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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
        n_packets: int = MAX_PACKETS,
        is_over: Callable[[], bool] = lambda: False,
    ) -> Recording:
        """Collect packets of one subject until a limit or an interrupt.

        Parameters
        ----------
        subject : str, optional
            Subject of the packets to take; that of the first packet by default.
        seconds, idle_seconds : float, optional
            See `packets`.
        n_packets : int
            Most packets to take.
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
                if len(taken) >= min(n_packets, MAX_PACKETS):
                    break
        except KeyboardInterrupt:
            pass
        return _recording(subject or "", taken, self.n_garbage, n_other, tuple(others))


def _recording(
    subject: str, taken: list[Packet], n_garbage: int, n_other: int, others: tuple[str, ...]
) -> Recording:
    """Sort packets by time and count lost and late ones."""
    highest, n_late = -1.0, 0
    for packet in taken:
        n_late += packet.seconds < highest
        highest = max(highest, packet.seconds)
    by_time = {packet.seconds: packet for packet in taken}
    packets = tuple(by_time[seconds] for seconds in sorted(by_time))
    frames = {packet.frame for packet in packets}
    n_lost = max(frames) - min(frames) + 1 - len(frames) if frames else 0
    return Recording(subject, packets, n_lost, n_late, n_garbage, n_other, others)
