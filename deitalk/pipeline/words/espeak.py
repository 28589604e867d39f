"""espeak-ng through ctypes: the pronunciation of words in many languages."""

import atexit
import ctypes
import os
import tempfile
from functools import cache

from deitalk.errors import ConfigError, MissingError

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
