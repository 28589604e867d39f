"""What is said in a recording: words with or without their times.

Words are pronounced by espeak-ng in the language of one of its voices.
"""

import atexit
import ctypes
import os
import re
import tempfile
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

from deitalk.acting_fields import Words
from deitalk.errors import ConfigError, DataError, MissingError
from rig import limits
from rig.errors import quoted, shorten
from rig.files.reading import rows_of

# Other phone alphabets to ARPABET: IPA and Mandarin.
#
# Phones are chosen by their articulation, so the tables map a foreign sound to the English phone
# with the nearest lips and jaw, then the nearest tongue: the front rounded vowels become rounded
# ones, a tapped r becomes DX (whose lips are free) and not R (whose lips protrude).

# ``ipa.csv``: symbol(s) of the International Phonetic Alphabet -> phones. Length marks are looked
# up first and then dropped; stress, tone, nasality and secondary articulation are dropped (see
# _PLAIN). Outside English e and o do not glide, `a` is open and central, and `r` is a tap or a
# trill (not_english). Of Mandarin, espeak-ng's own names, where h after a stop is aspiration and a
# dot is retroflexion.


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


# espeak-ng through ctypes: the pronunciation of words in many languages.

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


# Interval tiers of Praat's TextGrid files, in the long and in the short form.

Interval = tuple[float, float, str]
"""Start and end in seconds, and the label."""
_TOKEN = re.compile(r'"((?:[^"]|"")*)"|\[\d+\]|(?<![\w.])(-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)(?!\w)')
"""A quoted text, a number in brackets (which is no value), or a number: both forms have the same
values in the same order."""


def intervals_of(text: str, path: object) -> dict[str, list[Interval]]:
    """Interval tiers of a TextGrid by name, in the order of the text; `path` is for messages.

    Raises
    ------
    DataError
        If it is no TextGrid with interval tiers.
    """
    found = (match for match in _TOKEN.finditer(text) if not match[0].startswith("["))
    values = [float(m[2]) if m[2] else m[1].replace('""', '"') for m in found]
    tiers: dict[str, list[Interval]] = {}
    for i, value in enumerate(values):
        if value == "IntervalTier" and len(values) > i + 4:
            tiers[str(values[i + 1])] = _intervals(path, values[i + 4 :])
    if not tiers:
        raise DataError(f"{path}: no interval tier; save a TextGrid of Praat with one")
    return tiers


def _intervals(path: object, values: list[float | str]) -> list[Interval]:
    """Intervals of a tier from its number of intervals on."""
    count = values[0]
    if not isinstance(count, float) or not 0 <= count <= (len(values) - 1) // 3:
        raise DataError(f"{path}: a tier has {quoted(count)} intervals, which are not in the file")
    rows: list[Interval] = []
    for k in range(1, 1 + 3 * int(count), 3):
        start, end, label = values[k : k + 3]
        if not isinstance(start, float) or not isinstance(end, float) or isinstance(label, float):
            raise DataError(f"{path}: interval {len(rows) + 1} is no start, end and text")
        rows.append((start, end, label))
    return rows


LANGUAGE = "en-us"
_SILENT = frozenset(("", "sil", "sp", "spn", "pau", "<eps>", "<p:>", "<sil>", "_", "#", "..."))
_BRACKETS = re.compile(r"\[[^]]*\]|\([^)]*\)")
"""What is not spoken in subtitles: ``[MUSIC]``, ``(laughs)``."""
CUE_SECONDS = 0.5
"""By which a word may lie outside the times of its subtitle, beside the slack of timed words."""
_CLAUSE = re.compile(r"[^.!?;:。！？；\n]+[.!?;:。！？；\n]*")


@dataclass(frozen=True)
class Word:
    """A word.

    Attributes
    ----------
    text : str
        As written.
    phones : tuple of str
        Members of `deitalk.postprocess.phones.PHONES`.
    start, end : float or None
        Seconds, where they were given.
    """

    text: str
    phones: tuple[str, ...]
    start: float | None = None
    end: float | None = None


