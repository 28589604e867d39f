"""Utterances with silence added, prosody modified and articulation computed.

Letters: N curve frames at `CURVE_RATE`, K articulation channels.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.prosody import level_db, measure_prosody
from deitalk.postprocess.phones import VOWELS
from deitalk.research.corpus.articulation import articulate
from deitalk.research.corpus.rig_targets import intensity_envelope
from deitalk.research.corpus.utterance import Phone, Utterance
from deitalk.research.evaluation.contours import (
    Contour,
    apply_contour,
    contour_at,
    prosody_index,
    random_contour,
)
from rig.arrays import Float32, Float64

CURVE_RATE = 60
"""Curves are stored at twice the rig's rate, so that training can change the speed of a clip
without blurring closures."""
SHARES = (0.7, 0.2)
"""Share of speakers in the splits train and val; the rest are in test (§4.1)."""
NATURAL_WEIGHT = 0.6
"""Weight of a recording's own prosody beside the contour that was applied to it."""


def split_of(speaker: str) -> str:
    """Split of a speaker, fixed by a hash of the name: 70/20/10 (§4.1).

    Deviation: the few voices of flite and festival are all in train; espeak variants and readers
    are divided. A variant of espeak is one speaker in every accent and language.
    """
    if speaker.startswith(("flite:", "festival:")):
        return "train"
    if speaker.startswith("espeak:") and "+" in speaker:
        speaker = "espeak:+" + speaker.partition("+")[2]
    place = int.from_bytes(hashlib.sha256(speaker.encode()).digest()[:4]) / 2**32
    if place < SHARES[0]:
        return "train"
    return "validation" if place < sum(SHARES) else "test"


@dataclass(frozen=True)
class Take:
    """An utterance with modified prosody, its intensity and its articulation."""

    utterance: Utterance
    waveform: Float32
    phones: tuple[Phone, ...]
    intensity: Float64
    """e(t) [shape=(N,)] at CURVE_RATE."""
    channels: Float64
    """Articulation [shape=(N, K)] at CURVE_RATE."""


def perform(utterance: Utterance, rng: np.random.Generator) -> Take:
    """Add silence, modify the prosody along a random contour, and articulate.

    Recordings of the splits val and test keep their prosody.
    """
    padded = _pad(utterance, rng)
    contour = _contour(padded, rng)
    waveform, time_map = apply_contour(padded.waveform, contour)
    phones = tuple(_moved(phone, time_map) for phone in padded.phones)
    n_frames = -(-CURVE_RATE * len(waveform) // SAMPLE_RATE)
    source_times = np.interp(np.arange(n_frames) / CURVE_RATE, time_map[1], time_map[0])
    # Sum of the applied contour and the measured prosody, at seconds of the source.
    measured = measure_prosody(padded.waveform, frame_count(len(padded.waveform)))
    natural = prosody_index(measured)
    own = np.interp(source_times, np.arange(len(natural)) / FRAME_RATE, natural)
    z: Float64 = contour_at(contour, source_times) + NATURAL_WEIGHT * own
    return Take(
        padded,
        waveform,
        phones,
        intensity_envelope(z, speech_span(phones), CURVE_RATE),
        articulate(phones, n_frames, CURVE_RATE, loudness_stress(waveform, phones)),
    )


def _contour(padded: Utterance, rng: np.random.Generator) -> Contour:
    """A random contour; flat for 15 % of the clips and for recordings of val and test."""
    contour = random_contour(padded.duration_seconds, rng)
    evaluates = padded.engine == "recording" and split_of(padded.speaker) != "train"
    if evaluates or rng.random() < 0.15:
        return contour[0], np.zeros(len(contour[1]))
    return contour


def _moved(phone: Phone, time_map: tuple[Float64, Float64]) -> Phone:
    """A phone at its time after `apply_contour`."""
    start, end = np.interp((phone.start, phone.end), *time_map)
    return replace(phone, start=float(start), end=float(end))


def _pad(utterance: Utterance, rng: np.random.Generator) -> Utterance:
    """Add silence before and after; the edges of a recording are faded."""
    before, after = rng.uniform(0.05, 0.9), rng.uniform(0.1, 1.4)
    lead, trail = int(before * SAMPLE_RATE), int(after * SAMPLE_RATE)
    speech = utterance.waveform.copy()
    edge = min(160, len(speech) // 4)
    ramp = np.linspace(0, 1, edge, dtype=np.float32)
    speech[:edge] *= ramp
    speech[len(speech) - edge :] *= ramp[::-1]
    shift = lead / SAMPLE_RATE
    end = shift + len(speech) / SAMPLE_RATE
    phones = (
        Phone(0.0, shift, "SIL"),
        *(replace(p, start=p.start + shift, end=p.end + shift) for p in utterance.phones),
        Phone(end, end + trail / SAMPLE_RATE, "SIL"),
    )
    return replace(utterance, waveform=np.pad(speech, (lead, trail)), phones=phones)


def speech_span(phones: Sequence[Phone]) -> tuple[float, float] | None:
    """Start of the first phone and end of the last one without silence, seconds."""
    spoken = [phone for phone in phones if phone.name != "SIL"]
    return (spoken[0].start, spoken[-1].end) if spoken else None


def loudness_stress(waveform: Float32, phones: Sequence[Phone]) -> Float64:
    """Factor on the jaw of every phone: 4 % per decibel of a vowel above the average."""
    hop = SAMPLE_RATE // 100
    level = level_db(waveform, np.arange(len(waveform) // hop) * hop + hop // 2, hop)
    usual = np.percentile(level, 85)
    stress = np.ones(len(phones))
    for i, phone in enumerate(phones):
        inside = level[int(phone.start * 100) : int(phone.end * 100) + 1]
        if phone.name in VOWELS and len(inside):
            stress[i] = np.clip(1 + 0.04 * (inside.max() - usual), 0.7, 1.2)
    return stress
