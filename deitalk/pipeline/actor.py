"""Measure the usual voice of an actor from recordings: ``deitalk actor build``."""

from collections.abc import Callable, Iterable
from dataclasses import asdict

import numpy as np

from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.load import Recording
from deitalk.emotions.actor import ActorReference
from deitalk.errors import AudioError
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.life.traits import Seeds, Traits


def measure_actor(
    recordings: Iterable[Audio], progress: Callable[[int], None] = lambda done: None
) -> ActorReference:
    """Median strength of an actor's recordings; those without voice are left out.

    Parameters
    ----------
    recordings : iterable of path, bytes, file object or Recording
        Of one actor, of several moods or of the usual one; the microphone and its gain do not
        matter.
    progress : callable
        Called with the number of recordings that are done.

    Raises
    ------
    AudioError
        If one cannot be read, or none holds a voice.
    """
    measured = []
    for number, audio in enumerate(recordings, 1):
        recording = recording_of(audio)
        measured.append((voice_strength(recording), recording.duration))
        progress(number)
    return reference_of(measured)


def voice_strength(recording: Recording) -> float | None:
    """Strength of a recording's voice, dB above the usual; None without voice."""
    speech = Speech.of_recording(recording)
    return speech.strength if speech.prosody.voiced.any() else None


def reference_of(measured: Iterable[tuple[float | None, float]]) -> ActorReference:
    """Reference of an actor from the strength and the seconds of each recording.

    The traits of the actor's motion are drawn from them: equal recordings give equal traits.

    Raises
    ------
    AudioError
        If no recording holds a voice.
    """
    voiced = [(strength, seconds) for strength, seconds in measured if strength is not None]
    if not voiced:
        raise AudioError("no voice in the recordings of the actor; give some with speech")
    strengths, lengths = zip(*voiced, strict=True)
    facts = np.array([*strengths, *lengths]) / 1000
    seeds = Seeds.of(facts.astype(np.float32), "", 0)
    traits = asdict(Traits.of(seeds.character()))
    return ActorReference(float(np.median(strengths)), len(voiced), sum(lengths), traits)
