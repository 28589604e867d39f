"""Other phone alphabets to ARPABET: IPA and Mandarin.

Phones are chosen by their articulation, so the tables map a foreign sound to the English phone
with the nearest lips and jaw, then the nearest tongue: the front rounded vowels become rounded
ones, a tapped r becomes DX (whose lips are free) and not R (whose lips protrude).

``ipa.csv``: symbol(s) of the International Phonetic Alphabet -> phones. Length marks are looked
up first and then dropped; stress, tone, nasality and secondary articulation are dropped (see
_PLAIN). Outside English e and o do not glide, `a` is open and central, and `r` is a tap or a
trill (not_english). Of Mandarin, espeak-ng's own names, where h after a stop is aspiration and a
dot is retroflexion.
"""

import re
import unicodedata
from functools import lru_cache
from pathlib import Path

from rig.files.reading import rows_of


def _alphabet(name: str) -> dict[str, str]:
    """A set of the table."""
    rows = rows_of(Path(__file__).with_name("ipa.csv"))
    return {row["ipa"]: row["phones"] for row in rows if row["set"] == name}


IPA_CONSONANTS, IPA_VOWELS = _alphabet("consonant"), _alphabet("vowel")
IPA_NOT_ENGLISH, MANDARIN = _alphabet("not_english"), _alphabet("mandarin")

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
    table = _spellings(language == "en")
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


def _syllable(name: str) -> tuple[str, ...]:
    """Phones of a Mandarin syllable in espeak-ng's names, such as ``tsɑu2`` or ``thˈiɛ5n``."""
    left = re.sub(rf"[{_STRESS}0-9ɜ]", "", name)  # ɜ is a tone here
    phones: list[str] = []
    while left:
        size = next((n for n in (4, 3, 2, 1) if left[:n] in MANDARIN), 0)
        known = MANDARIN[left[:size]].split() if size else None
        if known is None:
            size = next((n for n in (2, 1) if left[:n] in _spellings(False)), 1)
            known = list(ipa_to_phones(left[:size], "cmn"))
        phones += known[1:] if phones[-1:] == known[:1] else known
        left = left[size:]
    return tuple(phones)


@lru_cache(maxsize=2)
def _spellings(is_english: bool) -> dict[str, str]:
    """All symbols in one table."""
    return {**IPA_CONSONANTS, **IPA_VOWELS, **({} if is_english else IPA_NOT_ENGLISH)}
