"""Fit of `deitalk.pipeline.suggest`; ``python -m deitalk.research.training.suggestion``.

The truth is the emotion asked of the actor (CREMA-D); readers are neutral. The share of the target
that is not `ASKED` is what raters named from the voice alone (``voice_vote``). Ties count
for each of their emotions, and clips without a majority for one of `NAMED` with `UNSURE_WEIGHT`.
Classes, and actors against readers, are weighted alike. Multinomial
logistic regression with a Gaussian prior.

Whole speakers are divided as in `deitalk.research.evaluation.acted`. Training and validation
speakers are fitted together; their scores are those of five fits, each to four fifths of these
speakers and scored on the rest. One temperature makes those probabilities true (Guo et al. 2017).

The command prints the scores of these speakers, and with ``--split test`` also those of the test
speakers: recall of every class, their mean (unweighted recall, chance .25), anger against sadness,
the share of readers suggested as neutral, and how probable suggestions are against how often they
are right.
"""

import argparse
import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from safetensors.numpy import save_file
from torch import Tensor
from torch.nn import functional as F

from deitalk.audio.load import load_audio
from deitalk.errors import DataError, DeitalkError
from deitalk.evaluation.report import table
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.suggest import MODEL, NAMED, SURE, EmotionMap, VoiceFrames, standardised
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.acted import (
    ACTORS,
    READERS,
    StrengthClip,
    read_strength_clips,
)
from deitalk.research.evaluation.report import identified, write_json
from rig.arrays import Bool, Float32, Float64, Int64
from rig.files import atomic_write

VOTES = {"N": 0, "A": 1, "H": 2, "S": 3}
"""CREMA-D's letters of a vote, and places in `NAMED`."""
EMOTIONS_ASKED = {"NEU": 0, "ANG": 1, "HAP": 2, "SAD": 3}
ASKED, UNSURE_WEIGHT = 1.0, 0.7
"""Share of the emotion asked in a target; weight of clips without a majority for one of `NAMED`."""
PRIOR = 0.07
"""Weight of the squared map."""
STEPS = 120
READERS_WEIGHT = 0.3
"""Weight of all readers over that of all actors."""
LONGEST_SECONDS = 4.0
"""Of a reader's recording; actors speak two seconds, and a window of the track has three."""
FOLDS = 5
BINS = 10
"""Of probabilities, in the calibration error."""
TEST = "test"


class Label(NamedTuple):
    """What a recording counts as."""

    majority: int
    """Place in `NAMED`; -1 without a majority for one of them."""
    shares: tuple[float, ...]
    """Of each of `NAMED` in the fit; they sum to 1."""
    weight: float
    asked: int
    """Place in `NAMED` of what was asked of the actor; -1 if it is none of them."""


NEUTRAL_LABEL = Label(0, (1.0, 0.0, 0.0, 0.0), 1.0, 0)


class Voices(NamedTuple):
    """Recordings, their classes and where they are from; N of them."""

    numbers: Float32
    """From `VoiceFrames.numbers` [shape=(N, 2 D + M)]."""
    labels: list[Label]
    speakers: list[str]
    splits: list[str]
    are_readers: list[bool]

    @property
    def majorities(self) -> Int64:
        """Places in `NAMED`, or -1 [shape=(N,)]."""
        return np.array([label.majority for label in self.labels], np.int64)

    @property
    def asked(self) -> Int64:
        """Places in `NAMED` of the emotion asked, or -1 [shape=(N,)]."""
        return np.array([label.asked for label in self.labels], np.int64)

    @property
    def is_reader(self) -> Bool:
        """As an array [shape=(N,)]."""
        return np.array(self.are_readers)

    def having(self, split: str) -> Bool:
        """Test speakers, or with another word all that are fitted [shape=(N,)]."""
        return np.array([(name == TEST) == (split == TEST) for name in self.splits])

    @property
    def folds(self) -> Int64:
        """Fold of each recording's speaker [shape=(N,)]."""
        return np.array([_fold(name) for name in self.speakers], np.int64)


def _fold(speaker: str) -> int:
    return int(hashlib.md5(f"f{speaker}".encode()).hexdigest(), 16) % FOLDS


def label_of(vote: str, asked: str) -> Label | None:
    """Label of an actor's clip; None if neither the vote nor the emotion asked is in `NAMED`.

    Parameters
    ----------
    vote : str
        Letters that most raters named, parted by colons where there is a tie.
    asked : str
        Emotion asked of the actor.
    """
    letters = vote.split(":")
    named = [VOTES[letter] for letter in letters if letter in VOTES]
    place = EMOTIONS_ASKED.get(asked)
    shares = np.zeros(len(NAMED))
    if named:
        shares[named] = 1 / len(named)
        weight = 1.0 if len(letters) == 1 else UNSURE_WEIGHT * len(named) / len(letters)
    elif place is not None:
        shares[place], weight = 1, UNSURE_WEIGHT
    else:
        return None
    if place is not None:
        shares *= 1 - ASKED
        shares[place] += ASKED
    majority = named[0] if len(letters) == len(named) == 1 else -1
    return Label(majority, tuple(shares.tolist()), weight, -1 if place is None else place)


