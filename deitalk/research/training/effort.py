"""Readout of the voice's strength from the speech encoder: run it by ``python -m`` and its name.

A ridge regression on the mean over speech of the features of a model's frozen encoder. Its rows
are differences that no rule of this project made: of an actor's takes of one emotion asked for at
two strengths (1 between low and high), alone, with other noise and equalisation, and in one
recording; and of pieces of a reader's chapter, whose level is known. A take and its noisy copy
should differ by nothing.

The result is in dB, and 0 half-way between the mean reader and the mean neutral take; ``-o``
writes a model's ``effort.safetensors``.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.random import Generator
from safetensors.torch import save_file
from scipy.signal import firwin2, lfilter

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import normalise_level, speech_activity
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import EFFORT_WEIGHTS
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.acted import JOINED as JOINED_GAINS
from deitalk.research.evaluation.acted import acted_order, joined_takes
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    LEVELS,
    NEUTRAL,
    READERS,
    StrengthClip,
    read_strength_clips,
)
from rig.arrays import Bool, Float32, Float64
from rig.files import atomic_write

PIECE, FEWEST = 60, 25
"""Frames of a reader's piece, and of speech in it."""
STEPS = {("HI", "LO"): (1.0, 1.0), ("HI", "MD"): (0.7, 0.6), ("MD", "LO"): (0.7, 0.6)}
"""Weight and target of each pair of strengths."""
CLEAR, UNCLEAR = ("ANG", "HAP"), 0.6
"""Emotions whose strength is clear in the voice, and the weight of others."""
JOINED_EMOTIONS = (*CLEAR, "SAD")
STEP_DB = 16.0
"""Decibels between low and high; with the penalty the step of anger is that of
`deitalk.audio.vocal_strength`, 12 dB."""
RIDGE, NUISANCE, READING, JOINED = 2000.0, 1.0, 0.05, 0.3
"""Penalties on the weights and on changes by noise, weights of the readers' pieces and of takes in
one recording; chosen by nine folds over the actors that are not for tests."""


class Heard(NamedTuple):
    """A recording's features: means over speech [shape=(D,)]."""

    clip: StrengthClip
    mean: Float64
    noisy: Float64 | None = None
    """The same of a copy with noise: actors' recordings alone."""
    pieces: Sequence[tuple[Float64, float]] = ()
    """Means of pieces of a reader's recording, and their levels in dB."""
    recording: str = ""
    """Name of the recording that joins the take with others of the actor and emotion."""


@torch.inference_mode()
def hear(model: DEITalk, clip: StrengthClip, rng: Generator) -> Heard:
    """Features of one recording, and of a noisy copy of an actor's."""
    sound = load_audio(clip.path).waveform
    speaking = _speaking(sound)
    rows = _features(model, sound, len(speaking))
    mean = rows[speaking].mean(axis=0)
    if clip.kind == READERS:
        return Heard(clip, mean, pieces=_pieces(rows, sound, speaking))
    copy = _features(model, _changed(sound, rng), len(speaking))
    return Heard(clip, mean, copy[speaking].mean(axis=0))


@torch.inference_mode()
def hear_joined(model: DEITalk, clips: Sequence[StrengthClip]) -> Iterator[Heard]:
    """Features of the takes of an actor and emotion within one recording, at two gains each."""
    takes: dict[tuple[str, str], dict[str, StrengthClip]] = defaultdict(dict)
    for clip in clips:
        if clip.level in LEVELS:
            takes[clip.speaker, clip.emotion][clip.level] = clip
    for own in takes.values():
        for name, is_levelled in JOINED_GAINS.items():
            sound, spans = joined_takes(own, is_levelled)
            speaking = _speaking(sound)
            rows = _features(model, sound, len(speaking))
            times = np.arange(len(rows)) * SAMPLE_RATE / FRAME_RATE
            for level, (first, last) in spans.items():
                inside = speaking & (times >= first) & (times < last)
                if inside.any():
                    yield Heard(own[level], rows[inside].mean(axis=0), recording=name)


def _speaking(sound: Float32) -> Bool:
    activity = speech_activity(sound)
    return activity > 0 if (activity > 0).sum() >= 3 else np.ones(len(activity), bool)


def _features(model: DEITalk, sound: Float32, n_frames: int) -> Float64:
    encoded = model.frontend.encode(torch.from_numpy(normalise_level(sound)), n_frames)
    return np.asarray(encoded.numpy(), np.float64)


def _pieces(rows: Float64, sound: Float32, speaking: Bool) -> list[tuple[Float64, float]]:
    level = measure_prosody(sound, len(rows)).level
    starts = range(0, len(rows) - FEWEST, PIECE)
    spoken = [np.flatnonzero(speaking[k : k + PIECE]) + k for k in starts]
    return [(rows[i].mean(axis=0), float(level[i].mean())) for i in spoken if len(i) >= FEWEST]


def _changed(sound: Float32, rng: Generator) -> Float32:
    """With another equalisation, and noise 12 to 45 dB below."""
    place = np.linspace(0, 1, 9)
    gain_db = rng.normal(0, 6) * (place - 0.5)
    gain_db = gain_db + sum(rng.normal(0, 2) * np.cos(np.pi * k * place) for k in (1, 2, 3))
    changed = lfilter(firwin2(129, place, 10 ** (gain_db / 20)), [1.0], sound.astype(np.float64))
    noise = np.convolve(rng.standard_normal(len(sound)), [1, 0.7, 0.4, 0.2], "same")
    power = np.mean(changed**2) / 10 ** (rng.uniform(1.2, 4.5)) / np.mean(noise**2)
    return np.asarray(changed + np.sqrt(power) * noise, np.float32)


