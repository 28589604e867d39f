"""Forced alignment: the times of a transcript's phones in a recording.

pocketsphinx with its bundled American English model finds the times on a 10 ms grid. Words that
its dictionary lacks (names, numbers, misspellings) are pronounced by espeak-ng, or letter by
letter where espeak-ng is absent, so that a recording is dropped only when its sound does not fit
its words. The dictionary has no stress; espeak-ng gives which of its AH and IH are reduced
(AX, IX), because a reduced vowel hardly opens the mouth.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from deitalk.errors import MissingError
from deitalk.pipeline.words.alphabets import ipa_to_phones
from deitalk.postprocess.phones import VOWELS
from deitalk.research.corpus.engines import espeak
from deitalk.research.corpus.utterance import SAMPLE_RATE, Phone, contiguous

VERSION = 2
"""Part of the cache key: raise it when the alignment itself changes."""
FRAME_SECONDS = 0.01
BOUNDARY_SECONDS = 0.0078
"""Added to every boundary: the model's frame k covers 10k to 10k + 25.6 ms, so the middle between
the centres of frames k - 1 and k lies 7.8 ms after 10k. Against espeak-ng's exact times the median
error falls from -9.6 to -1.8 ms."""
LONGEST_RUN_OF_SHORTEST = 7
"""Phones in a row at the 30 ms minimum that still pass: more mean that words were squeezed in."""
MOST_SHORTEST = 0.30
"""Share of phones at the 30 ms minimum that still passes. More have 1 of 573 aligned recordings of
LibriSpeech and 27 of 660 of second-language adults."""
LOWEST_SCORE = -38.0
"""Mean acoustic score per frame, against the frame's best state, that still passes. Readers with
their own transcripts score -26 and better, second-language children -34 (19 of 20); recordings with
another recording's transcript of the same length stay below -35 (19 of 20, half below -50)."""
BEAMS: tuple[dict[str, float], ...] = (
    {},
    {"beam": 1e-80, "wbeam": 1e-60, "pbeam": 1e-80},
    {"beam": 1e-160, "wbeam": 1e-120, "pbeam": 1e-160},
)
"""Search widths tried in turn until one reaches the end of the recording."""

# The model gives breath and noise their own names; the face does not move for them.
_FILLERS = frozenset(("SIL", "+NSN+", "+SPN+"))
_LETTERS = {
    "tch": "CH", "dge": "JH", "igh": "AY", "eigh": "EY", "ough": "AO", "tion": "SH AH N",
    "sion": "ZH AH N", "ch": "CH", "sh": "SH", "th": "TH", "ph": "F", "wh": "W", "ck": "K",
    "ng": "NG", "qu": "K W", "gh": "", "kn": "N", "wr": "R", "ee": "IY", "ea": "IY", "oo": "UW",
    "ou": "AW", "ow": "OW", "oi": "OY", "oy": "OY", "ai": "EY", "ay": "EY", "au": "AO", "aw": "AO",
    "ew": "UW", "ie": "IY", "ar": "AA R", "er": "ER", "ir": "ER", "ur": "ER", "or": "AO R",
    "a": "AE", "b": "B", "c": "K", "d": "D", "e": "EH", "f": "F", "g": "G", "h": "HH", "i": "IH",
    "j": "JH", "k": "K", "l": "L", "m": "M", "n": "N", "o": "AA", "p": "P", "q": "K", "r": "R",
    "s": "S", "t": "T", "u": "AH", "v": "V", "w": "W", "x": "K S", "y": "IY", "z": "Z",
    "0": "Z IH R OW", "1": "W AH N", "2": "T UW", "3": "TH R IY", "4": "F AO R", "5": "F AY V",
    "6": "S IH K S", "7": "S EH V AH N", "8": "EY T", "9": "N AY N",
}  # fmt: skip
_DICTIONARY_NAMES = {"AX": "AH", "IX": "IH", "DX": "T", "Q": "", "SIL": ""}


