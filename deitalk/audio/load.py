"""Any recording -> mono float32 at 16 kHz (DEITalk §3.2), read in blocks so that hours fit.

Letters: N samples at the source's rate, n of a block, C channels.
"""

import stat
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from deitalk.audio.channels import Mixing, Survey, centre, has_own_centre, mixing
from deitalk.audio.choice import HIGHEST_RATE, LOUDEST, LOWEST_RATE, AudioChoice
from deitalk.audio.decoding import SoundSource, open_sound
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.original import start_seconds, wav_header
from deitalk.audio.speech_warnings import describe
from deitalk.audio.voice_activity import speech_activity
from deitalk.errors import AudioError
from rig.arrays import Float32
from rig.errors import as_line
from rig.files import atomic_write

__all__ = [
    "Recording",
    "check_path",
    "checked_waveform",
    "load_audio",
    "load_chosen",
    "read_sound",
    "write_wav",
]

MAX_SECONDS = 3 * 3600.0
MAX_STREAM_BYTES = 2 * 1024**3  # of a file-like source, which is held in memory
MOST_HEARD = 8  # tracks that are read to find the speech
BLOCK_SAMPLES = 1 << 20  # per read, over all channels: 4 MB of float32
LOUDEST_SAMPLE = 1e12  # beyond any PCM scaling: the file is not audio


@dataclass(frozen=True, repr=False)
class Recording:
    """One recording, ready for a model.

    Attributes
    ----------
    waveform : ndarray (S,) float32
        Mono, 16 kHz, without its mean (DC). Nominally within ±1.
    source : str
        The path, or ``<bytes>`` or ``<stream>``.
    source_rate : int
        Hz, before resampling.
    channels : int
        Before mixing.
    clipped_fraction : float
        Share of source samples inside flat runs (3 or more equal samples at full scale), 0 … 1.
    warnings : tuple of str
        Properties that lower the quality of the animation, such as clipping.
    start : float, optional
        Time of day of the first sample, seconds, of a WAV file with a chunk ``bext``.
    choice : AudioChoice
        The track and the channel that were read; without a channel the mean of all.
    """

    waveform: Float32
    source: str
    source_rate: int
    channels: int
    clipped_fraction: float = 0.0
    warnings: tuple[str, ...] = ()
    sample_rate: int = SAMPLE_RATE
    start: float | None = None
    choice: AudioChoice = field(default_factory=AudioChoice)

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return len(self.waveform) / self.sample_rate

    @property
    def n_frames(self) -> int:
        """Rig frames at 30 Hz that cover the recording."""
        return frame_count(len(self.waveform))

    @cached_property
    def activity(self) -> Float32:
        """Speech activity of each rig frame: 1 in speech, else 0."""
        return speech_activity(self.waveform)

    def noted(self, *notes: str) -> "Recording":
        """The recording with more warnings; its activity is measured once."""
        noted = replace(self, warnings=(*self.warnings, *notes))
        if "activity" in vars(self):
            vars(noted)["activity"] = self.activity
        return noted

    def __repr__(self) -> str:
        count = len(self.warnings)
        notes = f", {count} note{'s' * (count != 1)}" if count else ""
        return (
            f"<Recording {self.source!r}: {self.duration:.2f} s at {self.sample_rate} Hz (from "
            f"{self.source_rate} Hz, {self.channels} channel{'s' * (self.channels != 1)}){notes}>"
        )


def load_audio(
    source: str | Path | bytes | IO[bytes],
    *,
    max_seconds: float = MAX_SECONDS,
    track: int | None = None,
    channel: str | int | None = None,
    raw: str | None = None,
) -> Recording:
    """Read a recording as mono 16 kHz, in its time.

    wav, flac, ogg, opus and the other formats of libsndfile; mp3, m4a, mp4, mov, webm, aac and wma
    through FFmpeg's libraries. Several recordings one after another in one file are all read; where
    a container says that its sound begins later or has a hole, there is silence. Of several tracks
    the first one with speech is read. Channels are averaged; if they cancel (phase-inverted
    stereo), the loudest one is taken instead, and of surround sound the centre if it has speech.
    The length is N · 16000 / rate, rounded. The recording's `warnings` report what was chosen,
    added or corrected, a file cut short, channels with different voices, clipping, DC, a level far
    off, no speech.

    Parameters
    ----------
    source : path, bytes or binary file object
        A file object is read to its end, at most 2 GiB.
    max_seconds : float
        Longer recordings are refused.
    track : int, optional
        Number of a sound track, from 1 on.
    channel : int or str, optional
        Number of a channel from 1 on, ``left``, ``right``, ``centre``, ``loudest`` or ``mix``.
    raw : str, optional
        Form of samples without a header: encoding, rate and channels, such as ``s16le,24000,1``.

    Returns
    -------
    Recording

    Raises
    ------
    AudioError
        If the source is missing, unreadable, empty, no audio, without sound, not finite or too
        long, its rate is outside 4 … 768 kHz, or there is no such track or channel.

    Notes
    -----
    Paper silent: §3.2 says only "via the Librosa library at a sampling frequency of 16kHz";
    mixing, DC removal and soxr's HQ resampler are ours.
    """
    return load_chosen(source, AudioChoice.of(track, channel, raw), max_seconds=max_seconds)


