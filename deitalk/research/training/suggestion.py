"""Fit of `deitalk.pipeline.suggest`; ``python -m deitalk.research.training.suggestion``.

The truth is the emotion asked of the actor (CREMA-D); readers are neutral. Every recording is read
as it is and in altered copies: other size of voice and rate, microphone, room, noise, codec and
level.

Multinomial logistic regression. Besides the weights themselves two things that are no emotion cost:
answers to what alters a copy, and answers to what parts the readers' corpora from the actors'
neutral takes. Without the second a map learns the corpus: then strong joy from elsewhere is
neutral. Classes are weighted alike. `NEUTRAL_READERS` of the readers that a fit did not have are
neutral, by one number that is added to the score of neutral.

Whole speakers are divided as in `deitalk.research.evaluation.strength_clips`. Training and
validation speakers are fitted together; their scores are those of five fits, each to four fifths of
these speakers and scored on the rest. One temperature makes those probabilities true (Guo et al.
2017).

The command prints the scores of these speakers, with ``--judge`` those of another corpus, which is
never fitted nor written to the file of scores, and with ``--split test`` also those of the test
speakers: recall of every class, their mean (unweighted recall, chance .25), anger against sadness,
the share of readers suggested as neutral, and how probable suggestions are against how often they
are right. Baselines: the level of the speech, and ridge regression on the same numbers.
"""

import argparse
import hashlib
import io
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import soundfile
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from safetensors.numpy import save_file
from torch import Tensor
from torch.nn import functional as F

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.prosody import rms_db
from deitalk.data.augment_waveform import Surroundings, augment, change_speed
from deitalk.errors import DataError
from deitalk.evaluation.report import table
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.suggest import MODEL, NAMED, EmotionMap, VoiceFrames, standardised
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.evaluation.report import identified, write_json
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    READERS,
    StrengthClip,
    read_strength_clips,
)
from deitalk.research.training.surroundings import read_surroundings
from rig.arrays import Bool, Float32, Float64, Int64
from rig.files import atomic_write

PLACES = {
    "NEU": 0, "ANG": 1, "HAP": 2, "SAD": 3, "neutral": 0, "anger": 1, "happiness": 2, "sadness": 3,
} | {name: place for place, name in enumerate(NAMED)}  # fmt: skip
"""Names of emotions in tables, and their places in `NAMED`."""
COPIES = 2
"""Altered copies of an actor's recording; a reader's has one."""
SPEEDS = (0.85, 1.18)
"""Range of the speed of copies: pitch and formants change with it."""
CODED_SHARE = 0.4
CODECS = (
    ("MP3", "MPEG_LAYER_III"), ("OGG", "VORBIS"), ("OGG", "OPUS"), ("WAV", "ULAW"),
)  # fmt: skip
PRIOR, ALTERED, CORPUS = 0.02, 30.0, 1.0
"""Weight of the squared map; times it, of squared answers to alterations, and relative to these, to
a corpus of readers. Chosen on the folds and on another corpus."""
STEPS = 80
READERS_WEIGHT = 0.2
"""Weight of all readers over that of all actors."""
NEUTRAL_READERS = 0.965
LONGEST_SECONDS = 5.0
"""Length that is read of a reader's recording; actors speak two seconds, and a window of the track
has three."""
EVERY = 8
"""Step between the readers' recordings that are read."""
FOLDS = 5
BINS = 10
"""Bins of probabilities in the calibration error."""
TEST = "test"


