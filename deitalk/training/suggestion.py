"""Fit of `deitalk.pipeline.suggest`; ``python -m deitalk.training.suggestion``.

Labels are what raters named from the voice alone (CREMA-D's ``voice_vote``), of clips with a
majority for neutral, anger, joy or sadness; readers are neutral. Classes, and actors against
readers, are weighted alike. Multinomial logistic regression with a Gaussian prior. Whole speakers
are divided as in `deitalk.data.strength_clips`.

The command prints scores of the validation speakers, or with ``--split test`` of the test speakers:
recall of every class, their mean (unweighted recall, chance .25), anger against sadness, the share
of readers suggested as neutral, and how probable suggestions are against how often they are right.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from safetensors.numpy import save_file
from torch.nn import functional as F

from deitalk.audio.load import load_audio
from deitalk.data.strength_clips import ACTORS, READERS, StrengthClip, read_strength_clips
from deitalk.errors import DataError, DeitalkError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.suggest import (
    FEWEST_FRAMES,
    MODEL,
    NAMED,
    SURE,
    EmotionMap,
    pooled,
    speech_features,
)
from rig.arrays import Float32, Int64
from rig.files import atomic_write

VOTES = {"N": 0, "A": 1, "H": 2, "S": 3}
"""CREMA-D's letters of a majority, and places in `NAMED`."""
PRIOR = 0.05
"""Weight of the squared map, per example."""
STEPS = 200
READERS_WEIGHT = 0.3
"""Weight of all readers over that of all actors."""
LONGEST_SECONDS = 6.0
"""Of a reader's recording; actors speak two seconds."""


class Voices(NamedTuple):
    """Recordings, their classes and where they are from."""

    features: Float32
    """[shape=(N, 2 D)]."""
    classes: Int64
    splits: list[str]
    are_readers: list[bool]


def read_voices(actors: Path, readers: Sequence[Path], every: int = 4) -> Voices:
    """Measure actors with a clear vote, and every `every`-th recording of the readers.

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
    wanted: list[tuple[StrengthClip, int]] = []
    for clip in read_strength_clips(actors, ACTORS):
        vote = votes[str(clip.path.relative_to(actors.parent))]
        if vote in VOTES:
            wanted.append((clip, VOTES[vote]))
    for path in readers:
        wanted += [(clip, 0) for clip in read_strength_clips(path, READERS)[::every]]
    rows, classes, splits, kinds = [], [], [], []
    for clip, number in wanted:
        features = _measure(network, clip)
        if features is not None:
            rows.append(features)
            classes.append(number)
            splits.append(clip.split)
            kinds.append(clip.kind == READERS)
    return Voices(np.stack(rows), np.array(classes, np.int64), splits, kinds)


def _measure(network: DEITalk, clip: StrengthClip) -> Float32 | None:
    waveform = load_audio(clip.path).waveform
    if clip.kind == READERS:
        waveform = waveform[: int(16_000 * LONGEST_SECONDS)]
    features, speaking = speech_features(network, Speech.of(waveform))
    return pooled(features, speaking) if speaking.sum() >= FEWEST_FRAMES else None


def fit(voices: Voices) -> EmotionMap:
    """Fit the map to the training speakers.

    Raises
    ------
    DataError
        If a class has no example.
    """
    chosen = np.array([split == "train" for split in voices.splits])
    x, y = voices.features[chosen], voices.classes[chosen]
    reader = np.array(voices.are_readers)[chosen]
    counts = np.bincount(y[~reader], minlength=len(NAMED))
    if not counts.all():
        raise DataError(f"no training actor was named {NAMED[int(counts.argmin())]}")
    weights = np.where(reader, READERS_WEIGHT / max(reader.sum(), 1), 1 / (len(NAMED) * counts[y]))
    mean, spread = x.mean(axis=0), x.std(axis=0) + 1e-6
    inputs, targets = torch.tensor((x - mean) / spread), torch.tensor(y)
    share = torch.tensor(weights / weights.sum(), dtype=torch.float32)
    layer = torch.nn.Linear(x.shape[1], len(NAMED))
    torch.nn.init.zeros_(layer.weight)
    torch.nn.init.zeros_(layer.bias)
    optimiser = torch.optim.LBFGS(layer.parameters(), max_iter=STEPS, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
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


def score(found: EmotionMap, voices: Voices, split: str) -> dict[str, float]:
    """Scores of the speakers of a split.

    Returns
    -------
    dict
        ``recall NAME`` of the most probable class of actors, ``unweighted recall``, ``anger
        against sadness``; ``suggested`` and ``right``: of actors, share with a suggestion other
        than neutral, and of these the share that raters named so; ``probability`` of these
        suggestions, mean; ``readers neutral``.
    """
    chosen = np.array([name == split for name in voices.splits])
    reader = np.array(voices.are_readers)[chosen]
    p = np.stack([found.probabilities(row) for row in voices.features[chosen]])
    y = voices.classes[chosen]
    best = p.argmax(axis=1)
    suggested = np.where(p.max(axis=1) >= SURE, best, 0)
    acted, named = ~reader, (~reader) & (suggested > 0)
    recalls = {f"recall {name}": _mean(best[acted & (y == k)] == k) for k, name in enumerate(NAMED)}
    both = acted & np.isin(y, (1, 3))
    return recalls | {
        "unweighted recall": float(np.mean(list(recalls.values()))),
        "anger against sadness": _mean((p[both, 1] > p[both, 3]) == (y[both] == 1)),
        "suggested": float(named.sum() / acted.sum()),
        "right": _mean(suggested[named] == y[named]),
        "probability": _mean(p[named].max(axis=1)),
        "readers neutral": _mean(suggested[reader] == 0),
        "actors' clips": int(acted.sum()),
        "readers' clips": int(reader.sum()),
    }


def _mean(values: NDArray[Any]) -> float:
    """Mean; NaN of nothing."""
    return float(values.mean()) if len(values) else float("nan")


def main() -> int:
    """Fit, print the scores, and write the map."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--actors", type=Path, required=True, help="CREMA-D's table with votes")
    parser.add_argument("--readers", type=Path, action="append", default=[], help="path, speaker")
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("-o", "--out", type=Path, help=".safetensors to write")
    options = parser.parse_args()
    try:
        voices = read_voices(options.actors, options.readers)
        found = fit(voices)
    except DeitalkError as error:
        sys.stderr.write(f"deitalk: {error}\n")
        return 1
    for name, value in score(found, voices, options.split).items():
        sys.stdout.write(f"{name}: {value:.3g}\n")
    if options.out is not None:
        with atomic_write(options.out) as beside:
            save_file({k: v.astype(np.float32) for k, v in found.weights.items()}, beside)
    return 0


if __name__ == "__main__":
    sys.exit(main())