@dataclass(frozen=True)
class Alignment:
    """Phones of a recording, or the reason that there are none.

    Attributes
    ----------
    phones : tuple of Phone
        Empty if nothing was found.
    score : float
        Mean acoustic score per speech frame; 0 is the best possible.
    reason : str or None
        Reason that the alignment must not be used; None if it is good.
    """

    phones: tuple[Phone, ...]
    score: float
    reason: str | None


def missing() -> str | None:
    """Return None if recordings can be aligned here, else the reason and the package to install."""
    try:
        import pocketsphinx  # noqa: F401
    except ImportError:
        return "alignment needs pocketsphinx; pip install 'deitalk[align]'"
    return None


def align(waveform: np.ndarray, text: str) -> tuple[Phone, ...] | None:
    """Times of the phones of `text` in `waveform`.

    Parameters
    ----------
    waveform : float array [shape=(S,), 16 kHz, range -1 to 1]
        English speech.
    text : str
        Transcript: words, numbers, punctuation.

    Returns
    -------
    phones : tuple of Phone, or None
        Contiguous, covering the waveform; None if the sound does not fit the words
        (`align_scored` gives the reason).

    Raises
    ------
    MissingError
        If pocketsphinx is not installed.
    """
    found = align_scored(waveform, text)
    return None if found.reason else found.phones


def align_scored(waveform: np.ndarray, text: str) -> Alignment:
    """`align` with its score and, for a bad alignment, the reason."""
    if reason := missing():
        raise MissingError(reason)
    words = text_words(text)
    if not words:
        return Alignment((), -np.inf, "the transcript has no words")
    if len(waveform) < SAMPLE_RATE // 10:
        return Alignment((), -np.inf, "the recording is shorter than 0.1 s")
    pcm = (np.clip(waveform, -1, 1) * 32767).astype(np.int16).tobytes()
    for width in range(len(BEAMS)):
        segments = _search(_decoder(width), pcm, words)
        if segments:
            # The alignment with its score, and the reason if it is bad.
            duration = len(waveform) / SAMPLE_RATE
            speech = [(end - start, score) for start, end, name, score in segments if name != "SIL"]
            frames = sum(seconds for seconds, _ in speech) / FRAME_SECONDS
            score = sum(points for _, points in speech) / max(frames, 1.0)
            phones = contiguous(((start, end, name) for start, end, name, _ in segments), duration)
            return Alignment(phones, score, reason_against(phones, score))
    return Alignment((), -np.inf, "no path through the recording fits the words")


def text_words(text: str) -> list[str]:
    """Lower-case words of `text`; figures stay figures, apostrophes inside words stay.

    >>> text_words("Don't -- it's 25, O'Neill!")
    ["don't", "it's", '25', "o'neill"]
    """
    plain = text.lower().replace("’", "'").replace("‘", "'").replace("&", " and ")
    words = re.findall(r"[^\W_]+(?:['.,][^\W_]+)*", plain)
    return [part for word in words for part in _parted(word)]


def _parted(word: str) -> list[str]:
    """Keep 3.5 and 1,000 whole; part words that punctuation without a space glued together."""
    if re.fullmatch(r"[\d.,]+", word):
        return [word.replace(",", "")]
    return [part for part in re.split(r"[.,]", word) if part]


@cache
def _decoder(width: int) -> Any:
    """The pocketsphinx decoder with the search width `BEAMS[width]`."""
    from pocketsphinx import Decoder

    # The best path of the lattice may give a phone fewer frames than it has states, which ends the
    # second search: the Viterbi path serves.
    return Decoder(lm=None, loglevel="FATAL", bestpath=False, **BEAMS[width])


def _search(decoder: Any, pcm: bytes, words: list[str]) -> list[tuple[float, float, str, int]]:
    """(start, end, phone, score) of every segment; nothing if the search fails."""
    for word in words:
        if decoder.lookup_word(word) is None:
            decoder.add_word(word, " ".join(pronunciation(word)), True)
    try:
        decoder.set_align_text(" ".join(words))
        _decode(decoder, pcm)
        decoder.set_alignment()
        _decode(decoder, pcm)
        alignment = decoder.get_alignment()
    except RuntimeError:
        return []
    return [segment for word in alignment or () for segment in _word_segments(word)]


