"""espeak-ng: speech in many languages with the exact time of every phone.

Phone events are exact to about 4 ms except for stops, whose event is at the burst: `with_closures`
gives a stop the silent run before it.
"""

import atexit
import os
from functools import cache
from pathlib import Path

import numpy as np

from deitalk.errors import ConfigError, DataError
from deitalk.pipeline.words.alphabets import ipa_to_phones
from deitalk.pipeline.words.espeak import has_voice, known_voice, missing, pronounce
from deitalk.postprocess.phones import STOPS
from deitalk.research.corpus.engines.espeak_library import library
from deitalk.research.corpus.engines.espeak_server import Server
from deitalk.research.corpus.utterance import SAMPLE_RATE, Utterance, contiguous

__all__ = [
    "event_segments",
    "has_voice",
    "missing",
    "pronounce",
    "synthesise",
    "variants",
    "with_closures",
]

PRIMARY_SHARE = 0.65  # of an event that fuses two phones (a vowel and its r) belongs to the first


@cache
def _server(process_id: int) -> Server:
    """The server of this process; a forked process starts its own."""
    server = Server()
    atexit.register(server.close)
    return server


@cache
def variants() -> tuple[str, ...]:
    """Names of the voice variants installed (f1, m3, klatt, ...), sorted."""
    folder = Path(library().data_folder()) / "voices" / "!v"
    return tuple(sorted(p.name for p in folder.glob("*") if " " not in p.name))


def synthesise(
    text: str,
    *,
    voice: str = "en-us",
    variant: str | None = None,
    language: str = "en",
    rate: float = 165.0,
    pitch: float = 50.0,
    pitch_range: float = 50.0,
    volume: float = 100.0,
    style: str = "neutral",
    ssml: bool = False,
) -> Utterance:
    """Synthesise `text` with phone times.

    Parameters
    ----------
    text : str
        Plain text, or SSML (``<speak>...</speak>`` with ``<prosody>``) when `ssml` is set.
    voice, variant : str
        A voice (``en-us``, ``gmw/en``, ``es``) and one of `variants`.
    language : str
        Code kept in the utterance; it also determines the phones of the symbols `a` and `r`.
    rate : float
        Words per minute, 80 to 450.
    pitch, pitch_range : float
        0 to 100; 50 is the voice's own.
    volume : float
        Percent, 0 to 200; 100 is the engine's own.
    style : str
        Emotion whose prosody the numbers above carry; kept in the utterance.
    ssml : bool
        Whether `text` is SSML.

    Returns
    -------
    utterance : Utterance
        Its `text` is as given, tags included. Silence is digital zero: add a noise floor before
        training on it.

    Raises
    ------
    ConfigError
        For an unknown voice or a number out of its range.
    DataError
        If the text gives no speech.
    MissingError
        If espeak-ng is not installed.
    """
    check_ranges(rate=(rate, 80, 450), pitch=(pitch, 0, 100), pitch_range=(pitch_range, 0, 100),
                  volume=(volume, 0, 200))  # fmt: skip
    library()
    if variant is not None and variant not in variants():
        plain = ", ".join(name for name in variants() if len(name) == 2)
        raise ConfigError(f"variant={variant!r} is not installed; installed are {plain} and others")
    name = known_voice(voice if variant is None else f"{voice}+{variant}")
    numbers = {"rate": rate, "volume": volume, "pitch": pitch, "pitch_range": pitch_range}
    parameters = {key: round(value) for key, value in numbers.items()}
    samples, events = _server(os.getpid()).synthesise(text, name, parameters, ssml=ssml)
    waveform = np.frombuffer(samples, np.int16).astype(np.float32) / 32768
    if not np.any(waveform):
        raise DataError(f"text={text!r} gives no speech in the espeak-ng voice {name}")
    rate_hz = library().sample_rate
    segments = event_segments(waveform, rate_hz, events, language)
    segments = with_closures(waveform, rate_hz, segments)
    return Utterance(
        waveform=(resampled := _to_16khz(waveform, rate_hz)),
        phones=contiguous(segments, len(resampled) / SAMPLE_RATE),
        text=text,
        style=style,
        speaker=f"espeak:{name}",
        engine="espeak",
        language=language,
    )


