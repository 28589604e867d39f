"""espeak-ng through ctypes: the pronunciation of words in many languages."""

import atexit
import ctypes
import os
import re
import tempfile
import unicodedata
from functools import cache, lru_cache

from deitalk.errors import ConfigError, MissingError

# Other phone alphabets to ARPABET: IPA and Mandarin.
#
# Phones are chosen by their articulation, so the tables map a foreign sound to the English phone
# with the nearest lips and jaw, then the nearest tongue: the front rounded vowels become rounded
# ones, a tapped r becomes DX (whose lips are free) and not R (whose lips protrude).

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


@lru_cache(maxsize=2)
def _table(is_english: bool) -> dict[str, str]:
    """All symbols in one table."""
    return {**IPA_CONSONANTS, **IPA_VOWELS, **({} if is_english else IPA_NOT_ENGLISH)}


SYSTEM_LIBRARY = "libespeak-ng.so.1"
MISSING = (
    f"espeak: neither the package espeakng-loader nor the library {SYSTEM_LIBRARY} works on this "
    "machine; pip install espeakng-loader"
)
LONGEST_PATH = 150
"""Longest data path in bytes; the library fails from 160 on."""

# speak_lib.h of espeak-ng 1.51 and 1.52
_SYNCHRONOUS, _PHONEME_EVENTS, _IPA_EVENTS, _DO_NOT_EXIT = 2, 0x0001, 0x0002, 0x8000
UTF8, _PHONEMES_IPA = 1, 2


def _loaded() -> tuple[ctypes.CDLL, int]:
    """The initialised library and its sample rate.

    The library of the Python package comes first, so that a seed gives the same corpus on every
    machine; the system's library is used without the package.
    """
    options = _PHONEME_EVENTS | _IPA_EVENTS | _DO_NOT_EXIT
    for path, data in (*_packaged(), (SYSTEM_LIBRARY, None)):
        try:
            found = ctypes.CDLL(path)
        except OSError:
            continue
        folder = None if data is None else os.fsencode(_short(data))
        sample_rate = int(found.espeak_Initialize(_SYNCHRONOUS, 200, folder, options))
        if sample_rate > 0:
            return found, sample_rate
    raise MissingError(MISSING)


def _packaged() -> list[tuple[str, str]]:
    """Library and data folder of the package espeakng-loader; empty without it."""
    try:
        import espeakng_loader

        return [(espeakng_loader.get_library_path(), espeakng_loader.get_data_path())]
    except (ImportError, RuntimeError):
        return []


def _short(folder: str) -> str:
    """A path of `folder` that is short enough: itself, or a link removed at exit."""
    if len(os.fsencode(folder)) <= LONGEST_PATH:
        return folder
    links = tempfile.TemporaryDirectory(prefix="deitalk-")
    atexit.register(links.cleanup)
    link = os.path.join(links.name, "espeak-ng-data")
    os.symlink(folder, link)
    return link


class Library:
    """The loaded library; one per process, used by one thread."""

    def __init__(self) -> None:
        self._library, self.sample_rate = _loaded()
        self._library.espeak_TextToPhonemes.restype = ctypes.c_char_p

    def has_voice(self, name: str) -> bool:
        """Select the voice `name`; False if there is none."""
        return bool(self._library.espeak_SetVoiceByName(name.encode()) == 0)

    def pronounce(self, text: str, voice: str) -> str:
        """Pronunciation of `text` by `voice` in the International Phonetic Alphabet."""
        self.has_voice(voice)
        left, parts = ctypes.c_char_p(text.encode()), []
        while left.value is not None:
            ipa = self._library.espeak_TextToPhonemes(ctypes.byref(left), UTF8, _PHONEMES_IPA)
            parts.append((ipa or b"").decode(errors="ignore"))
        return " ".join(parts)


@cache
def library() -> Library:
    """The library of this process."""
    return Library()


def known_voice(name: str) -> str:
    """Return `name` if espeak-ng has this voice.

    Raises
    ------
    ConfigError
        If it is not.
    """
    if not library().has_voice(name):
        raise ConfigError(f"voice={name!r} is not an espeak-ng voice; en-us, de and es are")
    return name


def missing() -> str | None:
    """Return None if espeak-ng works here, else the reason and the package to install."""
    try:
        library()
    except MissingError as error:
        return str(error)
    return None


@cache
def has_voice(name: str) -> bool:
    """Whether espeak-ng has the voice `name`."""
    return library().has_voice(name)


def pronounce(text: str, *, voice: str = "en-us") -> str:
    """Pronunciation of `text` by espeak-ng in the International Phonetic Alphabet.

    Raises
    ------
    ConfigError
        For an unknown voice.
    MissingError
        If espeak-ng is not installed.
    """
    return library().pronounce(text, known_voice(voice))
