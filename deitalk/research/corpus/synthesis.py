"""Labelled speech from each engine: random voices, accents, styles and rates from a seed."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from xml.sax.saxutils import escape

import numpy as np

from deitalk.errors import ConfigError, DataError, MissingError
from deitalk.research.corpus.engines import ENGINES, available_engines, espeak, festival, flite
from deitalk.research.corpus.sentences import FOREIGN, Sentence, english_sentence, foreign_sentence
from deitalk.research.corpus.utterance import Utterance


@dataclass(frozen=True)
class Prosody:
    """Factors on an engine's own rate, pitch, pitch range and loudness."""

    rate: float
    pitch: float
    pitch_range: float
    volume: float


STYLE = {
    "neutral": Prosody(1.00, 1.00, 1.0, 1.00),
    "angry": Prosody(1.12, 1.08, 1.35, 1.25),
    "happy": Prosody(1.08, 1.18, 1.5, 1.05),
    "sad": Prosody(0.82, 0.90, 0.5, 0.80),
    "surprised": Prosody(1.05, 1.30, 1.8, 1.05),
}
"""Prosody of the five emotions: activation raises rate, pitch, range and loudness, sadness lowers
them (directions from Scherer 2003, table 2; sizes are ours)."""

ENGLISH_ACCENTS = (
    "en-us", "en-us", "gmw/en", "en-gb-x-rp", "en-gb-scotland", "en-029", "en-gb-x-gbclan",
    "en-gb-x-gbcwmd", "en-us-nyc",
)  # fmt: skip
FOREIGN_VOICES = {
    "es": ("es", "es-419"), "de": ("de",), "fr": ("fr", "fr-be", "fr-ch"), "it": ("it",),
    "pt": ("pt", "pt-br"), "cmn": ("cmn-latn-pinyin",), "hi": ("hi",), "ja": ("ja",), "ko": ("ko",),
}  # fmt: skip
FOREIGN_SHARE = 0.2
WHISPER_SHARE = 0.02
PLAIN_VOICE_SHARE = 0.08
UNNATURAL = (
    "robosoft", "unirobot", "anikarobot", "whisper", "demonic", "croak", "fast", "grandma",
    "grandpa",
)  # fmt: skip
"""Prefixes of the names of variants that do not resemble human voices."""
HELD_RATE_PERCENT = 35  # speaking rate of a lengthened word
FESTIVAL_BATCH = 25
MOST_FAILURES = 50


def synthetic_utterances(
    engine: str, seconds: float, rng: np.random.Generator
) -> Iterator[Utterance]:
    """Speech of one engine until `seconds` are reached.

    The same generator state and engine version give the same utterances to the bit. Waveforms
    have the engine's own level and digital silence; augmentation is done in training.

    Parameters
    ----------
    engine : str
        ``espeak``, ``flite`` or ``festival``.
    seconds : float
        Amount of speech, greater than 0; the last utterance may exceed it.
    rng : Generator
        Source of all choices.

    Yields
    ------
    Utterance

    Raises
    ------
    ConfigError
        If the engine is unknown or `seconds` is not positive.
    MissingError
        If the engine is not installed.
    DataError
        If the engine fails repeatedly.
    """
    if engine not in ENGINES:
        raise ConfigError(f"engine={engine!r} must be one of {', '.join(ENGINES)}")
    if not seconds > 0:
        raise ConfigError(f"seconds={seconds} must be greater than 0")
    if reason := available_engines()[engine]:
        raise MissingError(reason)
    return _until(seconds, _BATCHES[engine], engine, rng)


def _until(
    seconds: float,
    batch: Callable[[np.random.Generator], list[Utterance | None]],
    engine: str,
    rng: np.random.Generator,
) -> Iterator[Utterance]:
    """Utterances of batch after batch until their durations reach `seconds`."""
    failures = 0
    while seconds > 0:
        for utterance in batch(rng):
            if seconds <= 0:
                return
            if utterance is None:
                failures += 1
                continue
            failures = 0
            seconds -= utterance.duration_seconds
            yield utterance
        if failures > MOST_FAILURES:
            raise DataError(f"{engine} failed {failures} times in a row; run it on a command line")


def _style(rng: np.random.Generator) -> str:
    return list(STYLE)[rng.integers(len(STYLE))]


def _choice(rng: np.random.Generator, options: tuple[str, ...]) -> str:
    return options[rng.integers(len(options))]


