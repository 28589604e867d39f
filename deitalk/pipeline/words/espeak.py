"""espeak-ng through ctypes: the pronunciation of words in many languages, and speech."""

import atexit
import ctypes
import os
import tempfile
from functools import cache
from typing import Any

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
_UTF8, _SSML, _PHONEMES_IPA, _PHONEME_EVENT, _LIST_END = 1, 0x10, 2, 7, 0
_PARAMETERS = {"rate": 1, "volume": 2, "pitch": 3, "pitch_range": 4}


class _EventId(ctypes.Union):
    _fields_ = (
        ("number", ctypes.c_int),
        ("name", ctypes.c_char_p),
        ("string", ctypes.c_char * 8),
    )


class _Event(ctypes.Structure):
    _fields_ = (
        ("type", ctypes.c_int),
        ("unique_identifier", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_position", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user_data", ctypes.c_void_p),
        ("id", _EventId),
    )


_Callback = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event)
)


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
        self._library.espeak_Info.restype = ctypes.c_char_p
        self._samples = bytearray()
        self._events: list[tuple[int, str]] = []
        self._callback = _Callback(self._receive)
        self._library.espeak_SetSynthCallback(self._callback)

    def _receive(self, samples: Any, count: int, events: Any) -> int:
        """Collect audio and phone events."""
        if samples and count > 0:
            self._samples += ctypes.string_at(samples, 2 * count)
        i = 0
        while events and events[i].type != _LIST_END:
            if events[i].type == _PHONEME_EVENT:
                # names are cut at 8 bytes, perhaps inside a letter
                self._events.append((events[i].sample, events[i].id.string.decode(errors="ignore")))
            i += 1
        return 0

    def has_voice(self, name: str) -> bool:
        """Select the voice `name`; False if there is none."""
        return bool(self._library.espeak_SetVoiceByName(name.encode()) == 0)

    def data_folder(self) -> str:
        """Folder of the voices and their variants."""
        path = ctypes.c_char_p()
        self._library.espeak_Info(ctypes.byref(path))
        return (path.value or b"").decode()

    def synthesise(
        self, text: str, voice: str, parameters: dict[str, int], *, ssml: bool
    ) -> tuple[bytes, list[tuple[int, str]]]:
        """Samples (16-bit) of `text`, and the sample and IPA name at which each phone begins."""
        self.has_voice(voice)
        for name, value in parameters.items():
            self._library.espeak_SetParameter(_PARAMETERS[name], value, 0)
        data = text.encode()
        self._library.espeak_Synth(
            data, len(data) + 1, 0, 1, 0, _UTF8 | (_SSML if ssml else 0), None, None
        )
        self._library.espeak_Synchronize()
        return bytes(self._samples), self._events

    def pronounce(self, text: str, voice: str) -> str:
        """Pronunciation of `text` by `voice` in the International Phonetic Alphabet."""
        self.has_voice(voice)
        left, parts = ctypes.c_char_p(text.encode()), []
        while left.value is not None:
            ipa = self._library.espeak_TextToPhonemes(ctypes.byref(left), _UTF8, _PHONEMES_IPA)
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
