"""Phones to articulation: dominance functions, hard contacts, thirteen channels.

Cohen and Massaro (1993), "Modeling coarticulation in synthetic visual speech": every phone
pulls every channel towards its target with a dominance that falls off exponentially on both
sides; a frame is the dominance-weighted mean. Bilabials and labiodentals then override the mean,
because lips that only almost meet show no /m/.

Targets are the table ``tables/articulation.csv`` (our reading of phonetics textbooks, 0 rest to
1 full). Letters: P phones, K channels, N frames.
"""

import csv
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from deitalk.postprocess.phones import BILABIALS, LABIODENTALS, VOWELS
from deitalk.research.corpus.utterance import Phone
from rig.arrays import Float64

CHANNELS = (
    "jaw", "together", "press", "bite", "funnel", "purse", "stretch", "upper", "lower", "tip",
    "out", "back", "hiss",
)  # fmt: skip
JAW, TOGETHER, PRESS, BITE, FUNNEL, PURSE, STRETCH, UPPER, LOWER, TIP, OUT, BACK, HISS = range(13)

DIPHTHONGS = {
    "AY": ("AA", "IY", 0.6),
    "AW": ("AA", "UW", 0.55),
    "OY": ("AO", "IY", 0.55),
    "EY": ("EH", "IY", 0.5),
    "OW": ("OW", "UW", 0.55),
}
"""Two targets of a diphthong and the time share of the first; OW has its own row in the table."""

ONSET_RATE = np.array([14, 38, 34, 34, 11, 11, 12, 18, 16, 30, 26, 28, 26.0])
"""Fall of dominance before a phone, 1/s: rounding begins 200 ms early, closures 30 ms."""
OFFSET_RATE = np.array([15, 40, 36, 36, 13, 13, 13, 18, 17, 30, 26, 28, 26.0])
"""Fall of dominance after a phone, 1/s."""
CONTACT_RAMP_SECONDS = 0.045
"""Duration of lips closing, and of lips parting, seconds."""
CONTACT_MINIMUM_SECONDS = 0.075
"""Shortest contact, seconds: two frames of video."""
CONTACT_JAW = 0.2
"""Widest jaw where lips or teeth are in contact (0.9 and more)."""
RIVAL_RAMP_SECONDS = 0.015
"""Duration of the lower lip's move from one contact to another, as between /m/ and /f/, seconds."""
RIVAL_SECONDS = 0.09
"""Contacts of different kinds nearer than this are moved apart, seconds."""
REACH_SECONDS = 0.45
"""Distance beyond which dominance is neglected, seconds."""

Segment = tuple[float, float, str, float]
"""Start and end in seconds, phone, factor on its jaw."""


@cache
def targets() -> dict[str, Float64]:
    """Target of every phone [shape=(K,)], diphthongs excepted."""
    text = (
        resources.files("deitalk.research.corpus").joinpath("tables/articulation.csv").read_text()
    )
    return {
        row["phone"]: np.array([float(row[channel]) for channel in CHANNELS])
        for row in csv.DictReader(text.splitlines())
    }


@cache
def dominance(name: str) -> Float64:
    """Dominance of a phone at its centre, per channel [shape=(K,)]."""
    target = targets()[name]
    strength = np.full(len(CHANNELS), 0.35)
    if name in VOWELS:
        strength[JAW] = 0.8
        strength[[FUNNEL, PURSE, STRETCH]] = 0.7
        strength[[UPPER, LOWER, TOGETHER, BITE]] = 0.6
    elif name == "SIL":
        strength[:] = 0.5
    else:
        strength[[FUNNEL, PURSE, STRETCH]] = 0.12  # consonants take the lips of the vowels ...
    strength = np.where(target > 0.3, np.maximum(strength, 0.9), strength)  # ... unless their own
    if name in BILABIALS:
        strength[[TOGETHER, PRESS]] = 4
        strength[[JAW, UPPER, LOWER]] = (0.9, 1.5, 1.5)
    if name in LABIODENTALS:
        strength[[BITE, JAW]] = (4, 0.9)
    if target[HISS] > 0:
        strength[[JAW, HISS]] = (1.6, 2)
    if name in ("T", "D", "N"):
        strength[JAW] = 0.8  # a tongue at the alveolar ridge requires a high jaw
    rounded = [c for c in (FUNNEL, PURSE) if target[c] > 0.25 and name not in VOWELS]
    strength[rounded] = 1.6
    tongue = [c for c in (TIP, OUT, BACK) if target[c] > 0.4]
    strength[tongue] = 2.5
    return strength


