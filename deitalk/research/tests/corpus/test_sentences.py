import itertools
import re

import numpy as np
import pytest

from deitalk.postprocess.phones import BILABIALS, LABIODENTALS, PHONES, VOWELS
from deitalk.research.corpus import alignment, sentences
from deitalk.research.corpus.engines import espeak
from deitalk.research.corpus.sentences import english_sentence, foreign_sentence
from deitalk.research.corpus.synthesis import FOREIGN_VOICES, held_ssml


def _texts(count):
    rng = np.random.default_rng(1)
    return [english_sentence(rng) for _ in range(count)]


def test_same_seed_gives_the_same_sentences():
    assert _texts(50) == _texts(50)


def test_words_are_common_words_without_repeats():
    words = sentences.words()
    assert len(words) > 1500
    assert len(set(words)) == len(words)
    assert all(re.fullmatch("[a-z]+", word) for word in words)


def test_every_kind_of_sentence_occurs():
    drawn = _texts(500)
    text = "\n".join(s.text for s in drawn)
    assert all(mark in text for mark in (", ", "...", "! ", "?\n", ".\n"))
    assert re.search(r"\d{3}", text)
    assert any(s.held for s in drawn)
    assert all(s.held in s.text.lower() for s in drawn)
    assert all(s.text[0].isupper() and s.text[-1] in ".!?" for s in drawn)


def test_held_word_is_slowed_and_text_is_escaped():
    sentence = sentences.Sentence("Tom & Kate, no, wait!", held="no")
    assert held_ssml(sentence) == (
        '<speak>Tom &amp; Kate, <prosody rate="35%">no</prosody>, wait!</speak>'
    )


def test_foreign_sentences_belong_to_their_language():
    rng = np.random.default_rng(0)
    for language, known in sentences.FOREIGN.items():
        assert foreign_sentence(language, rng).text in known


@pytest.mark.parametrize("language", list(sentences.FOREIGN))
def test_no_sentence_is_read_as_english(language):
    """espeak-ng marks what it reads in another language, such as Mandarin with tone marks."""
    if (reason := espeak.missing()) is not None:
        pytest.skip(reason)
    for voice in FOREIGN_VOICES[language]:
        for text in sentences.FOREIGN[language]:
            assert "(en)" not in espeak.pronounce(text, voice=voice), text


def test_phones_and_diphone_classes_are_covered():
    """Every phone of the dictionary, and every possible neighbour of a lip closure."""
    pytest.importorskip("pocketsphinx", reason="the dictionary comes with pocketsphinx")
    decoder = alignment._decoder(0)
    pronunciations = {}
    pairs, seen = set(), set()
    for sentence in _texts(3000):
        spoken = []
        for word in alignment.text_words(sentence.text):
            if word not in pronunciations:
                pronunciations[word] = (decoder.lookup_word(word) or "").split()
            spoken += pronunciations[word]
        seen |= set(spoken)
        pairs |= set(itertools.pairwise(spoken))
    assert seen == set(PHONES) - {"SIL", "Q", "IX", "AX", "DX"}
    lips = BILABIALS | LABIODENTALS
    vowels = VOWELS & seen
    reached = {(a, b) for a, b in pairs if a in lips and b in vowels}
    assert len(reached) > 0.9 * len(lips) * len(vowels)
    left = {(a, b) for a, b in pairs if a in vowels and b in lips}
    assert len(left) > 0.9 * len(lips) * len(vowels)
    spoken_lips = sum(p in lips for word in pronunciations.values() for p in word)
    assert spoken_lips > 0.12 * sum(map(len, pronunciations.values()))
