"""Input of a preview: curves, their recording, and the neutral reading if it is known."""

import base64
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.audio.decoding import open_sound
from deitalk.data.clips import read_phones
from deitalk.errors import DeitalkError
from rig import RigCurves, default_controls
from rig.arrays import Float32
from rig.controls import DEFAULT_ID
from rig.formats import read_known_or_own

MAX_SECONDS = 1800.0
MAX_AUDIO_BYTES = 500_000_000
TOLERANCE_SECONDS = 0.1
"""Largest difference in length of curves and recording: a frame or two of rounding."""

Phones = tuple[tuple[float, float, str], ...]


class PreviewError(DeitalkError):
    """A preview that cannot be made."""


@dataclass(frozen=True)
class PreviewSource:
    """One performance for a preview.

    Attributes
    ----------
    title : str
    curves : RigCurves
        All 185 controls of the board, with emotion and intensity if they are known; or those of
        another rig (`is_board` is false), which are shown as curves alone.
    samples : ndarray [shape=(S,)], float32
        The recording, mono, -1..1; empty without one.
    sample_rate : int
        Hz; 0 without a recording.
    neutral : ndarray [shape=(T, C)] or None
        The neutral reading of the same speech.
    phones : tuple of (start, end, name)
        Seconds and ARPABET names, where they are known.
    """

    title: str
    curves: RigCurves
    samples: Float32
    sample_rate: int
    neutral: Float32 | None = None
    phones: Phones = ()

    @property
    def audio_seconds(self) -> float:
        """Length of the recording; 0 without one."""
        return len(self.samples) / self.sample_rate if self.sample_rate else 0.0

    @property
    def is_board(self) -> bool:
        """Whether the curves move the head of a preview."""
        return self.curves.control_set == DEFAULT_ID


def load_source(
    source: Path | str,
    audio: Path | str | None = None,
    phones: Path | str | None = None,
) -> PreviewSource:
    """Read a take folder, or a file of curves with its recording.

    Parameters
    ----------
    source : Path or str
        Folder written by ``deitalk animate``, or a curve file of any known format.
    audio : Path or str, optional
        The recording; by default that of the take folder.
    phones : Path or str, optional
        Table ``start,end,phone`` in seconds; by default ``phones.csv`` of the take folder, if any.

    Raises
    ------
    PreviewError
        If something is missing, the recording is longer than the curves, or either is too long.
    AudioError
        If the recording cannot be read.
    DataError
        If the phones cannot be read.
    """
    source = Path(source)
    if not source.exists():
        raise PreviewError(f"{source} does not exist; name a take folder or a file of curves")
    if source.is_dir():
        path = source / "curves.json"
        if not path.is_file():
            raise PreviewError(
                f"{source} has no curves.json; name a folder that deitalk animate wrote"
            )
        curves = _read(path)
        recording = Path(audio) if audio is not None else source / "audio.wav"
        samples, rate = _read_audio(recording)
        neutral = None
        if (source / "neutral.npz").is_file():
            neutral = _read(source / "neutral.npz").values
            if neutral.shape != curves.values.shape:
                raise PreviewError(
                    f"neutral.npz has {len(neutral)} frames and curves.json {len(curves)}; "
                    "write the take again"
                )
        if phones is None and (source / "phones.csv").is_file():
            phones = source / "phones.csv"
        known = _read_phones(phones)
        return _checked(PreviewSource(source.name, curves, samples, rate, neutral, known))
    curves = _read(source)
    samples, rate = (np.zeros(0, np.float32), 0) if audio is None else _read_audio(Path(audio))
    return _checked(PreviewSource(source.stem, curves, samples, rate, None, _read_phones(phones)))


def _read_phones(path: Path | str | None) -> Phones:
    if path is None:
        return ()
    if not Path(path).is_file():
        raise PreviewError(f"phones {path} do not exist; name a CSV with start, end and phone")
    return tuple(read_phones(Path(path)))


def _read(path: Path) -> RigCurves:
    """Curves with all 185 controls in the board's order, or those of a user's own rig."""
    curves, names = read_known_or_own(path), default_controls().names
    is_ready = curves.control_set != DEFAULT_ID or curves.names == names
    return curves if is_ready else curves.select(names)


def check_board(source: PreviewSource) -> None:
    """Refuse curves of a rig that has no head here.

    Raises
    ------
    PreviewError
    """
    if not source.is_board:
        raise PreviewError(
            f"{source.title} is of the rig {source.curves.control_set}, which has no head here; "
            "a page (.html) shows its curves, `deitalk retarget` moves your own face"
        )


def sound_as_wav(source: PreviewSource) -> str:
    """The recording as WAV, base64; empty without one."""
    import soundfile

    if not source.sample_rate:
        return ""
    buffer = io.BytesIO()
    soundfile.write(buffer, source.samples, source.sample_rate, format="WAV", subtype="PCM_16")
    return base64.b64encode(buffer.getvalue()).decode()


def _read_audio(path: Path) -> tuple[Float32, int]:
    """Mono samples at the recording's own rate."""
    if not path.is_file():
        raise PreviewError(f"recording {path} does not exist; give `audio`", parameter="audio")
    if path.stat().st_size > MAX_AUDIO_BYTES:
        raise PreviewError(f"recording {path} is over {MAX_AUDIO_BYTES / 1e6:.0f} MB; cut it first")
    blocks = [np.zeros(0, np.float32)]
    with open_sound(str(path), None) as sound:
        for block in sound.blocks(sound.rate):
            blocks.append(block.mean(axis=1))
            if len(blocks) > MAX_SECONDS + 1:
                raise PreviewError(
                    f"recording {path} is longer than a preview, {MAX_SECONDS:.0f} s; cut it first"
                )
        return np.concatenate(blocks), sound.rate


def _checked(source: PreviewSource) -> PreviewSource:
    seconds = source.curves.duration
    if len(source.curves) == 0:
        raise PreviewError(f"{source.title} has no frames; a preview needs at least one")
    if max(seconds, source.audio_seconds) > MAX_SECONDS:
        raise PreviewError(
            f"{source.title} lasts {max(seconds, source.audio_seconds):.0f} s; "
            f"a preview shows at most {MAX_SECONDS:.0f} s, cut it first"
        )
    if source.audio_seconds > seconds + TOLERANCE_SECONDS:
        raise PreviewError(
            f"recording lasts {source.audio_seconds:.2f} s but the curves end at {seconds:.2f} s; "
            "cut the recording, or animate the whole of it"
        )
    return source