def event_segments(
    waveform: np.ndarray, sample_rate: int, events: list[tuple[int, str]], language: str
) -> list[tuple[float, float, str]]:
    """Timed phones of phone events.

    Each event lasts until the next. An unnamed event is silence where the waveform is silent and
    lengthens the phone before it elsewhere; an event of several phones is divided.

    Parameters
    ----------
    waveform : float array [shape=(S,)]
        Synthesised speech.
    sample_rate : int
        Hz.
    events : list of (sample, IPA)
        Start of each phone.
    language : str
        Code that determines the phones of the symbols `a` and `r`.

    Returns
    -------
    segments : list of (start, end, name)
        Seconds, sorted.
    """
    segments: list[tuple[float, float, str]] = []
    ends = [sample for sample, _ in events[1:]] + [len(waveform)]
    for (start, ipa), end in zip(events, ends, strict=True):
        if end <= start:
            continue
        names = ipa_to_phones(ipa, language)
        if not names:
            is_silent = np.sqrt(np.mean(waveform[start:end] ** 2)) < 0.003
            names = ("SIL",) if is_silent or not segments else (segments[-1][2],)
        segments += _divide(start / sample_rate, end / sample_rate, names)
    return _join_repeats(segments)


def _divide(start: float, end: float, names: tuple[str, ...]) -> list[tuple[float, float, str]]:
    """Share a time between phones: `PRIMARY_SHARE` to the first, the rest in equal parts."""
    if len(names) == 1:
        return [(start, end, names[0])]
    middle = start + PRIMARY_SHARE * (end - start)
    cuts = np.linspace(middle, end, len(names))
    rest = zip(cuts[:-1], cuts[1:], names[1:], strict=True)
    return [(start, middle, names[0]), *((float(a), float(b), name) for a, b, name in rest)]


def _join_repeats(segments: list[tuple[float, float, str]]) -> list[tuple[float, float, str]]:
    """Segments with neighbours of the same name joined."""
    joined: list[tuple[float, float, str]] = []
    for start, end, name in segments:
        if joined and joined[-1][2] == name and start - joined[-1][1] < 1e-9:
            start = joined.pop()[0]
        joined.append((start, end, name))
    return joined


QUIET = 0.004
"""Largest absolute sample of a silent run."""
LONGEST_CLOSURE_SECONDS = 0.12
"""Longest closure; 20 ms of the phone before it stay."""


def with_closures(
    waveform: np.ndarray,
    sample_rate: int,
    segments: list[tuple[float, float, str]],
    *,
    longest_after_pause_seconds: float = 0.06,
) -> list[tuple[float, float, str]]:
    """Move the start of every stop back over the silent run before it.

    ::

        events     | vowel       . . . .| P burst |        the dots are silence
        result     | vowel      | P closure+burst |

    Parameters
    ----------
    waveform : float array [shape=(S,), range -1 to 1]
        Synthesised speech.
    sample_rate : int
        Hz.
    segments : list of (start, end, name)
        Seconds, sorted.
    longest_after_pause_seconds : float
        The longest closure after a pause, where silence does not mark the closing of the lips.

    Returns
    -------
    segments : list of (start, end, name)
    """
    hop = max(1, round(0.002 * sample_rate))
    n_hops = len(waveform) // hop
    is_quiet = np.abs(waveform[: n_hops * hop].reshape(n_hops, hop)).max(1) < QUIET
    fixed = list(segments)
    for i in range(1, len(fixed)):
        start, end, name = fixed[i]
        before_start, _, before = fixed[i - 1]
        if name not in STOPS:
            continue
        is_pause = before == "SIL"
        longest = longest_after_pause_seconds if is_pause else LONGEST_CLOSURE_SECONDS
        # Start of the silent run that ends at `hop`; two loud hops at its end are allowed.
        hop_seconds = hop / sample_rate
        first = k = min(int(start * sample_rate / hop), len(is_quiet))
        while k > 0 and (is_quiet[k - 1] or first - k < 2):
            k -= 1
        silence = k * hop_seconds
        moved = max(silence, start - longest, before_start + (0.0 if is_pause else 0.02))
        if start - moved > 0.008:
            fixed[i - 1] = (before_start, moved, before)
            fixed[i] = (moved, end, name)
    return [segment for segment in fixed if segment[1] > segment[0]]


def _to_16khz(waveform: np.ndarray, sample_rate: int) -> np.ndarray:
    """Resample and keep the peak within 1."""
    import soxr

    resampled = np.asarray(soxr.resample(waveform, sample_rate, SAMPLE_RATE), np.float32)
    return np.clip(resampled, -1.0, 1.0)


def check_ranges(**values: tuple[float, float, float]) -> None:
    """Raise ConfigError for the first (value, lowest, highest) that is out of its range."""
    for name, (value, low, high) in values.items():
        if not low <= value <= high:
            raise ConfigError(f"{name}={value} must lie between {low} and {high}")
