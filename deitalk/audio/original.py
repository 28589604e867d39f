"""The recording at 48 kHz, and the time of day of its first sample.

A WAV file of a field recorder or an audio workstation has a chunk ``bext`` (Broadcast Wave Format,
EBU Tech 3285) with the number of samples since midnight at its beginning. Unreal's SoundWave holds
that as its time code (FSoundWaveTimecodeInfo).

Letters: n samples of a block, C channels.
"""

import io
import re
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deitalk.audio.choice import AudioChoice, channel_index
from deitalk.audio.content import Content
from deitalk.audio.decoding import open_sound
from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.headers import RIFF_CHUNKS
from deitalk.errors import AudioError, DeitalkError
from rig.arrays import Float32
from rig.curves.timecode import DROPPED, left_out
from rig.files import atomic_write

ORIGINAL_RATE = 48_000
ZERO, RECORDING = "zero", "recording"
"""Time codes that are no time: none, and that of the recording."""
NO_TIMECODE = "the recording has no time code (bext chunk of a WAV): starts at 0"
DAY = 24 * 3600.0
BLOCK_SAMPLES = 1 << 20
MOST_BYTES = (1 << 32) - 1024
"""Most bytes of a WAV file, whose sizes are 32-bit numbers."""
_BEXT_BYTES, _TIME_REFERENCE = 602, 338
"""Size of the chunk's version 1 without history, and offset of the 64-bit number of samples."""
_TIMECODE = re.compile(r"(\d{1,2})[:;](\d{2})[:;](\d{2})(?:([:;])(\d{2,3})|(\.\d+))?")


def start_seconds(source: Path | str | bytes) -> float | None:
    """Time of day of the first sample of a WAV file or its bytes, seconds; None if it has none."""
    wanted = {b"fmt ": 8, b"bext": _TIME_REFERENCE + 8}
    try:
        with io.BytesIO(source) if isinstance(source, bytes) else open(source, "rb") as file:
            content = Content(file)
            head = content.at(0, 12)
            if head[:4] not in (b"RIFF", b"RF64") or head[8:] != b"WAVE":
                return None
            # Of an RF64 the size of the samples is elsewhere; bext stands before them.
            last = b"data" if head[:4] == b"RF64" else b""
            found, _, _ = RIFF_CHUNKS.walk(content, 12, last, wanted)
        (rate,) = struct.unpack("<4xI", found.get(b"fmt ", b""))
        (samples,) = struct.unpack_from("<Q", found.get(b"bext", b""), _TIME_REFERENCE)
    except (OSError, struct.error):
        return None
    return samples / rate if rate and samples / rate < DAY else None


def start_of(timecode: str, fps: float | None, recorded: float | None) -> tuple[float, str]:
    """Time of day of the first frame, seconds, and a note (else empty).

    Parameters
    ----------
    timecode : str
        ``zero``, ``recording``, or a time as for `parse_timecode`.
    fps : float, optional
        Rate of its frames; 30 by default.
    recorded : float, optional
        `start_seconds` of the recording.

    Raises
    ------
    DeitalkError
        If the time code is none of these.
    """
    if timecode == RECORDING:
        return recorded or 0.0, "" if recorded is not None else NO_TIMECODE
    return 0.0 if timecode == ZERO else parse_timecode(timecode, fps or FRAME_RATE), ""


def parse_timecode(text: str, fps: float) -> float:
    """Parse ``HH:MM:SS:FF``, drop frame ``HH:MM:SS;FF`` or ``HH:MM:SS.sss`` to seconds of the day.

    FF counts frames of the nearest whole rate. With ``:`` no numbers are left out; with ``;`` they
    are, and the time is that of a clock at 29.97 or 59.94 Hz.

    Raises
    ------
    DeitalkError
        If it is none of these, beyond a day, or drop frame at another rate or of a number that it
        leaves out.
    """
    match = _TIMECODE.fullmatch(text.strip())
    parts = [int(part) for part in match.groups()[:3]] if match else [99]
    frames, count = int(match[5] or 0) if match else 0, round(fps)
    is_drop = ";" in text
    is_one = match is not None and (not is_drop or match[4] is not None)
    if match is None or not is_one or parts[0] > 23 or max(parts[1:]) > 59 or frames >= count:
        raise DeitalkError(
            f"time code {text[:40]!r} is not HH:MM:SS:FF with FF below {count}, HH:MM:SS;FF (drop "
            "frame), HH:MM:SS.sss, recording or zero"
        )
    hours, minutes, seconds = parts
    if not is_drop:
        return hours * 3600 + minutes * 60 + seconds + frames / count + float(match[6] or 0)
    if count not in DROPPED:
        raise DeitalkError(
            f"time code {text[:40]!r} counts drop frame (;), which has 29.97 or 59.94 frames a "
            f"second and not {fps:g}; write HH:MM:SS:FF, or set `fps=29.97`",
            parameter="fps",
        )
    if seconds == 0 and minutes % 10 and frames < DROPPED[count]:
        raise DeitalkError(
            f"time code {text[:40]!r} does not exist: drop frame leaves out frames 00 to "
            f"{DROPPED[count] - 1:02d} of this minute; write {DROPPED[count]:02d}"
        )
    past = hours * 60 + minutes
    number = (past * 60 + seconds) * count + frames - int(left_out(past, count))
    return number * 1.001 / count


