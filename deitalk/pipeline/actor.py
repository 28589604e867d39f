"""Measure the usual voice of an actor from recordings: ``deitalk actor build``."""

from collections.abc import Callable, Iterable

import numpy as np

from deitalk.audio.arrays import Audio, recording_of
from deitalk.emotions.actor import ActorReference
from deitalk.errors import AudioError
from deitalk.pipeline.speech import Speech


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
    strengths, seconds = [], 0.0
    for number, audio in enumerate(recordings, 1):
        recording = recording_of(audio)
        speech = Speech.of(recording.waveform)
        if speech.prosody.voiced.any():
            strengths.append(speech.strength)
            seconds += recording.duration
        progress(number)
    if not strengths:
        raise AudioError("no voice in the recordings of the actor; give some with speech")
    return ActorReference(float(np.median(strengths)), len(strengths), seconds)