def load_chosen(
    source: str | Path | bytes | IO[bytes],
    choice: AudioChoice,
    *,
    max_seconds: float = MAX_SECONDS,
    name: str | None = None,
) -> Recording:
    """Read a recording as `load_audio` does; messages call it `name`, if one is given."""
    own, data = _name_and_data(source)
    name = name or own
    with open_sound(name, data, choice) as sound:
        start = start_seconds(name if data is None else data)
        return read_sound(name, sound, max_seconds, start, choice)


def read_sound(
    name: str,
    sound: SoundSource,
    max_seconds: float = MAX_SECONDS,
    start: float | None = None,
    choice: AudioChoice = AudioChoice(),
) -> Recording:
    """Choose, mix, resample and describe an open source; see `load_audio` for how and for errors.

    `choice` is that which the source was opened with.
    """
    read = partial(_read_track, name, max_seconds=max_seconds, start=start, choice=choice)
    if choice.track is not None or len(sound.tracks) == 1:
        return read(sound)
    # The first track with speech; a later one if it has more than twice as much.
    chosen, most, found = read(sound), 0.0, {}
    for number in range(1, min(len(sound.tracks), MOST_HEARD) + 1):
        try:
            recording = chosen if number == sound.track else read(sound.on(number))
        except AudioError as error:
            found[number] = str(error).removeprefix(f"{name} ")
            continue
        seconds = float(recording.activity.sum()) / FRAME_RATE
        found[number] = f"has {seconds:.1f} s of speech" if seconds else "has no speech"
        if seconds > 2 * most:
            chosen, most = recording, seconds
    taken = chosen.choice.track
    others = ", ".join(
        f"{number}{f' ({as_line(sound.tracks[number - 1])})' * bool(sound.tracks[number - 1])} "
        f"{text}"
        for number, text in found.items()
    )
    rest = len(sound.tracks) - len(found)
    others += f", {rest} more were not looked at" if rest else ""
    note = f"{len(sound.tracks)} sound tracks: track {taken} was taken; {others}"
    return replace(chosen, warnings=(note, *chosen.warnings))


def _read_track(
    name: str,
    sound: SoundSource,
    *,
    max_seconds: float,
    start: float | None,
    choice: AudioChoice,
) -> Recording:
    """One track of an open source."""
    rate = sound.rate
    if not LOWEST_RATE <= rate <= HIGHEST_RATE:
        raise AudioError(
            f"{name}: the sample rate is {rate} Hz; it must be {LOWEST_RATE} to "
            f"{HIGHEST_RATE} Hz: export it at 16000 Hz or more"
        )
    if sound.expected / rate > max_seconds:
        raise _too_long(name, sound.expected / rate, max_seconds)
    survey = Survey(sound.channels, sound.rate)
    if sound.channels > 1 and choice.channel in (None, LOUDEST):
        for block in _finite_blocks(name, sound):
            survey.add(block)

    def read(mixed: Mixing) -> tuple[Mixing, Float32, list[str], float]:
        reader = _MonoReader(name, sound, max_seconds)
        for block in _finite_blocks(name, sound):
            reader.add(block, mixed.weights)
        return mixed, *reader.finish(), reader.clipped_fraction

    has_centre = choice.channel is None and has_own_centre(survey, sound.layout)
    if has_centre:  # surround sound: its centre if that has speech
        mixed, waveform, notes, clipped = read(centre(sound.layout))
    if not has_centre or not speech_activity(waveform).any():
        mixed, waveform, notes, clipped = read(mixing(survey, choice.channel, sound.layout))
    recording = Recording(
        waveform=waveform,
        source=name,
        source_rate=sound.rate,
        channels=sound.channels,
        clipped_fraction=clipped,
        warnings=(*sound.notes, *mixed.notes, *notes),
        start=start,
        choice=replace(
            choice, track=sound.track if len(sound.tracks) > 1 else choice.track,
            channel=mixed.channel,
        ),
    )  # fmt: skip
    return recording.noted(*describe(recording.waveform, recording.activity))


