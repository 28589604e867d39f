"""Forced alignment: the times of known phones in a recording, and how well the sound fits them.

The chain of phones, with an optional pause before each word, is laid through the evidence by
`best_path`. Times are the sound's: given times only bound where a word may
lie. A word fits as far as the evidence for its phones comes near that for the most probable ones;
words that the sound contradicts are reported and not used.

Letters: R rows of evidence, P phones, N states.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from deitalk.pipeline.speech import Speech
from deitalk.pipeline.words.evidence import RATE, measure_phones, phone_evidence
from deitalk.pipeline.words.pronounced import Word
from deitalk.pipeline.words.transcript import Transcript
from deitalk.pipeline.words.viterbi import best_path
from deitalk.postprocess.known_phones import KnownPhone
from deitalk.postprocess.phones import PHONES, SILENCE
from rig.arrays import Float32, Int64

PRIOR_POWER = 0.6
"""Power of the phones' frequency that divides the evidence, so that rare phones are found too."""
FLOOR = -12.0
"""Least logarithm of a probability on the path: one bad row does not bend it."""
WORST = -6.0
"""Least fit of a row."""
LEAST_FIT = -1.4
"""Mean fit of a recording below which its words are not used."""
LEAST_WORD = -3.0
"""Mean fit of a word below which it is not used."""
SLACK_SECONDS = 0.1
"""Time by which a phone may lie outside its word's given times."""
_SILENCE = PHONES.index(SILENCE)


@dataclass(frozen=True)
class FittedWord:
    """A word with its times in the sound.

    Attributes
    ----------
    text : str
        As written.
    start, end : float
        Seconds.
    fit : float
        Mean over its time of the logarithm of its phones' probability over the best phones'; 0 is
        the best.
    """

    text: str
    start: float
    end: float
    fit: float

    @property
    def fits(self) -> bool:
        """Whether the sound does not contradict it."""
        return self.fit >= LEAST_WORD


@dataclass(frozen=True)
class WordFit:
    """Times of the words of a transcript in a recording.

    Attributes
    ----------
    words : tuple of FittedWord
        Empty if there is no path through the recording.
    phones : tuple of KnownPhone
        All phones with their times.
    fit : float
        Mean over the speech; 0 is the best.
    is_bounded : bool
        Whether given times bounded the words; where nothing fits within them they are not used.
    """

    words: tuple[FittedWord, ...]
    phones: tuple[KnownPhone, ...]
    fit: float
    is_bounded: bool = False

    @property
    def is_used(self) -> bool:
        """Whether the sound fits the words as a whole."""
        return self.fit >= LEAST_FIT

    @property
    def fits(self) -> bool:
        """Whether the sound contradicts no word."""
        return self.is_used and all(word.fits for word in self.words)

    @property
    def known(self) -> tuple[KnownPhone, ...]:
        """Phones that the curves shall meet: those of words that fit."""
        return tuple(phone for phone in self.phones if phone.is_known) if self.is_used else ()

    @property
    def line(self) -> str:
        """One line: how well the words fit, and which do not."""
        if not self.is_used:
            score = f"score {self.fit:.2f}, at least {LEAST_FIT:g}" if self.words else "too many"
            return f"the words do not fit the sound ({score}); they are not used"
        wrong = [word.text for word in self.words if not word.fits]
        found = f"the words fit the sound (score {self.fit:.2f})"
        if not wrong:
            return found
        named = ", ".join(wrong[:5]) + (" …" if len(wrong) > 5 else "")
        return f"{found}; {len(wrong)} of {len(self.words)} do not and are not used: {named}"


def align_words(speech: Speech, transcript: Transcript) -> WordFit:
    """Times of a transcript's phones in a recording.

    Parameters
    ----------
    speech : Speech
        The recording.
    transcript : Transcript
        Its words.
    """
    return fit_words(measure_phones(speech), transcript, phone_evidence().weights["prior"])


def fit_words(evidence: Float32, transcript: Transcript, prior: Float32) -> WordFit:
    """`align_words` on evidence.

    Parameters
    ----------
    evidence : array [shape=(R, P)]
        Logarithm of each phone's probability, `RATE` rows a second.
    transcript : Transcript
        Words.
    prior : array [shape=(P,)]
        Share of each phone in speech.
    """
    # Phone and word of each state; pauses, before each word and last, are of -1.
    chain, owned = list[int](), list[int]()
    for number, word in enumerate(transcript.words):
        chain += [_SILENCE, *(PHONES.index(phone) for phone in word.phones)]
        owned += [-1, *(number for _ in word.phones)]
    states, owners = np.array([*chain, _SILENCE], np.int64), np.array([*owned, -1], np.int64)
    optional = states == _SILENCE
    weighed = np.maximum(evidence, FLOOR) - np.float32(PRIOR_POWER) * np.log(prior)
    spans = _spans(transcript.words, owners, len(evidence))
    path, is_bounded = np.zeros(0, np.int64), False
    if spans is not None:
        path, _ = best_path(weighed, states, optional, spans)
        is_bounded = bool(len(path))
    if not len(path):
        path, _ = best_path(weighed, states, optional)
    if not len(path):
        return WordFit((), (), -np.inf)
    # Times and fits of the path.
    chosen = states[path]
    best = evidence.max(axis=1)
    fits = np.maximum(evidence[np.arange(len(path)), chosen] - best, WORST)
    speaking = (chosen != _SILENCE) | (evidence[:, _SILENCE] < best)
    owner = owners[path]
    found = []
    for number, word in enumerate(transcript.words):
        rows = np.flatnonzero(owner == number)
        times = float(rows[0]) / RATE, float(rows[-1] + 1) / RATE
        found.append(FittedWord(word.text, *times, float(fits[rows].mean())))
    edges = [0, *(np.flatnonzero(np.diff(path)) + 1).tolist(), len(path)]
    phones = tuple(
        KnownPhone(
            first / RATE,
            stop / RATE,
            PHONES[chosen[first]],
            owner[first] < 0 or found[owner[first]].fits,
        )
        for first, stop in pairwise(edges)
    )
    mean = float(fits[speaking].mean()) if speaking.any() else -np.inf
    return WordFit(tuple(found), phones, mean, is_bounded)


def _spans(words: tuple[Word, ...], owners: Int64, n_rows: int) -> Int64 | None:
    """Rows that each state may have [shape=(N, 2)]; None without given times."""
    if all(word.start is None for word in words):
        return None
    spans = np.tile(np.array([0, n_rows]), (len(owners), 1))
    for state, number in enumerate(owners.tolist()):
        word = words[number]
        if number >= 0 and word.start is not None and word.end is not None:
            first = int(np.floor((word.start - SLACK_SECONDS) * RATE))
            spans[state] = (first, int(np.ceil((word.end + SLACK_SECONDS) * RATE)) + 1)
    return spans
