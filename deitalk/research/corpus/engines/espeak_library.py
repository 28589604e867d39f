"""Speech by the library of espeak-ng, with the sample at which every phone begins."""

import ctypes
from functools import cache
from typing import Any

from deitalk.pipeline.words.espeak import UTF8, Library

_SSML, _PHONEME_EVENT, _LIST_END = 0x10, 7, 0
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


class Synthesiser(Library):
    """The loaded library, which also speaks."""

    def __init__(self) -> None:
        super().__init__()
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
            data, len(data) + 1, 0, 1, 0, UTF8 | (_SSML if ssml else 0), None, None
        )
        self._library.espeak_Synchronize()
        return bytes(self._samples), self._events


@cache
def library() -> Synthesiser:
    """The library of this process."""
    return Synthesiser()
