"""Other phone alphabets to ARPABET: IPA, festival's names and Mandarin.

Phones are chosen by their articulation, so the tables map a foreign sound to the English phone
with the nearest lips and jaw, then the nearest tongue: the front rounded vowels become rounded
ones, a tapped r becomes DX (whose lips are free) and not R (whose lips protrude).
"""

import re
import unicodedata
from functools import lru_cache

from deitalk.phones import PHONES, VOWELS

# Symbol(s) of the International Phonetic Alphabet -> phones. Length marks are looked up first and
# then dropped; stress, tone, nasality and secondary articulation are dropped (see _PLAIN).
IPA_CONSONANTS = {
    "p": "P", "b": "B", "m": "M", "β": "B", "ʙ": "B", "ɓ": "B",
    "f": "F", "v": "V", "ɸ": "F", "ɱ": "V", "ʋ": "V", "ⱱ": "V",
    "θ": "TH", "ð": "DH",
    "t": "T", "d": "D", "n": "N", "l": "L", "ɫ": "L", "ɾ": "DX", "ɬ": "L", "ɮ": "L", "ɗ": "D",
    "ʈ": "T", "ɖ": "D", "ɳ": "N", "ɭ": "L", "ɽ": "DX", "ɺ": "DX",
    "s": "S", "z": "Z", "ʃ": "SH", "ʒ": "ZH", "ʂ": "SH", "ʐ": "ZH", "ɕ": "SH", "ʑ": "ZH",
    "tʃ": "CH", "dʒ": "JH", "tɕ": "CH", "dʑ": "JH", "tʂ": "CH", "dʐ": "JH", "ʈʂ": "CH",
    "ɖʐ": "JH", "ts": "T S", "dz": "D Z", "pf": "P F", "ɧ": "SH",
    "k": "K", "g": "G", "ŋ": "NG", "ɴ": "NG", "q": "K", "ɢ": "G", "x": "K", "ɣ": "G", "χ": "K",
    "ʁ": "G", "ʀ": "G", "ɰ": "G", "c": "CH", "ɟ": "JH", "ɠ": "G", "ç": "HH", "ʝ": "Y",
    "ɲ": "N", "ʎ": "L", "j": "Y", "h": "HH", "ɦ": "HH", "ħ": "HH", "ʕ": "Q", "ʔ": "Q",
    "ɹ": "R", "ɻ": "R", "r": "R", "w": "W", "ʍ": "W", "ɥ": "W",
}  # fmt: skip
IPA_VOWELS = {
    "i": "IY", "ɪ": "IH", "e": "EY", "ɛ": "EH", "æ": "AE", "a": "AE", "aː": "AA", "ɑ": "AA",
    "ɒ": "AO", "ɔ": "AO", "o": "OW", "ʊ": "UH", "u": "UW", "ʌ": "AH", "ə": "AX", "əː": "ER",
    "ɐ": "AX", "ᵻ": "IX", "ɨ": "IX", "ᵿ": "UH", "ɜ": "AX", "ɜː": "ER", "ɚ": "ER", "ɝ": "ER",
    "ɞ": "ER", "ɘ": "AX", "ɤ": "AH", "ɯ": "IX", "ɯᵝ": "UH", "ɶ": "AE",
    "y": "UW", "ʏ": "UH", "ʉ": "UW", "ø": "UH", "œ": "ER", "ɵ": "UH",
    "eɪ": "EY", "ei": "EY", "ɛɪ": "EY", "æɪ": "EY", "aɪ": "AY", "ai": "AY", "ɑɪ": "AY", "ʌɪ": "AY",
    "ɐɪ": "AY", "aʊ": "AW", "au": "AW", "ɑu": "AW", "æʊ": "AW", "ɑʊ": "AW", "ɛʊ": "AW",
    "oʊ": "OW", "əʊ": "OW", "ou": "OW", "ʌʊ": "OW", "əʉ": "OW", "ɔɪ": "OY", "oɪ": "OY", "ɔø": "OY",
    "ɔʏ": "OY", "ɪə": "IH AX", "iə": "IY AX", "eə": "EH AX", "ɛə": "EH AX", "ʊə": "UH AX",
    "aɪə": "AY AX", "aʊə": "AW AX", "aɪɚ": "AY ER", "aʊɚ": "AW ER", "əl": "AX L",
    "aa": "AE",
    "oːɹ": "AO R", "ɪɹ": "IH R", "ɛɹ": "EH R", "ʊɹ": "UH R", "ɔːɹ": "AO R", "ɑːɹ": "AA R",
}  # fmt: skip
# Outside English e and o do not glide, `a` is open and central, and `r` is a tap or a trill.
IPA_NOT_ENGLISH = {
    "e": "EH", "eː": "EY", "o": "AO", "oː": "OW", "a": "AA", "ɐ": "AH", "r": "DX", "rr": "DX",
}  # fmt: skip
# espeak-ng's own names for Mandarin, where h after a stop is aspiration and a dot is retroflexion.
MANDARIN = {
    "ph": "P", "th": "T", "kh": "K", "ts": "T S", "tsh": "T S", "tɕh": "CH", "ts.": "CH",
    "ts.h": "CH", "s.": "SH", "i.": "IX", "o-": "AH", "ər": "ER", "iɛ": "Y EH", "iɑ": "Y AA",
    "iɑu": "Y AW", "iou": "Y OW", "uɑ": "W AA", "ua": "W AA", "uai": "W AY", "uei": "W EY",
    "uə": "W AX", "uo": "W AO", "yɛ": "W EH", "y": "UW", "onɡ": "UH NG",
}  # fmt: skip