def write_wav(path: str | Path, waveform: npt.ArrayLike, *, start: float = 0.0) -> None:
    """Write mono 16-bit PCM at 16 kHz, atomically; samples beyond ±1 are clipped.

    Parameters
    ----------
    path : str or Path
        Replaced if it exists; its folder must exist.
    waveform : array (S,)
        Finite; 1.0 is full scale (32768 steps, so that 16-bit sources survive unchanged).
    start : float
        Time of day of the first sample, seconds; other than 0 it is written as ``bext``.

    Raises
    ------
    AudioError
        As `checked_waveform`; or if the file cannot be written.
    rig.errors.TargetError
        If the disk is full.
    """
    samples = checked_waveform(waveform)
    try:
        with atomic_write(path) as beside, beside.open("wb") as file:
            file.write(wav_header(SAMPLE_RATE, 1, 16, 2 * len(samples), start))
            for start in range(0, len(samples), BLOCK_SAMPLES):
                scaled = np.rint(samples[start : start + BLOCK_SAMPLES] * 32768.0)
                file.write(scaled.clip(-32768, 32767).astype("<i2").tobytes())
    except OSError as error:
        raise AudioError(
            f"cannot write {path}: {error.strerror or error}; name a folder that exists, "
            "is writable and has space"
        ) from error


def checked_waveform(waveform: npt.ArrayLike) -> Float32:
    """Return samples as float32 [shape=(S,)].

    Raises
    ------
    AudioError
        If they are no row of finite samples, or none at all.
    """
    samples = np.asarray(waveform, dtype=np.float32)
    blocks = range(0, len(samples) if samples.ndim == 1 else 0, BLOCK_SAMPLES)
    finite = (np.isfinite(samples[k : k + BLOCK_SAMPLES]).all() for k in blocks)
    if samples.ndim != 1 or not len(samples) or not all(finite):
        raise AudioError(
            f"a waveform of shape {samples.shape} cannot be used; give one row of finite samples "
            "at 16 kHz"
        )
    return samples


