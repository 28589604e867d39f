"""Live Link Face packets, ARKit mode, version 6, as sent by the iPhone app to UDP port 11111.

Big endian::

    u8  version = 6
    i32 length, device id (text)
    i32 length, subject name (text)
    i32 frame number    f32 sub-frame in [0, 1)
    i32 rate numerator  i32 rate denominator
    u8  number of values = 61
    61 x f32            values in the order of Unreal's EARFaceBlendShape

With an id of d and a name of n bytes that is 270 + d + n bytes. Three mistakes of other senders
are avoided here: the denominator is never 0 (int(fps / 60) is, at 30 fps, and Unreal then divides
by it), the sub-frame is not a constant, and negative rotations are not clamped away.
"""

import math
import struct
from dataclasses import dataclass

import numpy as np

from rig.arrays import Float32
from rig.errors import FormatError

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
    """Return the datagram."""
    texts = [text.encode() for text in (packet.device, packet.subject)]
    timing = _TIMING.pack(packet.frame, packet.subframe, *packet.rate, N_VALUES)
    named = [struct.pack("!i", len(text)) + text for text in texts]
    values = _VALUES.pack(*packet.values.tolist())
    return b"".join((bytes([VERSION]), *named, timing, values))


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
