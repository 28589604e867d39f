"""flite, one process per utterance: statistical voices with phone times within 10 to 20 ms."""

import shutil
import subprocess
import tempfile
from pathlib import Path

from deitalk.errors import AudioError, ConfigError, DataError, MissingError
from deitalk.postprocess.phones import PHONES
from deitalk.research.corpus.engines.espeak import check_ranges
from deitalk.research.corpus.recordings import read_waveform
from deitalk.research.corpus.utterance import SAMPLE_RATE, Utterance, contiguous

PACKAGE = "flite"
MISSING = f"flite: the program flite is not on this machine; apt-get install {PACKAGE}"
VOICES = {"slt": 180.0, "rms": 100.0, "awb": 125.0, "kal16": 105.0}
"""American and Scottish voices at 16 kHz and their F0 means in Hz (rms ignores the mean)."""
TIMEOUT_SECONDS = 60


def missing() -> str | None:
    """Return None if flite works here, else the reason and the package to install."""
    return None if shutil.which("flite") else MISSING


def synthesise(
    text: str,
    *,
    voice: str = "slt",
    stretch: float = 1.0,
    f0_mean: float | None = None,
    f0_stddev: float | None = None,
    style: str = "neutral",
) -> Utterance:
    """Synthesise `text` with phone times.

    Parameters
    ----------
    text : str
        Plain English text.
    voice : str
        One of `VOICES`.
    stretch : float
        Factor on all durations, 0.3 to 4.
    f0_mean, f0_stddev : float, optional
        Pitch in Hz, 40 to 500 and 0 to 150; the voice's own by default.
    style : str
        Emotion whose prosody the numbers above carry; kept in the utterance.

    Returns
    -------
    utterance : Utterance

    Raises
    ------
    ConfigError
        For an unknown voice or a number out of its range.
    DataError
        If the text gives no speech.
    MissingError
        If flite is not installed.
    """
    f0_mean = VOICES.get(voice) if f0_mean is None else f0_mean
    if voice not in VOICES or f0_mean is None:
        raise ConfigError(f"voice={voice!r} is not a flite voice; known: {', '.join(VOICES)}")
    check_ranges(stretch=(stretch, 0.3, 4), f0_mean=(f0_mean, 40, 500))
    features = [f"duration_stretch={stretch:g}", f"int_f0_target_mean={f0_mean:g}"]
    if f0_stddev is not None:
        check_ranges(f0_stddev=(f0_stddev, 0, 150))
        features.append(f"int_f0_target_stddev={f0_stddev:g}")
    if reason := missing():
        raise MissingError(reason)
    with tempfile.TemporaryDirectory() as folder:
        audio = Path(folder) / "speech.wav"
        settings = [word for feature in features for word in ("--setf", feature)]
        command = ["flite", "-voice", voice, *settings, "-psdur", "-o", str(audio), "-t", text]
        listing = _run(command, text)
        try:
            waveform = read_waveform(audio)
        except AudioError as error:
            raise DataError(f"text={text!r} gives no speech in the flite voice {voice}") from error
    segments = parse_durations(listing)
    if all(name == "SIL" for *_, name in segments):
        raise DataError(f"text={text!r} gives no speech in the flite voice {voice}")
    return Utterance(
        waveform=waveform,
        phones=contiguous(segments, len(waveform) / SAMPLE_RATE),
        text=text,
        style=style,
        speaker=f"flite:{voice}",
        engine="flite",
        language="en",
    )


def parse_durations(listing: str) -> list[tuple[float, float, str]]:
    """Timed phones of flite's ``-psdur`` listing: ``pau:0.164 hh:0.255 ...`` (phone:end).

    A listing of several utterances starts again at 0; the returned times increase throughout.

    Parameters
    ----------
    listing : str
        Output of flite.

    Returns
    -------
    segments : list of (start, end, name)
        Seconds.
    """
    segments: list[tuple[float, float, str]] = []
    offset = previous = 0.0
    for token in listing.split():
        name, _, end = token.rpartition(":")
        if float(end) < previous:
            offset, previous = offset + previous, 0.0
        segments.append((offset + previous, offset + float(end), festival_to_phone(name)))
        previous = float(end)
    return segments


def _run(command: list[str], text: str) -> str:
    """Standard output of flite."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=True
        )
    except (subprocess.SubprocessError, OSError, ValueError) as error:
        raise DataError(f"text={text!r} cannot be synthesised by flite: {error}") from error
    return done.stdout


FESTIVAL_NAMES = {
    "pau": "SIL", "h#": "SIL", "#": "SIL", "brth": "SIL", "sil": "SIL", "ssil": "SIL",
    "axr": "ER", "hv": "HH", "em": "M", "en": "N", "el": "L", "nx": "N", "eng": "NG", "q": "Q",
}  # fmt: skip


def festival_to_phone(name: str) -> str:
    """Phone of a festival or flite name; unknown names become AX."""
    phone = FESTIVAL_NAMES.get(name.lower(), name.upper())
    return phone if phone in PHONES else "AX"