class _MonoReader:
    """Mix, resample and measure block after block, keeping only the 16 kHz result."""

    def __init__(self, name: str, sound: SoundSource, max_seconds: float) -> None:
        import soxr

        self.name, self.rate, self.max_seconds = name, sound.rate, max_seconds
        self.resampler = soxr.ResampleStream(
            sound.rate, SAMPLE_RATE, 1, dtype="float32", quality="HQ"
        )
        self.waveform = np.zeros(self._length(sound.expected) + SAMPLE_RATE, np.float32)
        self.filled = self.n_source = self.n_values = self.n_clipped = 0

    def add(self, block: Float32, weights: Float32) -> None:
        """Take one block (n, C) of the source."""
        self.n_source += len(block)
        self.n_values += block.size
        self.n_clipped += _count_clipped(block)
        if self.n_source > self.max_seconds * self.rate:
            raise _too_long(self.name, self.n_source / self.rate, self.max_seconds)
        self._append(self.resampler.resample_chunk(block @ weights))

    @property
    def clipped_fraction(self) -> float:
        return self.n_clipped / max(self.n_values, 1)

    def finish(self) -> tuple[Float32, list[str]]:
        """The waveform (S,) and notes about it."""
        if self.n_source == 0:
            raise AudioError(f"{self.name} holds 0 samples; record or export it again")
        self._append(self.resampler.resample_chunk(np.zeros(0, np.float32), last=True))
        waveform = self.waveform[: self._length(self.n_source)]
        offset = float(waveform.mean(dtype=np.float64))
        waveform -= np.float32(offset)
        peak = float(max(waveform.max(), -waveform.min()))
        notes = []
        if self.clipped_fraction > 1e-4:
            notes.append(f"{self.clipped_fraction:.2%} of the samples are clipped")
        if abs(offset) > 0.01 * max(peak, 1.0):
            notes.append(f"removed a DC offset of {offset:+.3f}")
        if peak > 8.0:
            waveform /= peak
            notes.append(f"samples reach {peak:.3g}, not ±1: scaled to a peak of 1")
        return waveform, notes

    def _length(self, n_source: int) -> int:
        return max(1, round(n_source * SAMPLE_RATE / self.rate))

    def _append(self, part: Float32) -> None:
        end = self.filled + len(part)
        if end > len(self.waveform):
            grown = np.zeros(max(end, len(self.waveform) * 3 // 2), np.float32)
            grown[: self.filled] = self.waveform[: self.filled]
            self.waveform = grown
        self.waveform[self.filled : end] = part
        self.filled = end


def _count_clipped(block: Float32) -> int:
    """Samples (n, C) that sit in a run of three or more equal ones at full scale."""
    loud = np.abs(block) >= 0.9999
    if not loud.any():
        return 0
    flat = (block[1:] == block[:-1]) & loud[1:]
    middle = flat[1:] & flat[:-1]  # sample i+1 equals both neighbours
    run = np.zeros(block.shape, bool)
    run[:-2] |= middle
    run[1:-1] |= middle
    run[2:] |= middle
    return int(run.sum())


def _finite_blocks(name: str, sound: SoundSource) -> Iterator[Float32]:
    """Blocks (n, C) float32 to the end of a recording, every sample finite."""
    start = 0
    for block in sound.blocks(max(1024, BLOCK_SAMPLES // sound.channels)):
        if not max(block.max(), -block.min()) <= LOUDEST_SAMPLE:  # also true of NaN
            at, channel = np.argwhere(~(np.abs(block) <= LOUDEST_SAMPLE))[0]
            raise AudioError(
                f"{name}: sample {start + at} ({(start + at) / sound.rate:.3f} s) is "
                f"{block[at, channel]}; samples must be finite, within ±{LOUDEST_SAMPLE:g}: "
                "export it as 16-bit PCM"
            )
        yield block
        start += len(block)


def _too_long(name: str, seconds: float, max_seconds: float) -> AudioError:
    return AudioError(
        f"{name} lasts {seconds:.0f} s or more; the limit is {max_seconds:.0f} s "
        f"({max_seconds / 3600:.3g} h): split it into shorter files"
    )


def _name_and_data(source: str | Path | bytes | IO[bytes]) -> tuple[str, bytes | None]:
    """Name of the source in messages, and its bytes unless it is a path."""
    if isinstance(source, str | Path):
        check_path(Path(source))
        return str(source), None
    if isinstance(source, bytes | bytearray | memoryview):
        name, data = "<bytes>", bytes(source)
    elif hasattr(source, "read"):
        name, data = str(getattr(source, "name", "<stream>")), source.read(MAX_STREAM_BYTES + 1)
    else:
        raise AudioError(
            f"a {type(source).__name__} is no recording; pass a path, bytes or a binary file"
        )
    if not isinstance(data, bytes):
        raise AudioError(f"{name} is a text stream; open it in binary mode ('rb')")
    if len(data) > MAX_STREAM_BYTES:
        raise AudioError(f"{name} is larger than 2 GiB; save it to a file and pass the path")
    if not data:
        raise AudioError(f"{name} is empty (0 bytes); record or export it again")
    return name, data


def check_path(path: Path) -> None:
    """Check a path before its content is read.

    Raises
    ------
    AudioError
        If it is no regular file, is empty or must not be read.
    """
    try:
        found = path.stat()
        if stat.S_ISREG(found.st_mode):
            path.open("rb").close()
    except (FileNotFoundError, NotADirectoryError, ValueError) as error:  # a name with a zero byte
        raise AudioError(f"there is no recording {path}; check the path") from error
    except OSError as error:
        raise AudioError(
            f"cannot read {path}: {error.strerror}; check its name and permissions"
        ) from error
    if stat.S_ISDIR(found.st_mode):
        raise AudioError(f"{path} is a folder, not a recording; name one file in it")
    if not stat.S_ISREG(found.st_mode):
        raise AudioError(f"{path} is not a regular file; copy its content to one")
    if found.st_size == 0:
        raise AudioError(f"{path} is empty (0 bytes); record or export it again")
