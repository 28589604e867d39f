"""Layers of edits on the curves of a recording, and on those of another reading of its line.

A layer that was made on a take knows its recording: levels, words and phones with their times. On
the same recording its times hold. On another one of the same line they follow the words where both
have them, else the phones, which are laid through the new sound.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from difflib import SequenceMatcher
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.config.rules import KeepContacts
from deitalk.pipeline.layer_sounds import PHONE_RATE, has_torch
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.phones import PHONES, SILENCE
from rig import ControlSet, RigCurves
from rig.arrays import Bool, Float64
from rig.curves.apply_layers import Closures, apply_layers, retimed
from rig.curves.layers import HEAD_TARGETS, Edit, Layer, Sound
from rig.errors import listed

if TYPE_CHECKING:
    from deitalk.pipeline.words.align import FittedWord, WordFit
    from deitalk.postprocess.known_phones import KnownPhone

BEYOND_SECONDS = 0.5
"""Time by which an edit may reach beyond the recording without a note."""
LEAST_MATCHED = 0.5
"""Share of a layer's words that must be in another recording, for it to follow them."""


class Edited(NamedTuple):
    """Curves that are shown, and their neutral reading, with layers."""

    readings: tuple[RigCurves, RigCurves]
    notes: tuple[str, ...]
    """A line on each change."""
    plain: tuple[RigCurves, RigCurves]
    """The readings without layers."""
    layers: tuple[Layer, ...]
    """On the times of the recording."""
    controls: ControlSet
    closures: Closures | None

    def at(self, fps: float) -> tuple[RigCurves, RigCurves]:
        """The readings at another rate, with the layers applied at that rate.

        A layer that was made of curves of that rate gives each of their frames again; resampled
        curves would soften its steps.
        """
        given = self.layers, self.controls, self.closures
        shown, neutral = (apply_layers(one.resample(fps), *given)[0] for one in self.plain)
        return shown, neutral


def edited(
    layers: Iterable[Layer],
    readings: tuple[RigCurves, RigCurves],
    controls: ControlSet,
    rule: KeepContacts | None,
    speech: Speech,
    words: "WordFit | None" = None,
) -> Edited:
    """Apply layers to the curves that are shown and to their neutral reading.

    Parameters
    ----------
    layers : iterable of Layer
        In their order.
    readings : (RigCurves, RigCurves)
        Of the recording.
    controls : ControlSet
        Of their columns.
    rule : KeepContacts, optional
        Which closures are met again; None: none.
    speech, words
        As for `follow_recording`.
    """
    shown, neutral = readings
    followed, notes = follow_recording(layers, speech, words)
    closures = None if rule is None else ControlGroups(controls).closures(rule)
    shown, changes = apply_layers(shown, followed, controls, closures)
    neutral, _ = apply_layers(neutral, followed, controls, closures)
    unused = unused_notes(followed, shown)
    said = (*notes, *unused, *changes)
    return Edited((shown, neutral), said, readings, followed, controls, closures)


class Followed(NamedTuple):
    """Layers on the times of a recording, and a line on each that was changed for it."""

    layers: tuple[Layer, ...]
    notes: tuple[str, ...]


def follow_recording(
    layers: Iterable[Layer], speech: Speech, words: "WordFit | None" = None
) -> Followed:
    """Layers on the times of a recording.

    Parameters
    ----------
    layers : iterable of Layer
        Those without a sound keep their times.
    speech : Speech
        The recording.
    words : WordFit, optional
        Its words, where they are known.
    """
    found, notes = [], []
    sound: Sound | None = None
    for layer in layers:
        if layer.sound is not None and not layer.muted:
            sound = sound or Sound.of(speech.waveform, SAMPLE_RATE)
            if not layer.sound.is_same(sound):
                layer, note = _followed(layer, speech, words)
                notes.append(note)
        found.append(layer)
    return Followed(tuple(found), tuple(notes))


def _followed(layer: Layer, speech: Speech, words: "WordFit | None") -> tuple[Layer, str]:
    name = f"edit {layer.name}" if layer.name else "the edit"
    by, (times, lost) = "words", _times_by_words(layer, words)
    if times is None:
        by, times = "phones", _times_by_phones(layer, speech)
    if times is None:
        why = (
            "has neither its words nor its phones"
            if layer.words or layer.phones
            else ("is another one, and the file knows no words or phones")
        )
        return layer, f"{name} was made on another recording; this one {why}: its times are kept"
    kept = tuple(edit for edit in layer.edits if not _is_within(edit, lost))
    moved = times.new - times.old
    note = (
        f"{name} was made on another recording and follows its {by}: "
        f"{moved.min():+.2f} to {moved.max():+.2f} s"
    )
    if len(kept) < len(layer.edits):
        left = [edit for edit in layer.edits if _is_within(edit, lost)]
        named = listed([f"{edit.target} at {edit.span[0]:.2f} s" for edit in left])
        note += f"; left out, as their words are not said here: {named}"
    return retimed(replace(layer, edits=kept), *times), note


def _is_within(edit: Edit, spans: Sequence[tuple[float, float]]) -> bool:
    """Whether the middle of an edit lies within one of some spans."""
    middle = sum(edit.span) / 2
    return any(start <= middle < end for start, end in spans)