class Voices(NamedTuple):
    """Recordings, their classes and where they are from; N of them."""

    numbers: Float32
    """From `VoiceFrames.numbers` [shape=(N, 2 D)]."""
    places: Int64
    """Place of the emotion asked, in `NAMED`; 0 of readers [shape=(N,)]."""
    speakers: list[str]
    splits: list[str]
    corpora: list[str]
    """Empty of actors, else the table of the readers."""
    originals: Int64
    """Row of the recording that this is a copy of; of a recording its own [shape=(N,)]."""
    levels: Float32
    """dB re full scale [shape=(N,)]."""

    @property
    def is_reader(self) -> Bool:
        """As an array [shape=(N,)]."""
        return np.array([bool(corpus) for corpus in self.corpora])

    @property
    def is_copy(self) -> Bool:
        """As an array [shape=(N,)]."""
        return np.asarray(self.originals != np.arange(len(self.originals)), bool)

    def having(self, split: str) -> Bool:
        """Test speakers, or with another word all that are fitted [shape=(N,)]."""
        return np.array([(name == TEST) == (split == TEST) for name in self.splits])

    @property
    def folds(self) -> Int64:
        """Fold of each recording's speaker [shape=(N,)]."""
        return np.array([_fold(name) for name in self.speakers], np.int64)


def _fold(speaker: str) -> int:
    return int(hashlib.md5(f"f{speaker}".encode()).hexdigest(), 16) % FOLDS


def read_voices(
    actors: Path,
    readers: Sequence[Path],
    surroundings: Surroundings = Surroundings(),
    split: str = "validation",
) -> Voices:
    """Measure actors and readers, and altered copies of those that are fitted.

    Test speakers are left out unless the split is ``test``.

    Raises
    ------
    DataError
        If a table is not as described, or names none of the emotions.
    """
    clips = [clip for clip in read_strength_clips(actors, ACTORS) if clip.emotion in PLACES]
    corpora = [""] * len(clips)
    for path in readers:
        read = read_strength_clips(path, READERS)[::EVERY]
        clips, corpora = clips + read, corpora + [str(path)] * len(read)
    if not any(clip.kind == ACTORS for clip in clips):
        raise DataError(f"{actors}: names none of {', '.join(PLACES)}")
    wanted = [
        (clip, corpus)
        for clip, corpus in zip(clips, corpora, strict=True)
        if split == TEST or clip.split != TEST
    ]
    network, own = require_model(MODEL, DEITalk), 0
    rows: list[tuple[Float32, StrengthClip, str, int, float]] = []
    for clip, corpus in wanted:
        found = list(_measured(network, clip, surroundings))
        for number, (row, level) in enumerate(found):
            rows.append((row, clip, corpus, own if number else len(rows), level))
            own = own if number else len(rows) - 1
    features, found_clips, corpora_of, originals, levels = zip(*rows, strict=True)
    return Voices(
        np.stack(features),
        np.array([PLACES.get(clip.emotion, 0) for clip in found_clips], np.int64),
        [clip.speaker for clip in found_clips],
        [clip.split for clip in found_clips],
        list(corpora_of),
        np.array(originals, np.int64),
        np.array(levels, np.float32),
    )


def _measured(
    network: DEITalk, clip: StrengthClip, surroundings: Surroundings
) -> Iterator[tuple[Float32, float]]:
    """Numbers and level of a recording with speech enough, then of its copies."""
    sound = load_audio(clip.path).waveform
    if clip.kind == READERS:
        sound = sound[: int(SAMPLE_RATE * LONGEST_SECONDS)]
    numbers = measure(network, sound)
    if numbers is None:
        return
    yield numbers, rms_db(sound)
    copies = 0 if clip.split == TEST else 1 if clip.kind == READERS else COPIES
    rng = np.random.default_rng(list(clip.path.name.encode()))
    for _ in range(copies):
        copy = altered(sound, rng, surroundings)
        if (numbers := measure(network, copy)) is not None:
            yield numbers, rms_db(copy)


def measure(network: DEITalk, sound: Float32) -> Float32 | None:
    """Numbers of a recording [shape=(2 D,)]; None of too little speech."""
    frames = VoiceFrames.of(network, Speech.of(sound))
    return frames.numbers() if frames.is_enough else None


def altered(sound: Float32, rng: Generator, surroundings: Surroundings) -> Float32:
    """The same speech by another voice, microphone, room, noise and codec, at another level."""
    sound = change_speed(sound, float(rng.uniform(*SPEEDS)))
    sound = augment(sound, rng, surroundings, noisy=0)
    return coded(sound, rng) if rng.random() < CODED_SHARE else sound


