"""Choice of the signal of a recording: track, channel, and the form of samples without a header."""

from dataclasses import dataclass
from numbers import Integral
from typing import Any

from deitalk.errors import AudioError
from rig.errors import quoted

LEFT, RIGHT, CENTRE, LOUDEST, MIX = "left", "right", "centre", "loudest", "mix"
CHANNEL_NAMES = (LEFT, RIGHT, CENTRE, LOUDEST, MIX)
MOST_CHANNELS = 64
"""Most channels of a recording."""
MOST_TRACKS = 64
LOWEST_RATE, HIGHEST_RATE = 4_000, 768_000
"""Hz that are read."""
ENCODINGS = {
    "s8": ("PCM_S8", "FILE", 1), "u8": ("PCM_U8", "FILE", 1),
    "s16le": ("PCM_16", "LITTLE", 2), "s16be": ("PCM_16", "BIG", 2),
    "s24le": ("PCM_24", "LITTLE", 3), "s24be": ("PCM_24", "BIG", 3),
    "s32le": ("PCM_32", "LITTLE", 4), "s32be": ("PCM_32", "BIG", 4),
    "f32le": ("FLOAT", "LITTLE", 4), "f32be": ("FLOAT", "BIG", 4),
    "f64le": ("DOUBLE", "LITTLE", 8), "f64be": ("DOUBLE", "BIG", 8),
    "mulaw": ("ULAW", "FILE", 1), "alaw": ("ALAW", "FILE", 1),
}  # fmt: skip
"""Samples without a header: subtype, byte order of libsndfile, and bytes."""


@dataclass(frozen=True)
class RawFormat:
    """Form of samples without a header.

    Attributes
    ----------
    encoding : str
        A name of `ENCODINGS`, such as ``s16le``.
    rate : int
        Hz.
    channels : int
        Interleaved.
    """

    encoding: str
    rate: int
    channels: int = 1

    @classmethod
    def of(cls, given: "str | RawFormat") -> "RawFormat":
        """Parse ``encoding,rate`` or ``encoding,rate,channels``.

        Raises
        ------
        AudioError
            If it is none of these, or a number is out of its range.
        """
        if isinstance(given, RawFormat):
            return given
        parts = [part.strip() for part in str(given).lower().split(",")]
        numbers = [_whole(part) for part in (*parts[1:], "1")[:2]]
        is_known = parts[0] in ENCODINGS and 2 <= len(parts) <= 3
        rates, counts = range(LOWEST_RATE, HIGHEST_RATE + 1), range(1, MOST_CHANNELS + 1)
        if not (is_known and numbers[0] in rates and numbers[1] in counts):
            raise AudioError(
                f"raw {quoted(given)} must be an encoding ({', '.join(ENCODINGS)}), a rate of "
                f"{LOWEST_RATE} to {HIGHEST_RATE} Hz and up to {MOST_CHANNELS} channels, such as "
                "s16le,24000,1"
            )
        return cls(parts[0], numbers[0], numbers[1])

    @property
    def frame_bytes(self) -> int:
        """Bytes of one sample of all channels."""
        return ENCODINGS[self.encoding][2] * self.channels

    def __str__(self) -> str:
        return f"{self.encoding},{self.rate},{self.channels}"


@dataclass(frozen=True)
class AudioChoice:
    """Choice of the signal of a recording that is read.

    Attributes
    ----------
    track : int, optional
        Number of a sound track from 1 on; by default the first one with speech.
    channel : str, optional
        A number from 1 on, ``left``, ``right``, ``centre``, ``loudest`` or ``mix``; by default the
        centre of a surround recording that has the speech there, else the mean of all channels.
    raw : RawFormat, optional
        Form of samples that come without a header.
    """

    track: int | None = None
    channel: str | None = None
    raw: RawFormat | None = None

    @classmethod
    def of(cls, track: Any = None, channel: Any = None, raw: Any = None) -> "AudioChoice":
        """A choice of values or their text; None and empty text are the defaults.

        Raises
        ------
        AudioError
            If one is none of those that are known.
        """
        if track in (None, ""):
            track = None
        else:
            number = _whole(track) if isinstance(track, str) else track
            is_whole = isinstance(number, Integral) and not isinstance(number, bool)
            if not is_whole or not 1 <= int(number) <= MOST_TRACKS:
                raise AudioError(
                    f"track {quoted(track)} must be a whole number, 1 to {MOST_TRACKS}"
                )
            track = int(number)
        name = "" if channel is None else str(channel).strip().lower()
        if 1 <= _whole(name) <= MOST_CHANNELS:
            name = str(int(name))
        elif name not in ("", "center", *CHANNEL_NAMES):
            raise AudioError(
                f"channel {quoted(channel)} must be a number from 1 to {MOST_CHANNELS}, or one of "
                f"{', '.join(CHANNEL_NAMES)}"
            )
        name = CENTRE if name == "center" else name
        return cls(track, name or None, None if raw in (None, "") else RawFormat.of(raw))

    @property
    def is_mix(self) -> bool:
        """Whether all channels are read."""
        return self.channel in (None, MIX)

    @property
    def settings(self) -> dict[str, Any]:
        """The choice as JSON; `of` it gives the same choice."""
        raw = None if self.raw is None else str(self.raw)
        given = {"track": self.track, "channel": self.channel, "raw": raw}
        return {name: value for name, value in given.items() if value is not None}


def channel_index(channel: str, n_channels: int, layout: tuple[str, ...]) -> int:
    """Place of a channel that is named ``left``, ``right``, ``centre`` or by its number.

    Parameters
    ----------
    channel : str
        Of `AudioChoice`.
    n_channels : int
        Of the recording.
    layout : tuple of str
        Names of its channels, or empty.

    Raises
    ------
    AudioError
        If there is no such channel.
    """
    names = {LEFT: "FL", RIGHT: "FR", CENTRE: "FC"}
    if channel.isdecimal() and int(channel) <= n_channels:
        return int(channel) - 1
    if channel in names and names[channel] in layout:
        return layout.index(names[channel])
    if n_channels >= 2 and channel in (LEFT, RIGHT) and not layout:
        return (LEFT, RIGHT).index(channel)
    known = "its only channel is 1" if n_channels == 1 else f"its channels are 1 to {n_channels}"
    if layout and n_channels > 1:
        known += f" ({', '.join(layout)})"
    raise AudioError(f"there is no channel {channel}: {known}; leave it out, or name another")


def _whole(text: str) -> int:
    """A whole number of up to 8 digits; 0 for any other text."""
    return int(text) if text.strip().isdecimal() and len(text.strip()) < 9 else 0