def _decode(decoder: Any, pcm: bytes) -> None:
    """Run the whole recording through the decoder, independent of earlier recordings."""
    decoder.reinit_feat()  # resets the noise tracker
    decoder.start_utt()
    try:
        decoder.process_raw(pcm, full_utt=True)
    finally:
        decoder.end_utt()


def _word_segments(word: Any) -> list[tuple[float, float, str, int]]:
    """Segments of one aligned word, its reduced vowels named."""
    phones = list(word)
    names = ["SIL" if p.name in _FILLERS else p.name for p in phones]
    names = reduced(re.sub(r"\(\d+\)$", "", word.name), names)
    return [
        (_boundary(p.start), _boundary(p.start + p.duration), name, p.score)
        for p, name in zip(phones, names, strict=True)
    ]


def _boundary(frame: int) -> float:
    """Seconds of the boundary between a frame and the one before it."""
    return frame * FRAME_SECONDS + (BOUNDARY_SECONDS if frame else 0.0)


def reason_against(phones: Sequence[Phone], score: float) -> str | None:
    """Reason that an alignment must not be used; None if it is good.

    Parameters
    ----------
    phones : sequence of Phone
        The alignment.
    score : float
        Mean acoustic score per speech frame.

    Returns
    -------
    reason : str or None
    """
    is_shortest = [p.end - p.start < 0.035 for p in phones if p.name != "SIL"]
    if not is_shortest:
        return "no speech was found"
    if (share := sum(is_shortest) / len(is_shortest)) > MOST_SHORTEST:
        return f"{share:.0%} of the phones last the minimum of 30 ms: words are missing or extra"
    longest = max(map(len, "".join("x" if s else " " for s in is_shortest).split()), default=0)
    if longest > LONGEST_RUN_OF_SHORTEST:
        return f"{longest} phones in a row last the minimum of 30 ms: words are missing or extra"
    if score < LOWEST_SCORE:
        return f"score {score:.1f} is below {LOWEST_SCORE}: the sound does not fit the words"
    return None


@cache
def pronunciation(word: str) -> tuple[str, ...]:
    """Dictionary phones (39, no reduced vowels) of a word outside the dictionary."""
    phones = _spoken(word) if espeak.missing() is None else _spelled(word)
    named = [_DICTIONARY_NAMES.get(phone, phone) for phone in phones]
    return tuple(name for name in named if name) or ("AH",)


def _spoken(word: str) -> tuple[str, ...]:
    """espeak-ng's phones of a word."""
    return ipa_to_phones(espeak.pronounce(word))


def _spelled(word: str) -> tuple[str, ...]:
    """Phones letter by letter, longest groups first."""
    phones: list[str] = []
    while word:
        size = next((n for n in (4, 3, 2, 1) if word[:n] in _LETTERS), 0)
        phones += _LETTERS[word[:size]].split() if size else []
        word = word[size or 1 :]
    return tuple(phones)


def reduced(word: str, names: list[str]) -> list[str]:
    """Name AX and IX among a word's AH and IH, where espeak-ng reduces the same vowel.

    Parameters
    ----------
    word : str
        Lower case, as in the transcript.
    names : list of str
        Dictionary phones.

    Returns
    -------
    names : list of str
        Unchanged where espeak-ng is absent or counts other vowels in the word.
    """
    if not {"AH", "IH"} & set(names) or espeak.missing() is not None:
        return names
    spoken = [p for p in _cached_spoken(word) if p in VOWELS]
    places = [i for i, name in enumerate(names) if name in VOWELS]
    if len(spoken) != len(places):
        return names
    named = list(names)
    for i, vowel in zip(places, spoken, strict=True):
        if (named[i], vowel) in (("AH", "AX"), ("AH", "IX"), ("IH", "IX")):
            named[i] = vowel
    return named


@cache
def _cached_spoken(word: str) -> tuple[str, ...]:
    return _spoken(word)