def _espeak_batch(rng: np.random.Generator) -> list[Utterance | None]:
    """One utterance of a random voice, mostly English."""
    languages = _languages()
    language = "en"
    if languages and rng.random() < FOREIGN_SHARE:
        language = _choice(rng, languages)
    sentence = english_sentence(rng) if language == "en" else foreign_sentence(language, rng)
    style = _style(rng)
    prosody = STYLE.get(style, STYLE["neutral"])
    try:
        utterance = espeak.synthesise(
            held_ssml(sentence) if sentence.held else sentence.text,
            ssml=bool(sentence.held),
            voice=_choice(rng, _voices(language)),
            variant=_variant(rng),
            language=language,
            style=style,
            rate=float(np.clip(rng.uniform(120, 200) * prosody.rate, 80, 450)),
            pitch=float(np.clip(rng.uniform(30, 70) * prosody.pitch, 0, 99)),
            pitch_range=float(np.clip(rng.uniform(35, 65) * prosody.pitch_range, 0, 99)),
            volume=70 * prosody.volume,  # leaves room for the loudest style
        )
    except DataError:
        return [None]
    return [replace(utterance, text=sentence.text)]


def held_ssml(sentence: Sentence) -> str:
    """SSML with a slow rate for the held word."""
    slow = f'<prosody rate="{HELD_RATE_PERCENT}%">{escape(sentence.held)}</prosody>'
    before, word, after = sentence.text.partition(sentence.held)
    return f"<speak>{escape(before)}{slow if word else ''}{escape(after)}</speak>"


@cache
def _languages() -> tuple[str, ...]:
    """Other languages that have sentences and an installed voice."""
    return tuple(language for language in FOREIGN if _voices(language))


@cache
def _voices(language: str) -> tuple[str, ...]:
    """Installed voices of a language."""
    known = ENGLISH_ACCENTS if language == "en" else FOREIGN_VOICES[language]
    return tuple(voice for voice in known if espeak.has_voice(voice))


@cache
def _variants() -> tuple[str, ...]:
    """Variants that resemble human voices."""
    return tuple(v for v in espeak.variants() if not v.lower().startswith(UNNATURAL))


def _variant(rng: np.random.Generator) -> str | None:
    """A random variant, rarely none, rarely a whisper."""
    whispers = tuple(v for v in espeak.variants() if v.startswith("whisper"))
    chance = rng.random()
    if chance < WHISPER_SHARE and whispers:
        return _choice(rng, whispers)
    if chance < WHISPER_SHARE + PLAIN_VOICE_SHARE or not _variants():
        return None
    return _choice(rng, _variants())


def _flite_batch(rng: np.random.Generator) -> list[Utterance | None]:
    """One utterance of a random flite voice."""
    style = _style(rng)
    prosody = STYLE.get(style, STYLE["neutral"])
    voice = _choice(rng, ("slt", "slt", "rms", "rms", "awb", "awb", "kal16"))
    try:
        utterance = flite.synthesise(
            english_sentence(rng).text,
            voice=voice,
            stretch=float(rng.uniform(0.8, 1.25) / prosody.rate),
            f0_mean=float(flite.VOICES[voice] * rng.uniform(0.85, 1.2) * prosody.pitch),
            f0_stddev=float(15 * prosody.pitch_range * rng.uniform(0.8, 1.5)),
            style=style,
        )
    except DataError:
        return [None]
    return [utterance]


def _festival_batch(rng: np.random.Generator) -> list[Utterance | None]:
    """`FESTIVAL_BATCH` utterances of random festival voices."""
    return festival.synthesise_batch([_festival_job(rng) for _ in range(FESTIVAL_BATCH)])


def _festival_job(rng: np.random.Generator) -> festival.Job:
    installed = festival.voices()
    style = _style(rng)
    prosody = STYLE.get(style, STYLE["neutral"])
    return festival.Job(
        text=english_sentence(rng).text.replace("!", "."),  # festival gives both the same prosody
        voice=_choice(rng, installed + tuple(v for v in installed if v == "slt")),
        stretch=float(rng.uniform(0.8, 1.25) / prosody.rate),
        f0_mean=float(105 * rng.uniform(0.9, 1.15) * prosody.pitch),
        f0_stddev=float(14 * prosody.pitch_range),
        style=style,
    )


_BATCHES = {"espeak": _espeak_batch, "flite": _flite_batch, "festival": _festival_batch}