def read_voices(
    actors: Path, readers: Sequence[Path], split: str = "validation", every: int = 4
) -> Voices:
    """Measure actors, and every `every`-th recording of the readers.

    Test speakers are left out unless the split is ``test``.

    Raises
    ------
    DataError
        If a table is not as described, or names no vote.
    """
    network = require_model(MODEL, DEITalk)
    table = pd.read_csv(actors, dtype=str, keep_default_na=False)
    if "voice_vote" not in table.columns:
        raise DataError(f"{actors}: lacks the column voice_vote")
    votes = dict(zip(table["clip"], table["voice_vote"], strict=True))
    wanted: list[tuple[StrengthClip, Label]] = []
    for clip in read_strength_clips(actors, ACTORS):
        label = label_of(votes[str(clip.path.relative_to(actors.parent))], clip.emotion)
        wanted += [(clip, label)] if label is not None else []
    for path in readers:
        wanted += [(clip, NEUTRAL_LABEL) for clip in read_strength_clips(path, READERS)[::every]]
    wanted = [(clip, label) for clip, label in wanted if split == TEST or clip.split != TEST]
    rows = [(_measure(network, clip), clip, label) for clip, label in wanted]
    known = [(numbers, clip, label) for numbers, clip, label in rows if numbers is not None]
    return Voices(
        np.stack([numbers for numbers, _, _ in known]),
        [label for _, _, label in known],
        [clip.speaker for _, clip, _ in known],
        [clip.split for _, clip, _ in known],
        [clip.kind == READERS for _, clip, _ in known],
    )


def _measure(network: DEITalk, clip: StrengthClip) -> Float32 | None:
    waveform = load_audio(clip.path).waveform
    if clip.kind == READERS:
        waveform = waveform[: int(16_000 * LONGEST_SECONDS)]
    frames = VoiceFrames.of(network, Speech.of(waveform))
    return frames.numbers() if frames.is_enough else None


