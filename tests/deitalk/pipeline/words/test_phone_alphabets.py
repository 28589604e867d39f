import pytest

from deitalk.pipeline.words import alphabets
from deitalk.pipeline.words.alphabets import ipa_to_phones
from deitalk.postprocess import phones
from deitalk.postprocess.phones import PHONES
from deitalk.research.corpus.engines.flite import festival_to_phone
from deitalk.research.corpus.utterance import Phone, contiguous


def test_sets_are_phones_and_classes_do_not_overlap():
    groups = (phones.VOWELS, phones.BILABIALS, phones.LABIODENTALS, phones.STOPS)
    assert all(group <= set(PHONES) for group in groups)
    assert not phones.VOWELS & (phones.STOPS | phones.BILABIALS | phones.LABIODENTALS)
    assert len(set(PHONES)) == len(PHONES) == 44


def test_ipa_vowel_symbols_give_vowels_and_consonants_do_not():
    for symbol, target in alphabets.IPA_VOWELS.items():
        assert target.split()[0] in phones.VOWELS, symbol
    for symbol, target in alphabets.IPA_CONSONANTS.items():
        assert not set(target.split()) & phones.VOWELS, symbol


@pytest.mark.parametrize(
    ("ipa", "expected"),
    [
        ("həlˈoʊ", "HH AX L OW"),
        ("tʃˈɜːtʃ", "CH ER CH"),
        ("t͡ʃ", "CH"),
        ("dʒˈʌdʒ", "JH AH JH"),
        ("ɡˈoʊ", "G OW"),  # the IPA letter ɡ is not the keyboard's g
        ("fˈaɪɚ", "F AY ER"),
        ("bʌʔn̩", "B AH Q N"),
        ("pʰ˥", "P"),
        ("(en)", ""),
        ("", ""),
    ],
)
def test_english_words_give_their_phones(ipa, expected):
    assert ipa_to_phones(ipa) == tuple(expected.split())


@pytest.mark.parametrize(
    ("language", "ipa", "expected"),
    [
        ("de", "ʃøːn", "SH UH N"),
        ("fr", "bɔ̃", "B AO"),
        ("fr", "lyn", "L UW N"),
        ("es", "pero", "P EH DX AO"),
        ("hi", "cʰ", "CH"),
        ("cmn", "ts.h", "CH"),
        ("cmn", "iou", "Y OW"),
        ("cmn", "ˈonɡ", "UH NG"),
        ("cmn", "ˌuo", "W AO"),
        ("ja", "ɯᵝ", "UH"),
    ],
)
def test_other_languages_keep_lips_and_jaw(language, ipa, expected):
    assert ipa_to_phones(ipa, language) == tuple(expected.split())


def test_festival_names_give_phones():
    assert [festival_to_phone(n) for n in ("pau", "ax", "axr", "el", "hh")] == [
        "SIL", "AX", "ER", "L", "HH",
    ]  # fmt: skip
    assert festival_to_phone("no such phone") == "AX"


def test_contiguous_fills_gaps_cuts_overlaps_and_joins_silences():
    rough = [
        (0.1, 0.3, "P"),
        (0.25, 0.4, "AA"),
        (0.4, 0.5, "SIL"),
        (0.6, 0.6, "T"),
        (0.7, 2, "SIL"),
    ]
    assert contiguous(rough, 1.0) == (
        Phone(0.0, 0.1, "SIL"),
        Phone(0.1, 0.25, "P"),
        Phone(0.25, 0.4, "AA"),
        Phone(0.4, 1.0, "SIL"),
    )