Row = tuple[Float64, float, float]
"""Difference of features, what it should give in steps, and its weight."""


def fit(heard: Sequence[Heard], ridge: float = RIDGE) -> tuple[Float64, float]:
    """Weights (D,) and offset of the readout, dB."""
    alone = [one for one in heard if not one.recording]
    scale = np.std([one.mean for one in alone], axis=0) + 1e-3
    acted = [one for one in heard if one.clip.kind == ACTORS]
    differences: list[Row] = [
        (one.noisy - one.mean, 0.0, NUISANCE) for one in acted if one.noisy is not None
    ]
    differences += [*_between_takes(acted), *_within_chapters(heard)]
    rows, targets, weights = (np.array(part) for part in zip(*differences, strict=True))
    rows = rows / scale
    normal = (rows * weights[:, None]).T @ rows + ridge * np.eye(len(scale))
    readout = STEP_DB * np.linalg.solve(normal, rows.T @ (weights * targets)) / scale
    readers = [one.mean @ readout for one in heard if one.clip.kind == READERS]
    neutral = [one.mean @ readout for one in acted if one.clip.emotion == NEUTRAL] or readers
    return readout, -float(np.mean(readers) + np.mean(neutral)) / 2


def _between_takes(acted: Sequence[Heard]) -> Iterator[Row]:
    takes: dict[tuple[str, str, str], dict[str, Heard]] = defaultdict(dict)
    for one in acted:
        takes[one.clip.speaker, one.clip.emotion, one.recording][one.clip.level] = one
    for (_, emotion, recording), levels in takes.items():
        clear = (1.0 if emotion in CLEAR else UNCLEAR) * (JOINED if recording else 0.5)
        for (upper, lower), (weight, target) in STEPS.items():
            if upper in levels and lower in levels:
                high, low = levels[upper], levels[lower]
                yield high.mean - low.mean, target, weight * clear
                if high.noisy is not None and low.noisy is not None:
                    yield high.noisy - low.noisy, target, weight * clear


def _within_chapters(heard: Sequence[Heard]) -> Iterator[Row]:
    chapters: dict[str, list[tuple[Float64, float]]] = defaultdict(list)
    for one in heard:
        chapters[one.clip.group] += one.pieces
    for pieces in filter(None, chapters.values()):
        middle = np.mean([mean for mean, _ in pieces], axis=0)
        usual = float(np.mean([level for _, level in pieces]))
        for mean, level in pieces:
            yield mean - middle, (level - usual) / STEP_DB, READING


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring."""
    parser = argparse.ArgumentParser(prog="python -m deitalk.research.training.effort")
    parser.add_argument("--readers", type=Path, required=True, help="table of readers")
    parser.add_argument("--actors", type=Path, required=True, help="table of actors")
    parser.add_argument("--model", default="default", help="whose encoder: default or live")
    parser.add_argument("--folds", type=int, default=9, help="over actors, for the printed scores")
    parser.add_argument("-o", "--out", type=new_file, help="effort.safetensors")
    given = parser.parse_args(arguments)
    clips = read_strength_clips(given.readers, READERS) + read_strength_clips(given.actors, ACTORS)
    model, rng = load_model(given.model), np.random.default_rng(5)
    assert isinstance(model, DEITalk)
    clips = [clip for clip in clips if clip.split != "test"]
    heard = [hear(model, clip, rng) for clip in clips]
    heard += hear_joined(model, [clip for clip in clips if clip.emotion in JOINED_EMOTIONS])
    sys.stdout.write(_scores(heard, given.folds) + "\n")
    if given.out is not None:
        _write(given.out, *fit(heard))


def _scores(heard: Sequence[Heard], folds: int) -> str:
    """Order of the strengths of actors that the readout was not fitted on, by emotion."""
    actors = sorted({one.clip.speaker for one in heard if one.clip.kind == ACTORS})
    found: dict[str, dict[tuple[str, str, str], float]] = defaultdict(dict)
    for fold in range(folds):
        left = set(np.random.default_rng(0).permutation(actors)[fold::folds])
        weights, _ = fit([one for one in heard if one.clip.speaker not in left])
        for one in heard:
            if one.clip.speaker in left and one.clip.level in LEVELS:
                key = one.clip.speaker, one.clip.emotion, one.clip.level
                found[one.recording or "alone"][key] = float(one.mean @ weights)
    return "\n".join(
        f"{recording}, {emotion}: {acted_order(values, (emotion,))}"
        for recording, values in found.items()
        for emotion in sorted({key[1] for key in values})
    )


def _write(path: Path, weights: Float64, offset: float) -> None:
    state = {"weight": torch.tensor(weights)[None].float(), "bias": torch.tensor([offset]).float()}
    with atomic_write(path) as beside:
        save_file({EFFORT_WEIGHTS + name: value for name, value in state.items()}, beside)


if __name__ == "__main__":
    main()
