"""Usual voice of an actor, measured from recordings: ``deitalk data voice``."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.load import Recording
from deitalk.emotions import EMOTIONS
from deitalk.emotions.actor import ActorReference
from deitalk.errors import AudioError
from deitalk.models.load import load_network
from deitalk.models.protocol import CurveNetwork
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.life.character import Seeds, Traits


class MeasuredVoice(NamedTuple):
    """Strength of a recording's voice."""

    strength: float | None
    """Strength by the prosody, dB above the usual; None without voice."""
    effort: float | None
    """Effort by the network's readout, dB; None without voice or without one."""
    seconds: float


def measure_actor(
    recordings: Iterable[Audio],
    progress: Callable[[int], None] = lambda done: None,
    *,
    model: str | Path | CurveNetwork = "default",
    traits: Mapping[str, float] | None = None,
) -> ActorReference:
    """Median strength of an actor's recordings; those without voice are left out.

    Parameters
    ----------
    recordings : iterable of path, bytes, file object or Recording
        Of one actor, of several moods or of the usual one; the microphone and its gain do not
        matter.
    progress : callable
        Called with the number of recordings that are done.
    model : str, Path or CurveNetwork
        The model whose takes count from it.
    traits : mapping of str to float, optional
        Those measured on captured takes (`deitalk.data.captures.traits.measure_traits`); the others
        are drawn. With them there may be no recordings: the usual strength is 0 then.

    Raises
    ------
    AudioError
        If one cannot be read, or none holds a voice.
    CheckpointError
        If there is no such model.
    """
    measured: list[MeasuredVoice] = []
    network: CurveNetwork | None = None
    for number, audio in enumerate(recordings, 1):
        network = network or load_network(model)
        measured.append(measure_voice(recording_of(audio), network))
        progress(number)
    return reference_of(measured, traits)


def measure_voice(recording: Recording, network: CurveNetwork) -> MeasuredVoice:
    """Strength of a recording's voice, as takes of a network are measured."""
    speech = Speech.of_recording(recording)
    if not speech.prosody.voiced.any():
        return MeasuredVoice(None, None, recording.duration)
    weights = np.zeros((speech.n_frames, len(EMOTIONS)), np.float32)
    weights[:, 0] = 1
    effort = network.read(speech.waveform, weights, gain=speech.gain).tracks.effort
    speaking = speech.activity > 0
    if effort is None or not speaking.any():
        return MeasuredVoice(speech.strength, None, recording.duration)
    return MeasuredVoice(speech.strength, float(effort[speaking].mean()), recording.duration)


def reference_of(
    measured: Sequence[MeasuredVoice], traits: Mapping[str, float] | None = None
) -> ActorReference:
    """Reference of an actor from the voices of recordings.

    Traits of the actor's motion that are not given are drawn from them: equal recordings give
    equal traits.

    Raises
    ------
    AudioError
        If no recording holds a voice, and none with no traits.
    """
    voiced = [voice for voice in measured if voice.strength is not None]
    if not voiced and (measured or not traits):
        raise AudioError("no voice in the recordings of the actor; give some with speech")
    strengths, seconds = [voice.strength for voice in voiced], [voice.seconds for voice in voiced]
    efforts = [voice.effort for voice in voiced if voice.effort is not None]
    given = dict(traits or {})
    facts = np.array([*strengths, *seconds] or list(given.values()), float) / 1000
    drawn = asdict(Traits.of(Seeds.of(facts.astype(np.float32), "", 0).character()))
    strength = float(np.median(np.array(strengths, float))) if voiced else 0.0
    effort = float(np.median(efforts)) if efforts else None
    return ActorReference(strength, len(voiced), sum(seconds), drawn | given, effort)
