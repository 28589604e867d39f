"""Stressed syllables of known words in a recording: espeak-ng's stress, times by alignment."""

from collections.abc import Sequence

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.words.align import WordFit, align_words
from deitalk.pipeline.words.alphabets import spoken_words
from deitalk.pipeline.words.pronounced import Word
from deitalk.pipeline.words.transcript import Transcript
from deitalk.postprocess.phones import VOWELS
from deitalk.research.corpus.engines import espeak
from rig.arrays import Float64

SPREAD_SECONDS = 0.07
"""Standard deviation of a syllable in the track."""
TimedWord = tuple[float, float, str]


def stress_track(speech: Speech, words: Sequence[TimedWord]) -> Float64:
    """1 at the middle of each stressed vowel, with a Gaussian around it [shape=(T,)].

    Parameters
    ----------
    speech : Speech
        English.
    words : sequence of (start, end, word)
        Seconds.
    """
    text = " ".join(word for *_, word in words)
    spoken = espeak.pronounce(text).split()
    if len(spoken) != len(words):  # small words were joined
        spoken = [espeak.pronounce(word) for *_, word in words]
    phones = [tuple(p for group in spoken_words(ipa) for p in group) for ipa in spoken]
    timed = zip(words, phones, strict=True)
    said = Transcript(tuple(Word(w, p, start, end) for (start, end, w), p in timed), text)
    times = stressed_times(align_words(speech, said), [stressed_vowel(ipa) for ipa in spoken])
    frames = np.arange(speech.n_frames)[:, None] / FRAME_RATE
    track: Float64 = np.exp(-0.5 * ((frames - times) / SPREAD_SECONDS) ** 2).sum(axis=1)
    return track


def stressed_times(fit: WordFit, places: Sequence[int | None]) -> Float64:
    """Middle of the stressed vowel of each word that has one [shape=(K,), seconds].

    Parameters
    ----------
    fit : WordFit
        Aligned words.
    places : sequence of int or None
        Of each word, the place of its stressed vowel among its vowels.
    """
    middles = np.array([(p.start + p.end) / 2 for p in fit.phones if p.name in VOWELS])
    times = []
    for word, place in zip(fit.words, places, strict=False):
        within = middles[(middles >= word.start) & (middles < word.end)]
        if place is not None and place < len(within):
            times.append(within[place])
    return np.array(times)


def stressed_vowel(ipa: str, language: str = "en") -> int | None:
    """Place, among the vowels of a word, of the one with primary stress; None without one.

    >>> stressed_vowel("ɐɡˈɛn")
    1
    """
    before, mark, _ = ipa.partition("ˈ")
    if not mark:
        return None
    phones = spoken_words(before, language)
    return sum(phone in VOWELS for phone in (phones[-1] if phones else ()))
