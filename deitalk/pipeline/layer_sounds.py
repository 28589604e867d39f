"""What a layer of edits knows of the recording that it was made on: levels, words and phones."""

from collections.abc import Iterable
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.phones import PHONES
from rig.arrays import Float32
from rig.curves.layers import Layer, Sound

if TYPE_CHECKING:
    from deitalk.pipeline.words.align import WordFit

PHONE_RATE = 2 * FRAME_RATE
"""Unit of the lengths of a layer's phones, Hz."""
SWITCH = 4.0
"""Logarithm of the probability that a phone of unknown words must gain to begin."""


def with_recording(
    layers: Iterable[Layer], speech: Speech, words: "WordFit | None" = None
) -> tuple[Layer, ...]:
    """Layers that know the recording that they lie on; those that know one already stay.

    Parameters
    ----------
    layers, speech, words
        As for `follow_recording`. Without words the phones are those that the sound shows; without
        torch there are none.
    """
    layers = tuple(layers)
    if all(layer.sound is not None for layer in layers):
        return layers
    sound, used = Sound.of(speech.waveform, SAMPLE_RATE), words if words and words.is_used else None
    spoken = tuple((w.text, w.start, w.end) for w in used.words) if used else ()
    if used:
        phones = tuple((p.name, round((p.end - p.start) * PHONE_RATE)) for p in used.phones)
    else:
        phones = heard_phones(speech)
    found = []
    for layer in layers:
        if layer.sound is None:
            edits = []
            for edit in layer.edits:  # with the words within its span
                start, end = edit.span
                within = [text for text, first, last in spoken if first < end and last > start]
                edits.append(replace(edit, words=" ".join(within) or edit.words))
            layer = replace(layer, sound=sound, words=spoken, phones=phones, edits=tuple(edits))
        found.append(layer)
    return tuple(found)


def heard_phones(speech: Speech) -> tuple[tuple[str, int], ...]:
    """Phones that a sound of unknown words shows, with their lengths at `PHONE_RATE`."""
    if not has_torch() or not speech.activity.any():
        return ()
    from deitalk.pipeline.words.align import PRIOR_POWER
    from deitalk.pipeline.words.evidence import measure_phones, phone_evidence

    prior = np.float32(PRIOR_POWER) * np.log(phone_evidence().weights["prior"])
    path = _best_phones(measure_phones(speech) - prior.astype(np.float32))
    edges = np.flatnonzero(np.diff(path)) + 1
    starts = [0, *edges.tolist(), len(path)]
    return tuple((PHONES[path[a]], b - a) for a, b in pairwise(starts) if b > a)


def _best_phones(evidence: Float32) -> np.ndarray:
    """Phone of each row [shape=(R,)] (Viterbi); another one costs `SWITCH`."""
    score, back = np.zeros(evidence.shape[1]), np.zeros(evidence.shape, np.int64)
    own = np.arange(evidence.shape[1])
    for row, logs in enumerate(evidence):
        best = int(score.argmax())
        stays = score >= score[best] - SWITCH
        back[row] = np.where(stays, own, best)
        score = np.where(stays, score, score[best] - SWITCH) + logs
    path = np.empty(len(evidence), np.int64)
    state = int(score.argmax())
    for row in range(len(evidence) - 1, -1, -1):
        path[row] = state
        state = int(back[row, state])
    return path


def has_torch() -> bool:
    """Whether the phones of a sound can be measured here."""
    return find_spec("torch") is not None