# Names of the festival and flite American phone sets that differ from ours by more than case.
FESTIVAL_NAMES = {
    "pau": "SIL", "h#": "SIL", "#": "SIL", "brth": "SIL", "sil": "SIL", "ssil": "SIL",
    "axr": "ER", "hv": "HH", "em": "M", "en": "N", "el": "L", "nx": "N", "eng": "NG", "q": "Q",
}  # fmt: skip

_STRESS = "ˈˌ"  # espeak-ng writes it into its phone events from 1.52 on
_PLAIN = str.maketrans("", "", "ˈˌˑ˞ʰʲʷˠˤʼ̚˥˦˧˨˩0123456789.|‖_ -'\u200d\u0361\u035c\u0348")


@lru_cache(maxsize=4096)
def ipa_to_phones(ipa: str, language: str = "en") -> tuple[str, ...]:
    """Phones of a string in the International Phonetic Alphabet.

    Longest symbols first. Stress, tones, length, nasality and other diacritics are ignored, and
    so are unknown symbols, and names in parentheses, with which espeak-ng marks a change of the
    language.

    Parameters
    ----------
    ipa : str
        One phone or many, with or without word boundaries.
    language : str
        Language code; determines the phones of `a`, `e`, `o` and `r`, and the names of Mandarin.

    Returns
    -------
    phones : tuple of str
        Members of `PHONES`; empty if nothing in `ipa` is a phone.
    """
    if language == "cmn" and ipa.lstrip(_STRESS) in MANDARIN:
        return tuple(MANDARIN[ipa.lstrip(_STRESS)].split())
    if ipa.startswith("("):
        return ()
    table = _table(language == "en")
    # `ipa` without diacritics and marks; length, ç and ᵻ stay.
    composed = unicodedata.normalize("NFC", ipa).replace("ɡ", "g").replace("ç", "\0")
    composed = composed.replace(":", "ː")
    bare = "".join(
        c for c in unicodedata.normalize("NFD", composed) if not unicodedata.combining(c)
    )
    left, found = bare.replace("\0", "ç").translate(_PLAIN), []
    while left:
        size = next((n for n in (3, 2, 1) if left[:n] in table), 0)
        found += table[left[:size]].split() if size else []
        left = left[size or 1 :]
    return tuple(found)


def spoken_words(ipa: str, language: str = "en") -> list[tuple[str, ...]]:
    """Phones of each word of a pronunciation by espeak-ng; words without phones are left out.

    Parameters
    ----------
    ipa : str
        Words with spaces between them; marks of a change of the language, such as ``(en)``, and
        the tones of Mandarin have no phones.
    language : str
        Voice of espeak-ng, whose first part is the language code.
    """
    code = language.split("-")[0]
    plain = re.sub(r"\([a-z-]+\)", "", ipa)
    if code in ("cmn", "zh"):
        found = [_syllable(word) for word in plain.split()]
    else:
        found = [ipa_to_phones(word, code) for word in plain.split()]
    return [phones for phones in found if phones]


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


def _syllable(name: str) -> tuple[str, ...]:
    """Phones of a Mandarin syllable in espeak-ng's names, such as ``tsɑu2`` or ``thˈiɛ5n``."""
    left = re.sub(rf"[{_STRESS}0-9ɜ]", "", name)  # ɜ is a tone here
    phones: list[str] = []
    while left:
        size = next((n for n in (4, 3, 2, 1) if left[:n] in MANDARIN), 0)
        known = MANDARIN[left[:size]].split() if size else None
        if known is None:
            size = next((n for n in (2, 1) if left[:n] in _table(False)), 1)
            known = list(ipa_to_phones(left[:size], "cmn"))
        phones += known[1:] if phones[-1:] == known[:1] else known
        left = left[size:]
    return tuple(phones)


def festival_to_phone(name: str) -> str:
    """Phone of a festival or flite name; unknown names become AX."""
    phone = FESTIVAL_NAMES.get(name.lower(), name.upper())
    return phone if phone in PHONES else "AX"


@lru_cache(maxsize=2)
def _table(is_english: bool) -> dict[str, str]:
    """All symbols in one table."""
    return {**IPA_CONSONANTS, **IPA_VOWELS, **({} if is_english else IPA_NOT_ENGLISH)}