def write_original(
    path: Path,
    source: str,
    *,
    seconds: float,
    start: float = 0.0,
    choice: AudioChoice = AudioChoice(),
    lead: float = 0.0,
) -> None:
    """Write a recording as 48 kHz PCM, 24 bits or 16 if the source has 16.

    It has all channels of the track that was read, or the one that was taken of them.

    Parameters
    ----------
    path : Path
        The ``.wav``.
    source : str
        Path of the recording.
    seconds : float
        Length to write; a shorter recording is followed by silence.
    start : float
        Time of day of the first sample, seconds.
    choice : AudioChoice
        Of the recording that was read.
    lead : float
        Seconds of silence before it and after it.

    Raises
    ------
    AudioError
        If the recording cannot be read or the file cannot be written.
    """
    with open_sound(source, None, choice) as sound:
        before = round(lead * ORIGINAL_RATE)
        n_samples = 2 * before + round(seconds * ORIGINAL_RATE)
        width = _sample_bytes(source)
        scale = float(1 << (8 * width - 1))
        taken, count = slice(None), sound.channels
        if not choice.is_mix:
            index = channel_index(str(choice.channel), count, sound.layout)
            taken, count = slice(index, index + 1), 1
        n_bytes = n_samples * count * width
        if n_bytes > MOST_BYTES:
            raise AudioError(f"{source} is longer than a WAV file can be at 48 kHz")
        with atomic_write(path) as beside, beside.open("wb") as file:
            file.write(wav_header(ORIGINAL_RATE, count, 8 * width, n_bytes, start))
            file.write(bytes(before * count * width))
            left = n_samples - before
            blocks = (block[:, taken] for block in sound.blocks(BLOCK_SAMPLES // sound.channels))
            for block in _at_48k(blocks, sound.rate):
                numbers = np.rint(block[:left].astype(np.float64) * scale)
                numbers = numbers.clip(-scale, scale - 1).astype("<i4").view(np.uint8)
                file.write(numbers.reshape(-1, 4)[:, :width].tobytes())
                left -= min(left, len(block))
                if not left:
                    break
            for start_left in range(left, 0, -BLOCK_SAMPLES):
                n_left = min(start_left, BLOCK_SAMPLES)
                file.write(bytes(n_left * count * width))


def wav_header(rate: int, channels: int, bits: int, n_bytes: int, start: float = 0.0) -> bytes:
    """Bytes of a WAV file before its samples; with a chunk ``bext`` if it starts after midnight."""
    width = channels * bits // 8
    form = struct.pack("<HHIIHH", 1, channels, rate, rate * width, width, bits)
    chunks = b"fmt " + struct.pack("<I", len(form)) + form
    if start:
        bext = bytearray(_BEXT_BYTES)
        struct.pack_into("<QH", bext, _TIME_REFERENCE, round(start * rate), 1)
        chunks += b"bext" + struct.pack("<I", len(bext)) + bytes(bext)
    chunks += b"data" + struct.pack("<I", n_bytes)
    return b"RIFF" + struct.pack("<I", 4 + len(chunks) + n_bytes) + b"WAVE" + chunks


def _sample_bytes(source: str) -> int:
    import soundfile

    try:
        subtype = str(soundfile.info(source).subtype)
    except (RuntimeError, OSError):
        return 2
    return 3 if subtype in ("PCM_24", "PCM_32", "FLOAT", "DOUBLE") else 2


def _at_48k(blocks: Iterator[Float32], rate: int) -> Iterator[Float32]:
    """Blocks (n, C) at 48 kHz; those of that rate are passed on."""
    import soxr

    resampler = None
    for block in blocks:
        if rate == ORIGINAL_RATE:
            yield block
            continue
        resampler = resampler or soxr.ResampleStream(
            rate, ORIGINAL_RATE, block.shape[1], dtype="float32", quality="HQ"
        )
        yield resampler.resample_chunk(np.ascontiguousarray(block))
        last = block[:0]
    if resampler is not None:
        yield resampler.resample_chunk(last, last=True)