@dataclass(frozen=True)
class Transcript:
    """Words in the order in which they are spoken.

    Attributes
    ----------
    words : tuple of Word
        At least one, each with phones.
    source : str
        Name of the file, or the text.
    """

    words: tuple[Word, ...]
    source: str

    @classmethod
    def of(
        cls, given: str | Path | Words, language: str = LANGUAGE, role: str | None = None
    ) -> "Transcript":
        """Words of a text or a file, see `deitalk.acting_fields.Words`.

        Parameters
        ----------
        given : str, Path or Words
            Text or a path.
        language : str
            Voice of espeak-ng that pronounces words: ``en-us``, ``de``, ``cmn`` …
        role : str, optional
            Speaker of subtitles whose words are read; all by default.

        Raises
        ------
        DataError
            If there is no word, no such speaker, or the file is not as described.
        MissingError
            If espeak-ng is not installed.
        ConfigError
            If the language is unknown.
        """
        words = Words.of(given)
        check_language(language)
        source = words.source or shorten(words.text, 60)
        if words.kind == "grid" and role is not None:
            raise DataError(f"role {quoted(role)} needs lines with speakers; give a .srt or a .vtt")
        if words.kind == "grid":
            rows = _tier(words.text, source)
            found = [Word(label, _phones_of(label, language), *times) for *times, label in rows]
        elif words.kind == "ssml":
            raise DataError(f"words {source}: SSML is a script; give it as script")
        elif words.kind == "subtitles" or role is not None:
            cues = cues_of(words, source, role)
            found = [word for cue in cues for word in cue.words(cue.text, language)]
        else:
            found = _pronounced(_checked_text(words.text), language)
        return cls(_checked(found, source), source)


def spoken_transcript(words: Iterable[Word], source: str) -> Transcript:
    """A transcript of words; DataError if none is pronounced."""
    return Transcript(_checked(words, source), source)


def check_language(language: str) -> None:
    """Refuse a language that espeak-ng has no voice for; MissingError without espeak-ng."""
    if (reason := missing()) is not None:
        raise MissingError(f"words need espeak-ng for their sounds; {reason}")
    if not isinstance(language, str) or not has_voice(language):
        raise ConfigError(
            f"language {quoted(language)} is no voice of espeak-ng; en-us, en-gb, de, fr, es and "
            "cmn are"
        )


def _checked_text(text: str) -> str:
    if any(0xD800 <= ord(c) < 0xE000 or c == "\0" for c in text):
        raise DataError(f"words {quoted(text)} hold bytes that are no text; write them in UTF-8")
    return text


def _checked(words: Iterable[Word], source: str) -> tuple[Word, ...]:
    """Words that have phones."""
    found = tuple(word for word in words if word.phones)
    if not found:
        raise DataError(f"transcript {quoted(source)} has no word that is pronounced; write some")
    if len(found) > limits.TRANSCRIPT_WORDS:
        raise DataError(
            f"transcript {quoted(source)} has {len(found):,} words; at most "
            f"{limits.TRANSCRIPT_WORDS:,} are read: cut the recording"
        )
    return found


# --- words


def bare(word: str) -> str:
    """A word as written, without the marks around it."""
    return word.strip(",.!?;:\"'()…«»")


def _pronounced(text: str, language: str) -> list[Word]:
    """Words of a text with their phones, clause by clause."""
    words: list[Word] = []
    for clause in _CLAUSE.findall(text):
        written = [w for w in clause.split() if any(c.isalnum() for c in w)]
        if not written:
            continue
        spoken = spoken_words(pronounce(clause, voice=language), language)
        if len(spoken) != len(written):  # espeak-ng joins small words, and divides numbers
            parts = [(w, phones) for w in written for phones in _spoken(w, language)]
        else:
            parts = list(zip(written, spoken, strict=True))
        words += [Word(bare(word), phones) for word, phones in parts]
    return words


def _spoken(word: str, language: str) -> list[tuple[str, ...]]:

    return spoken_words(pronounce(word, voice=language), language)


def _phones_of(text: str, language: str) -> tuple[str, ...]:
    """Phones of one or more words together."""
    return tuple(phone for phones in _spoken(text, language) for phone in phones)


# --- TextGrids and subtitles


def _tier(text: str, source: str) -> list[Interval]:
    """Words of a TextGrid, without silences."""
    tiers = intervals_of(text, source)
    named = [name for name in tiers if "word" in name.lower()]
    if not named and len(tiers) > 1:
        known = ", ".join(map(quoted, tiers))
        raise DataError(f"{source}: no tier is named words; its tiers are {known}: rename one")
    tier = tiers[named[0] if named else next(iter(tiers))]
    rows = [row for row in tier if row[2].strip().lower() not in _SILENT]
    ends = [0.0, *(end for _, end, _ in rows)]
    for number, (before, (start, end, label)) in enumerate(zip(ends, rows, strict=False), 1):
        if not 0 <= start < end <= limits.SECONDS or start < before - 0.02:
            raise DataError(
                f"{source}, word {number} {quoted(label)}: {start:g} to {end:g} s; times must rise"
            )
    return rows


_SPEAKER = re.compile(r"\s*([A-Z][A-Z0-9 .'&_-]{0,30}):\s+")
"""A speaker before a line: ``ANNA: …``."""
_VOICE = re.compile(r"<v(?:\.[^\s>]*)?\s+([^>]{1,100})>")
_MARK = "\u2063"
"""Invisible letter around the name of a voice, which the reader of subtitles keeps."""