def fit(voices: Voices, chosen: Bool) -> EmotionMap:
    """Fit the map to some of the recordings.

    Raises
    ------
    DataError
        If a class has no example among the actors.
    """
    x = voices.numbers[chosen]
    shares = np.array([label.shares for label in voices.labels])[chosen]
    weights = _weights(voices, chosen, shares)
    mean, spread = x.mean(axis=0), x.std(axis=0) + 1e-6
    inputs = torch.tensor(standardised(x, mean, spread), dtype=torch.float32)
    targets, share = (torch.tensor(a, dtype=torch.float32) for a in (shares, weights))
    layer = torch.nn.Linear(x.shape[1], len(NAMED))
    torch.nn.init.zeros_(layer.weight)
    torch.nn.init.zeros_(layer.bias)
    optimiser = torch.optim.LBFGS(layer.parameters(), max_iter=STEPS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        error = (share * F.cross_entropy(layer(inputs), targets, reduction="none")).sum()
        error = error + PRIOR * layer.weight.square().sum()
        error.backward()  # type: ignore[no-untyped-call]
        return error

    optimiser.step(loss)  # type: ignore[no-untyped-call]
    return EmotionMap(
        {
            "mean": mean,
            "spread": spread,
            "weight": layer.weight.detach().numpy().copy(),
            "bias": layer.bias.detach().numpy().copy(),
        }
    )


def _weights(voices: Voices, chosen: Bool, shares: Float64) -> Float64:
    """Weight of each recording: classes of actors alike, readers together `READERS_WEIGHT`."""
    reader = voices.is_reader[chosen]
    plain = np.array([label.weight for label in voices.labels])[chosen]
    mass = (shares * (plain * ~reader)[:, None]).sum(axis=0)
    if not mass.all():
        raise DataError(f"no actor to fit was named {NAMED[int(mass.argmin())]}")
    acted = plain * ~reader * (shares / mass).sum(axis=1)
    weights = acted / acted.sum() + READERS_WEIGHT * reader / max(reader.sum(), 1)
    return np.asarray(weights / weights.sum(), np.float64)


def cross_validate(voices: Voices) -> tuple[Float64, float]:
    """Probabilities of speakers that a fit did not have, and the temperature that makes them true.

    Returns
    -------
    probabilities : array [shape=(N, 4)]
        At the temperature; NaN for test speakers.
    temperature : float
    """
    fitted = voices.having("validation")
    raw = np.full((len(voices.labels), len(NAMED)), np.nan)
    for fold in range(FOLDS):
        held = fitted & (voices.folds == fold)
        if held.any():
            raw[held] = predict(fit(voices, fitted & (voices.folds != fold)), voices.numbers[held])
    actors = fitted & ~voices.is_reader & (voices.majorities >= 0)
    logs, truth = np.log(raw[actors] + 1e-12), voices.majorities[actors]
    counts = np.bincount(truth, minlength=len(NAMED))
    grid = np.geomspace(0.3, 3, 93).tolist()
    errors = [_log_loss(logs / temperature, truth, 1 / counts[truth]) for temperature in grid]
    best = float(grid[int(np.argmin(errors))])
    return _softmax(np.log(raw + 1e-12) / best), best


def _log_loss(scores: Float64, truth: Int64, weights: Float64) -> float:
    right = np.log(_softmax(scores)[np.arange(len(truth)), truth])
    return float(-(right * weights).sum() / weights.sum())


def _softmax(scores: Float64) -> Float64:
    odds = np.exp(scores - scores.max(axis=1, keepdims=True))
    return np.asarray(odds / odds.sum(axis=1, keepdims=True), np.float64)


def cooled(found: EmotionMap, temperature: float) -> EmotionMap:
    """The map with its scores divided by the temperature."""
    w = dict(found.weights)
    return EmotionMap(w | {name: w[name] / np.float32(temperature) for name in ("weight", "bias")})


def predict(found: EmotionMap, numbers: Float32) -> Float64:
    """Probabilities of recordings [shape=(N, 4)]."""
    return np.stack([found.probabilities(row) for row in numbers])


def score(p: Float64, voices: Voices, split: str) -> dict[str, float]:
    """Scores of probabilities (N, 4) on the speakers of a split.

    Returns
    -------
    dict
        ``recall NAME`` of the most probable class of actors, by what raters named, ``unweighted
        recall``, the same by the emotion asked (``asked``), ``anger against sadness``;
        ``calibration error``: of the most probable class, expected, classes weighted alike;
        ``suggested`` and ``right``: of actors, share with a suggestion other than neutral, and of
        these the share that raters named so; ``probability`` of these suggestions, mean;
        ``readers neutral``.
    """
    y, reader, held = voices.majorities, voices.is_reader, voices.having(split)
    acted, read = held & ~reader & (y >= 0), held & reader
    asked = held & ~reader & (voices.asked >= 0)
    best = p.argmax(axis=1)
    suggested = np.where(p.max(axis=1) >= SURE, best, 0)
    named = acted & (suggested > 0)
    recalls = {f"recall {name}": _mean(best[acted & (y == k)] == k) for k, name in enumerate(NAMED)}
    both = acted & np.isin(y, (1, 3))
    return recalls | {
        "unweighted recall": float(np.mean(list(recalls.values()))),
        "unweighted recall, asked": float(
            np.mean([_mean(best[asked & (voices.asked == k)] == k) for k in range(len(NAMED))])
        ),
        "anger against sadness": _mean((p[both, 1] > p[both, 3]) == (y[both] == 1)),
        "calibration error": _calibration_error(p[acted], y[acted]),
        "suggested": float(named.sum() / acted.sum()),
        "right": _mean(suggested[named] == y[named]),
        "probability": _mean(p[named].max(axis=1)),
        "readers neutral": _mean(suggested[read] == 0),
        "actors' clips": int(acted.sum()),
        "readers' clips": int(read.sum()),
    }


def _calibration_error(p: Float64, truth: Int64) -> float:
    """Mean distance of probability and frequency over `BINS` bins, classes weighted alike."""
    weights = 1 / np.bincount(truth, minlength=len(NAMED))[truth]
    weights = weights / weights.sum()
    sure, right = p.max(axis=1), p.argmax(axis=1) == truth
    bins = np.minimum((sure * BINS).astype(int), BINS - 1)
    return float(np.abs(np.bincount(bins, weights * (right - sure))).sum())


def _mean(values: NDArray[Any]) -> float:
    """Mean; NaN of nothing."""
    return float(values.mean()) if len(values) else float("nan")


def main() -> int:
    """Fit, print the scores, and write the map."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--actors", type=Path, required=True, help="CREMA-D's table with votes")
    parser.add_argument("--readers", type=Path, action="append", default=[], help="path, speaker")
    parser.add_argument("--split", choices=("validation", TEST), default="validation")
    parser.add_argument("--json", type=new_file, help="also write the scores to this file")
    parser.add_argument("-o", "--out", type=new_file, help=".safetensors to write")
    options = parser.parse_args()
    try:
        voices = read_voices(options.actors, options.readers, options.split)
        p, temperature = cross_validate(voices)
        found = cooled(fit(voices, voices.having("validation")), temperature)
    except DeitalkError as error:
        sys.stderr.write(f"deitalk: {error}\n")
        return 1
    scores = {"cross-validation": score(p, voices, "validation")}
    if options.split == TEST:
        scores[TEST] = score(predict(found, voices.numbers), voices, TEST)
    sys.stdout.write("\n".join(table("", scores)) + "\n")
    write_json(options.json, identified(MODEL) | scores)
    if options.out is not None:
        with atomic_write(options.out) as beside:
            save_file({k: v.astype(np.float32) for k, v in found.weights.items()}, beside)
    return 0


if __name__ == "__main__":
    sys.exit(main())