def articulate(
    phones: Sequence[Phone], n_frames: int, fps: float, stress: Float64 | None = None
) -> Float64:
    """Channels of an utterance.

    Parameters
    ----------
    phones : sequence of Phone
        In time order; they cover the clip, silence included (what lies 0.45 s beyond the last
        phone is at rest).
    n_frames : int
        Frames N.
    fps : float
        Frame i is at i / fps seconds.
    stress : ndarray [shape=(P,)] or None
        Factor on the jaw of every phone from its loudness; 1 is the average.

    Returns
    -------
    ndarray [shape=(N, K), range 0 to 1]
    """
    times = np.arange(n_frames) / fps
    segments = _segments(phones, stress)
    channels = _blend(segments, times)
    for contact in _contacts(segments):
        _hold(channels, times, contact)
    shut = np.minimum(channels[:, [TOGETHER, BITE]].max(axis=1) / 0.9, 1) ** 2
    channels[:, JAW] -= shut * np.maximum(channels[:, JAW] - CONTACT_JAW, 0)
    return np.clip(channels, 0, 1)


def _blend(segments: Sequence[Segment], times: Float64) -> Float64:
    """Dominance-weighted mean of the targets [shape=(N, K)]."""
    n_frames = len(times)
    weighted = np.zeros((n_frames, len(CHANNELS)))
    weight = np.full((n_frames, len(CHANNELS)), 1e-6)
    for start, end, name, factor in segments:
        first, last = np.searchsorted(times, (start - REACH_SECONDS, end + REACH_SECONDS))
        if first >= last or end <= start:
            continue
        near = times[first:last, None]
        begin, finish = _plateau(start, end, name)
        fall = np.maximum(begin - near, 0) * ONSET_RATE + np.maximum(near - finish, 0) * OFFSET_RATE
        strength = dominance(name) * np.exp(-fall)
        if name == "SIL" and end - start < 0.06:
            strength = 0.3 * strength
        target = targets()[name].copy()
        target[JAW] *= factor
        weighted[first:last] += strength * target
        weight[first:last] += strength
    mean: Float64 = weighted / weight
    return mean


def _segments(phones: Sequence[Phone], stress: Float64 | None) -> list[Segment]:
    """Segments with diphthongs as two targets and unknown names as a schwa."""
    out = []
    for i, phone in enumerate(phones):
        factor = 1.0 if stress is None else float(stress[i])
        if phone.name in DIPHTHONGS:
            first, second, share = DIPHTHONGS[phone.name]
            middle = phone.start + share * (phone.end - phone.start)
            out.append((phone.start, middle, first, factor))
            out.append((middle, phone.end, second, factor))
        else:
            name = phone.name if phone.name in targets() else "AX"
            out.append((phone.start, phone.end, name, factor))
    return out


def _plateau(start: float, end: float, name: str) -> tuple[float, float]:
    """Start and end of the part of a phone with full dominance, seconds."""
    length = end - start
    if name == "SIL":
        middle = (start + end) / 2
        return min(start + 0.08, middle), max(end - 0.08, middle)
    if name == "M":
        return start, end
    if name in BILABIALS or name in LABIODENTALS:
        return start, end - 0.15 * length
    return start + 0.25 * length, end - 0.25 * length


class Contact(NamedTuple):
    """Lips that meet (P B M), or the lower lip at the teeth (F V): seconds."""

    start: float
    end: float
    ramp_in: float
    ramp_out: float
    bilabial: bool


def _contacts(segments: Sequence[Segment]) -> list[Contact]:
    """Every contact with its least duration; bilabials last, because the last one is kept."""
    held = [s for s in segments if s[2] in BILABIALS or s[2] in LABIODENTALS]
    contacts = []
    for i, (start, end, name, _) in enumerate(held):
        before = i > 0 and _rivals(held[i - 1], held[i])
        after = i + 1 < len(held) and _rivals(held[i], held[i + 1])
        if name == "P":
            end -= 0.25 * (end - start)  # the burst is already open
        missing = max(CONTACT_MINIMUM_SECONDS - (end - start), 0)
        share = 0.5 + 0.5 * (after - before)  # grow away from the other contact
        begin, finish = start - share * missing, end + (1 - share) * missing
        contacts.append(Contact(begin, finish, _ramp(before), _ramp(after), name in BILABIALS))
    return sorted(contacts, key=lambda contact: contact.bilabial)


def _ramp(is_rival: bool) -> float:
    """Seconds from one contact to another, or to and from open lips."""
    return RIVAL_RAMP_SECONDS if is_rival else CONTACT_RAMP_SECONDS


def _rivals(first: Segment, second: Segment) -> bool:
    """Whether two neighbouring contacts are of different kinds and hardly apart."""
    differ = (first[2] in BILABIALS) != (second[2] in BILABIALS)
    return differ and second[0] - first[1] < RIVAL_SECONDS


def _hold(channels: Float64, times: Float64, contact: Contact) -> None:
    """Overwrite the mean with one contact."""
    rise = (times - contact.start) / contact.ramp_in + 1
    fall = (contact.end - times) / contact.ramp_out + 1
    grip = np.clip(np.minimum(rise, fall), 0, 1)
    grip = grip * grip * (3 - 2 * grip)
    own, other = (TOGETHER, BITE) if contact.bilabial else (BITE, TOGETHER)
    channels[:, own] = np.maximum(channels[:, own], grip)
    channels[:, other] *= 1 - grip
    if contact.bilabial:
        channels[:, UPPER] *= 1 - grip
        channels[:, LOWER] *= 1 - grip