def coded(sound: Float32, rng: Generator) -> Float32:
    """The sound through one of `CODECS`, as long as it was."""
    kind, subtype = CODECS[int(rng.integers(len(CODECS)))]
    peak = max(float(np.abs(sound).max()), 1e-6)
    file = io.BytesIO()
    soundfile.write(file, 0.9 * sound / peak, SAMPLE_RATE, format=kind, subtype=subtype)
    file.seek(0)
    heard = soundfile.read(file, dtype="float32")[0][: len(sound)] * (peak / 0.9)
    return np.pad(heard, (0, len(sound) - len(heard)))


def fit(voices: Voices, chosen: Bool) -> EmotionMap:
    """Fit the map to some of the recordings.

    Raises
    ------
    DataError
        If a class has no example among the actors.
    """
    x, places = voices.numbers[chosen], voices.places[chosen]
    weights = _weights(voices, chosen)
    plain = ~voices.is_reader[chosen] & ~voices.is_copy[chosen]
    mean, spread = x[plain].mean(axis=0), x[plain].std(axis=0) + 1e-6
    rows = standardised(x, mean, spread)
    nuisance = torch.from_numpy(_nuisance(voices, chosen, rows))
    inputs, truth = torch.from_numpy(rows), torch.from_numpy(places)
    share = torch.tensor(weights, dtype=torch.float32)
    layer = torch.nn.Linear(x.shape[1], len(NAMED))
    torch.nn.init.zeros_(layer.weight)
    torch.nn.init.zeros_(layer.bias)
    optimiser = torch.optim.LBFGS(layer.parameters(), max_iter=STEPS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        error = (share * F.cross_entropy(layer(inputs), truth, reduction="none")).sum()
        answers = (nuisance @ layer.weight.T).square().sum()
        error = error + PRIOR * (layer.weight.square().sum() + ALTERED * answers)
        error.backward()  # type: ignore[no-untyped-call]
        return error

    optimiser.step(loss)  # type: ignore[no-untyped-call]
    return _map(mean, spread, layer.weight.detach().numpy(), layer.bias.detach().numpy())


def fit_ridge(voices: Voices, chosen: Bool, penalty: float = 0.1) -> EmotionMap:
    """Ridge regression on the classes, without copies and without costs of what is no emotion."""
    chosen = chosen & ~voices.is_copy
    x, weights = voices.numbers[chosen], _weights(voices, chosen)
    mean, spread = x.mean(axis=0), x.std(axis=0) + 1e-6
    rows = standardised(x, mean, spread).astype(np.float64)
    middle = weights @ rows
    scaled = (rows - middle) * np.sqrt(weights)[:, None]
    classes = np.eye(len(NAMED))[voices.places[chosen]]
    usual = weights @ classes
    targets = (classes - usual) * np.sqrt(weights)[:, None]
    gram = scaled @ scaled.T + penalty * np.eye(len(scaled))
    weight = (scaled.T @ np.linalg.solve(gram, targets)).T
    return _map(mean, spread, weight, usual - weight @ middle)


def _map(mean: Any, spread: Any, weight: Any, bias: Any) -> EmotionMap:
    named = {"mean": mean, "spread": spread, "weight": weight, "bias": bias}
    return EmotionMap({name: np.array(value, np.float32) for name, value in named.items()})


def _nuisance(voices: Voices, chosen: Bool, rows: Float32) -> Float32:
    """Changes of standardised rows (N', 2 D) that are no emotion; their squares are means."""
    place = np.full(len(chosen), -1)
    place[chosen] = np.arange(len(rows))
    reader, copy = voices.is_reader[chosen], voices.is_copy[chosen]
    acted = copy & ~reader
    changes = rows[acted] - rows[place[voices.originals[chosen][acted]]]
    neutral = rows[~reader & ~copy & (voices.places[chosen] == 0)].mean(axis=0)
    corpora = np.array(voices.corpora)[chosen]
    found = [changes / np.sqrt(max(len(changes), 1))]
    for corpus in sorted({*corpora} - {""}):
        apart = rows[corpora == corpus].mean(axis=0) - neutral
        found.append(np.sqrt(CORPUS) * apart[None])
    return np.concatenate(found).astype(np.float32)


def _weights(voices: Voices, chosen: Bool) -> Float64:
    """Weight of each recording: classes of actors alike, readers together `READERS_WEIGHT`."""
    reader, places = voices.is_reader[chosen], voices.places[chosen]
    counts = np.bincount(places[~reader], minlength=len(NAMED))
    if not counts.all():
        raise DataError(f"no actor to fit was asked for {NAMED[int(counts.argmin())]}")
    weights = np.where(
        reader, READERS_WEIGHT / max(reader.sum(), 1), 1 / (len(NAMED) * counts)[places]
    )
    return np.asarray(weights / weights.sum(), np.float64)


def cross_validate(voices: Voices, fitted_by: Any = fit) -> tuple[Float64, float, float]:
    """Probabilities of speakers that a fit did not have.

    Returns
    -------
    probabilities : array [shape=(N, 4)]
        With both numbers applied; NaN for test speakers.
    temperature : float
        By which scores are divided to make the probabilities of actors true.
    added : float
        What is added to the score of neutral before, so that readers are neutral.
    """
    fitted = voices.having("validation")
    raw = np.full((len(voices.places), len(NAMED)), np.nan)
    for fold in range(FOLDS):
        held = fitted & (voices.folds == fold)
        if held.any():
            found = fitted_by(voices, fitted & (voices.folds != fold))
            raw[held] = predict(found, voices.numbers[held])
    scores = np.log(raw + 1e-12)
    readers = fitted & voices.is_reader & ~voices.is_copy
    added = 0.0
    if readers.any():
        gap = scores[readers, 1:].max(axis=1) - scores[readers, 0]
        added = float(np.quantile(gap, NEUTRAL_READERS))
    scores[:, 0] += added
    actors = fitted & ~voices.is_reader & ~voices.is_copy
    truth = voices.places[actors]
    counts = np.bincount(truth, minlength=len(NAMED))
    grid = np.geomspace(0.3, 3, 93).tolist()
    errors = [_log_loss(scores[actors] / t, truth, 1 / counts[truth]) for t in grid]
    best = float(grid[int(np.argmin(errors))])
    return _softmax(scores / best), best, added


def _log_loss(scores: Float64, truth: Int64, weights: Float64) -> float:
    right = np.log(_softmax(scores)[np.arange(len(truth)), truth])
    return float(-(right * weights).sum() / weights.sum())


def _softmax(scores: Float64) -> Float64:
    odds = np.exp(scores - scores.max(axis=1, keepdims=True))
    return np.asarray(odds / odds.sum(axis=1, keepdims=True), np.float64)


def adjusted(found: EmotionMap, temperature: float, added: float = 0.0) -> EmotionMap:
    """The map with `added` in the score of neutral, and its scores divided by the temperature."""
    w = dict(found.weights)
    bias = w["bias"] + np.eye(len(NAMED), dtype=np.float32)[0] * np.float32(added)
    by = np.float32(temperature)
    return EmotionMap(w | {"weight": w["weight"] / by, "bias": bias / by})


def predict(found: EmotionMap, numbers: Float32) -> Float64:
    """Probabilities of recordings [shape=(N, 4)]."""
    return np.stack([found.probabilities(row) for row in numbers])


def score(p: Float64, voices: Voices, split: str) -> dict[str, float]:
    """Scores of probabilities (N, 4) on the recordings of a split, without copies.

    Returns
    -------
    dict
        ``recall NAME`` of the most probable class of actors, by the emotion asked, ``unweighted
        recall``, ``anger against sadness``; ``calibration error``: of the most probable class,
        expected, classes weighted alike; ``readers neutral``.
    """
    y, reader = voices.places, voices.is_reader
    held = voices.having(split) & ~voices.is_copy
    acted, read = held & ~reader, held & reader
    best = p.argmax(axis=1)
    both = acted & np.isin(y, (1, 3))
    return recalls(p[acted], y[acted]) | {
        "anger against sadness": _mean((p[both, 1] > p[both, 3]) == (y[both] == 1)),
        "calibration error": _calibration_error(p[acted], y[acted]),
        "readers neutral": _mean(best[read] == 0),
        "actors' clips": int(acted.sum()),
        "readers' clips": int(read.sum()),
    }


def recalls(p: Float64, truth: Int64) -> dict[str, float]:
    """Recall of each of `NAMED` by the most probable one, and their mean."""
    best = p.argmax(axis=1)
    found = {f"recall {name}": _mean(best[truth == k] == k) for k, name in enumerate(NAMED)}
    return found | {"unweighted recall": float(np.nanmean(list(found.values())))}


def judge(found: EmotionMap, path: Path) -> dict[str, float]:
    """Recalls on another corpus: a table with the columns path and emotion.

    Raises
    ------
    DataError
        If the table lacks a column, or names none of the emotions.
    """
    rows = pd.read_csv(path, dtype=str, keep_default_na=False)
    if not {"path", "emotion"} <= {*rows.columns}:
        raise DataError(f"{path}: needs the columns path, emotion")
    network, p, truth = require_model(MODEL, DEITalk), [], []
    for row in rows.to_dict("records"):
        if row["emotion"] in PLACES:
            numbers = measure(network, load_audio(path.parent / row["path"]).waveform)
            if numbers is not None:
                p.append(found.probabilities(numbers))
                truth.append(PLACES[row["emotion"]])
    if not truth:
        raise DataError(f"{path}: names none of {', '.join(PLACES)}")
    return recalls(np.stack(p), np.array(truth, np.int64))


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


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Fit, print the scores, and write the map."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--actors", type=Path, required=True, help="CREMA-D's table")
    parser.add_argument("--readers", type=Path, action="append", default=[], help="path, speaker")
    parser.add_argument("--judge", type=Path, action="append", default=[], help="path, emotion")
    parser.add_argument("--noise", help="folder of noise for the altered copies")
    parser.add_argument("--rooms", help="folder of impulse responses for them")
    parser.add_argument("--split", choices=("validation", TEST), default="validation")
    parser.add_argument("--json", type=new_file, help="also write the scores to this file")
    parser.add_argument("-o", "--out", type=new_file, help=".safetensors to write")
    options = parser.parse_args(arguments)
    scores: dict[str, dict[str, float]] = {}
    judged: dict[str, dict[str, float]] = {}
    around = read_surroundings(options.noise, options.rooms)
    voices = read_voices(options.actors, options.readers, around, options.split)
    fitted = voices.having("validation")
    level = voices._replace(numbers=voices.levels[:, None])
    makers = {"map": (voices, fit), "ridge": (voices, fit_ridge), "level": (level, fit_ridge)}
    for name, (heard, fitted_by) in makers.items():
        p, temperature, added = cross_validate(heard, fitted_by)
        found = adjusted(fitted_by(heard, fitted), temperature, added)
        scores[f"{name}, cross-validation"] = score(p, heard, "validation")
        if options.split == TEST:
            scores[f"{name}, {TEST}"] = score(predict(found, heard.numbers), heard, TEST)
        if name != "level":
            for path in options.judge:
                judged[f"{name}, {path.stem}"] = judge(found, path)
        if name == "map":
            made = found
    sys.stdout.write("\n".join(table("", scores | judged)) + "\n")
    write_json(options.json, identified(MODEL) | scores)
    if options.out is not None:
        with atomic_write(options.out) as beside:
            save_file({k: v.astype(np.float32) for k, v in made.weights.items()}, beside)


if __name__ == "__main__":
    sys.exit(main())