class Times(NamedTuple):
    """Moments of two recordings, as for `retimed`."""

    old: Float64
    new: Float64
    begins: Bool
    ends: Bool


Anchor = tuple[float, float]
"""Old and new seconds that belong together."""


def _times_by_words(layer: Layer, words: "WordFit | None") -> tuple[Times | None, list[Anchor]]:
    """Times of the words that both have, and of their phones if those are the same.

    None if they are too few. Old spans of the words that are not said follow.
    """
    if words is None or not words.is_used or not layer.words:
        return None, []
    old = [_plain(text) for text, _, _ in layer.words]
    new = [_plain(word.text) for word in words.words]
    pairs = [
        (block.a + k, block.b + k)
        for block in SequenceMatcher(None, old, new, autojunk=False).get_matching_blocks()
        for k in range(block.size)
    ]
    if len(pairs) < LEAST_MATCHED * len(old):
        return None, []
    edges = _edges([layer.words[a] for a, _ in pairs], [words.words[b] for _, b in pairs])
    before, after = _spoken(layer), [p for p in words.phones if p.name != SILENCE]
    if before and [name for name, _, _ in before] == [phone.name for phone in after]:
        return _rising(_edges(before, after), edges), []
    matched = {a for a, _ in pairs}
    lost = [(start, end) for k, (_, start, end) in enumerate(layer.words) if k not in matched]
    return _rising(edges, edges), lost


def _plain(word: str) -> str:
    return "".join(letter for letter in word.casefold() if letter.isalnum())


def _times_by_phones(layer: Layer, speech: Speech) -> Times | None:
    """Times of the layer's phones, laid through the sound; None if they do not fit it."""
    if not layer.phones or not has_torch():
        return None
    from deitalk.pipeline.words.align import fit_words
    from deitalk.pipeline.words.evidence import measure_phones, phone_evidence
    from deitalk.pipeline.words.pronounced import Word
    from deitalk.pipeline.words.transcript import Transcript

    spoken: list[list[tuple[str, float, float]]] = []
    for phone in _spoken(layer):
        if not spoken or phone[1] > spoken[-1][-1][2]:
            spoken.append([])
        spoken[-1].append(phone)
    if not spoken:
        return None
    chain = tuple(Word("", tuple(name for name, _, _ in run)) for run in spoken)
    prior = phone_evidence().weights["prior"]
    fit = fit_words(measure_phones(speech), Transcript(chain, layer.name), prior)
    if not fit.is_used:
        return None
    old = [phone for run in spoken for phone in run]
    new = [phone for phone in fit.phones if phone.name != SILENCE]
    anchors, k = _edges(old, new), 0
    runs = []
    for run in spoken:
        runs += [anchors[2 * k], anchors[2 * (k + len(run)) - 1]]
        k += len(run)
    return _rising(anchors, runs)


def _spoken(layer: Layer) -> list[tuple[str, float, float]]:
    """The layer's phones but silence, with their first and last second."""
    found, start = [], 0.0
    for name, length in layer.phones:
        end = start + length / PHONE_RATE
        if name != SILENCE and name in PHONES:
            found.append((name, start, end))
        start = end
    return found


def _edges(
    old: Sequence[tuple[str, float, float]], new: "Sequence[FittedWord | KnownPhone]"
) -> list[Anchor]:
    """Old and new seconds of the first and last moments of words or phones."""
    return [
        pair
        for (_, start, end), other in zip(old, new, strict=True)
        for pair in ((start, other.start), (end, other.end))
    ]


def _rising(anchors: Sequence[Anchor], words: Sequence[Anchor]) -> Times:
    """Anchors of `_edges`, both rising, and where words begin and end, whose edges are given.

    A moment has two new times where a pause is there now.
    """
    rounded, edges = (np.round(np.array(given, float), 3) for given in (anchors, words))
    old, new = np.unique(rounded, axis=0).T
    begins, ends = (
        np.isin(old + 1j * new, part[:, 0] + 1j * part[:, 1]) for part in (edges[::2], edges[1::2])
    )
    return Times(old, np.maximum.accumulate(new), begins, ends)


def unused_notes(layers: Sequence[Layer], curves: RigCurves) -> Iterator[str]:
    """A line on what of layers changes nothing in curves."""
    if empty := [layer.name or "without a name" for layer in layers if not layer.edits]:
        yield f"nothing is changed by layers that hold no edits: {listed(empty)}"
    edits = [edit for layer in layers if not layer.muted for edit in layer.edits]
    of_head = dict.fromkeys(edit.target for edit in edits if edit.target in HEAD_TARGETS)
    if of_head and curves.head is None:
        yield f"edits of {listed(list(of_head))} are not used: the head does not move here"
    outside = (max(edit.span[1] - curves.duration, -edit.span[0]) for edit in edits)
    beyond = dict.fromkeys(
        edit.target
        for edit, seconds in zip(edits, outside, strict=True)
        if seconds > BEYOND_SECONDS
    )
    if beyond:
        yield (
            f"edits of {listed(list(beyond))} reach beyond the recording, which lasts "
            f"{curves.duration:.1f} s: what is outside of it is not used"
        )