@dataclass(frozen=True)
class Cue:
    """A line that somebody speaks.

    Attributes
    ----------
    text : str
        As written, without the speaker.
    start, end : float or None
        Seconds, of subtitles.
    speaker : str
        Empty where none is named.
    """

    text: str = ""
    start: float | None = None
    end: float | None = None
    speaker: str = ""

    def words(self, text: str, language: str) -> list[Word]:
        """Words of a text of it, within its times."""
        found = _pronounced(_checked_text(text), language)
        if self.start is None or self.end is None:
            return found
        times = self.start - CUE_SECONDS, self.end + CUE_SECONDS
        return [Word(word.text, word.phones, *times) for word in found]


def cues_of(
    words: Words, source: str, role: str | None = None, *, brackets: bool = False
) -> list[Cue]:
    """Lines of a text or of subtitles, those of one speaker if a role is given.

    Parameters
    ----------
    words : Words
        A text or subtitles.
    source : str
        Its name, for messages.
    role : str, optional
        A speaker, in any case of letters.
    brackets : bool
        Keep what stands in brackets, which is not spoken.

    Raises
    ------
    DataError
        If there is no subtitle, or none of the role.
    """
    if words.kind == "subtitles":
        found = _subtitles(words.text, source)
    elif role is not None:
        raise DataError(f"role {quoted(role)} needs lines with times; give a .srt or a .vtt")
    else:
        found = [_spoken_by(line, None, None) for line in words.text.splitlines() if line.strip()]
    if not brackets:
        found = [replace(cue, text=_BRACKETS.sub(" ", cue.text)) for cue in found]
    return found if role is None else [cue for cue in found if _is(cue, role, found, source)]


def other_spans(words: Words, source: str, role: str) -> list[tuple[float, float]]:
    """Seconds in which others speak and the role does not."""
    found = cues_of(words, source)
    spans = []
    own = [(c.start, c.end) for c in found if c.speaker.casefold() == role.casefold()]
    for cue in found:
        if not cue.speaker or cue.speaker.casefold() == role.casefold():
            continue
        pieces = [(cue.start or 0.0, cue.end or 0.0)]
        for begin, end in own:
            pieces = [
                part
                for first, last in pieces
                for part in ((first, min(last, begin or 0.0)), (max(first, end or 0.0), last))
                if part[1] > part[0]
            ]
        spans += pieces
    return spans


def _is(cue: Cue, role: str, cues: list[Cue], source: str) -> bool:
    """Whether a cue is of a role, which one of them must be."""
    speakers = dict.fromkeys(c.speaker for c in cues if c.speaker)
    if role.casefold() not in {speaker.casefold() for speaker in speakers}:
        known = ", ".join(speakers) or "none"
        raise DataError(f"role {quoted(role)} is no speaker of {source}; there are: {known}")
    return cue.speaker.casefold() == role.casefold()


def _subtitles(text: str, source: str) -> list[Cue]:
    """Cues of SubRip or WebVTT subtitles in the order of their times."""
    import pysubs2

    plain = re.sub(r"(?m)^(NOTE|STYLE|REGION)\b.*(\n.+)*", "", "\n".join(text.splitlines()))
    form = "vtt" if plain.startswith("WEBVTT") else "srt"
    plain = _VOICE.sub(lambda match: f"{_MARK}{match[1].strip()}{_MARK}", plain)
    events = pysubs2.SSAFile.from_string(plain, format_=form)
    events.sort()
    rows = []
    for event in events:
        before, *voices = event.plaintext.split(_MARK)
        pieces = [("", before), *zip(voices[::2], voices[1::2], strict=False)]
        for speaker, said in pieces:
            if said.strip():
                times = event.start / 1000, event.end / 1000
                lines = said.splitlines() if not speaker else [said]
                rows += _joined_lines([_spoken_by(line, *times, speaker) for line in lines])
    if not rows:
        raise DataError(f"{source}: no subtitle with times such as 00:00:01,000 --> 00:00:02,500")
    return rows


def _spoken_by(text: str, start: float | None, end: float | None, speaker: str = "") -> Cue:
    match = None if speaker else _SPEAKER.match(text)
    if match is None:
        return Cue(text, start, end, speaker)
    return Cue(text[match.end() :], start, end, match[1].strip())


def _joined_lines(cues: list[Cue]) -> list[Cue]:
    """Lines of one subtitle; those without a speaker go on with the line before."""
    found: list[Cue] = []
    for cue in cues:
        if found and not cue.speaker:
            found[-1] = replace(found[-1], text=f"{found[-1].text} {cue.text}")
        else:
            found.append(cue)
    return found
