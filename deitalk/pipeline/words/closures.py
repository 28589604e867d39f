"""Closures that curves miss, by the words of the recording: ``deitalk validate --words``."""

from pathlib import Path

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import load_audio
from deitalk.errors import DataError
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.words.align import WordFit, align_words
from deitalk.pipeline.words.transcript import Transcript
from deitalk.postprocess.known_phones import KnownPhone
from deitalk.postprocess.phones import BILABIALS, WIDEN_FRAMES
from rig import RigCurves, read_curves
from rig.arrays import Float32
from rig.controls import DEFAULT_ID
from rig.validation.findings import Finding

MET = 0.9
"""Least value of the lips-together controls of lips that meet."""
TAKE_SOUND, TAKE_CURVES = "audio.wav", "curves.csv"


def check_closures(path: Path, transcript: Transcript, audio: Path | None = None) -> list[Finding]:
    """Findings on the closures of a take, or of a file of curves with its recording.

    Parameters
    ----------
    path : Path
        Take folder, or a file of curves.
    transcript : Transcript
        What is said.
    audio : Path, optional
        The recording; by default that of the take.

    Returns
    -------
    list of Finding
        A note, or a warning where the words do not fit the sound; a warning for each p, b and m at
        which the lips do not meet.

    Raises
    ------
    DataError
        If there is no recording, or the curves have no lips-together controls.
    """
    curves_path = path / TAKE_CURVES if path.is_dir() else path
    if audio is None:
        audio = path / TAKE_SOUND if path.is_dir() else None
    if audio is None or not audio.is_file():
        raise DataError(f"{path}: no recording to compare the words with; name it")
    curves = read_curves(curves_path, control_set=DEFAULT_ID)
    fit = align_words(Speech.of(load_audio(audio).waveform), transcript)
    words = Finding("note" if fit.fits else "warning", curves_path, fit.line)
    return [words, *(Finding("warning", curves_path, t) for t in missed_closures(curves, fit))]


def missed_closures(curves: RigCurves, fit: WordFit) -> list[str]:
    """A line for each p, b and m at which the lips do not meet, within two frames at 30 Hz."""
    places = [i for i, name in enumerate(curves.names) if "lipsTogether" in name]
    if not places:
        raise DataError("the curves have no lips-together controls; convert them to the board")
    lips = curves.values[:, places].mean(axis=1)
    lines = []
    for phone in fit.known:
        if phone.name in BILABIALS:
            value = highest(lips, curves.fps, phone)
            if value < MET:
                middle = (phone.start + phone.end) / 2
                inside = (repr(w.text) for w in fit.words if w.start <= middle < w.end)
                lines.append(
                    f"{phone.start:.2f} s: the lips do not meet at {phone.name.lower()} of "
                    f"{next(inside, 'a word')} ({value:.2f} of {MET:g})"
                )
    return lines


def highest(lips: Float32, fps: float, phone: KnownPhone) -> float:
    """Highest value within a phone widened by two frames at 30 Hz; 0 beyond the curves."""
    times = np.arange(len(lips)) / fps
    slack = WIDEN_FRAMES / FRAME_RATE + 1e-9
    window = lips[(times >= phone.start - slack) & (times <= phone.end + slack)]
    return float(window.max()) if len(window) else 0.0
