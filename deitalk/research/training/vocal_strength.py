"""Training of `deitalk.audio.vocal_strength`: run it by ``python -m`` and this module's name.

Two targets that no rule of this project made: the level of a speaker at a fixed gain, above the
mean of a reader's chapter or of an actor's clips, predicted from pieces without their level (smooth
L1 on deviations); and the order in which an actor was asked for an emotion, low, middle and high
(logistic loss on pairs of one actor and emotion). Readers and neutral takes are near 0. The input
has random equalisation and noise, so that neither microphone nor room counts as strength.

The command prints the scores of `deitalk.research.evaluation.strength` for the validation
speakers, or with
``--split test`` for the test speakers, each beside those of level and pitch; with ``--embedded`` it
trains nothing and scores the networks of the package.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.random import Generator
from safetensors.numpy import save_file
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.audio.prosody import BANDS
from deitalk.audio.vocal_strength import (
    MEMBERS,
    REST_WEIGHT,
    UNIT_DB,
    WEIGHTS,
    VocalStrength,
    vocal_strength,
    without_level,
)
from deitalk.errors import DataError
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.evaluation.report import shipped, write_json
from deitalk.research.evaluation.strength import (
    MeasuredClip,
    as_markdown,
    measure_clips,
    score_strength,
)
from deitalk.research.evaluation.strength_clips import (
    ACTORS,
    LEVELS,
    NEUTRAL,
    READERS,
    read_strength_clips,
)
from deitalk.research.training.strength_network import Member, StrengthNetwork
from rig.arrays import Float32
from rig.files import atomic_write

STEPS, LEARNING_RATE, WEIGHT_DECAY = 1200, 2e-3, 0.05
CHAPTERS, PIECES, ACTORS_AT_ONCE = 4, 8, 3
"""Contents of one step: chapters, pieces of each, actors with all of their clips."""
SHORTEST, LONGEST, ACTED = 60, 240, 200
"""Frames of a reader's piece, and at most of an actor's."""
EQUALISATION = np.array([0.25, 0.2, 0.15, 0.15])
"""Standard deviations of a slope and three cosines over the bands, powers of ten."""
NOISY = 0.5
"""Share of inputs with added noise, 15 to 45 dB below the speech."""
ACTED_LEVEL, ORDER, CENTRE = 0.3, 1.0, 0.1
"""Weights: level of actors, order of strengths, and usual takes near 0."""
STRONG_EMOTIONS, OTHER_PAIRS, NEIGHBOURS, ABOVE_NEUTRAL = ("ANG", "HAP"), 0.4, 0.7, 0.15
"""Weights of pairs: emotions whose strength is clear in the voice count 1, others less; and pairs
one level apart; and high above neutral."""
SHARPNESS = 2.0
BETA_DB = 2.0


def train(
    clips: Sequence[MeasuredClip], *, steps: int = STEPS, members: int = MEMBERS, seed: int = 0
) -> VocalStrength:
    """Train on readers and actors; every member of the mean on its own.

    Raises
    ------
    DataError
        If there are fewer chapters or actors than one step needs.
    """
    groups = _groups(clips)
    chapters = [group for group in groups if group[0].clip.kind == READERS]
    actors = [group for group in groups if group[0].clip.kind == ACTORS]
    if len(chapters) < CHAPTERS or len(actors) < ACTORS_AT_ONCE:
        raise DataError(
            f"{len(chapters)} chapters of readers and {len(actors)} actors to train on; "
            f"at least {CHAPTERS} and {ACTORS_AT_ONCE} are needed"
        )
    torch.manual_seed(seed)
    network = StrengthNetwork(members)
    for number, member in enumerate(network.members):
        assert isinstance(member, Member)
        # Set the mean and spread of the features over speech.
        rows = [without_level(clip.frames)[0] for clip in clips]
        speech = torch.tensor(np.concatenate([row[row[:, -1] > 0] for row in rows]))
        member.mean.copy_(speech.mean(dim=0))
        member.spread.copy_(speech.std(dim=0).clamp_min(0.1))
        _fit(member, chapters, actors, steps, np.random.default_rng((seed, number)))
    return VocalStrength(network.weights())


def _fit(
    member: Member,
    chapters: Sequence[list[MeasuredClip]],
    actors: Sequence[list[MeasuredClip]],
    steps: int,
    rng: Generator,
) -> None:
    optimiser = torch.optim.AdamW(member.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, LEARNING_RATE, total_steps=steps)
    for _ in range(steps):
        loss = _reader_loss(member, chapters, rng) + _actor_loss(member, actors, rng)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(member.parameters(), 1.0)
        optimiser.step()
        schedule.step()


def _groups(clips: Sequence[MeasuredClip]) -> list[list[MeasuredClip]]:
    groups: dict[tuple[str, str], list[MeasuredClip]] = {}
    for clip in clips:
        groups.setdefault((clip.clip.kind, clip.clip.group), []).append(clip)
    return list(groups.values())


def _reader_loss(network: Member, chapters: Sequence[list[MeasuredClip]], rng: Generator) -> Tensor:
    """Level of pieces within their chapters."""
    length = int(rng.integers(SHORTEST, LONGEST))
    chosen = [chapters[i] for i in rng.choice(len(chapters), CHAPTERS, replace=False)]
    pieces = [group[i] for group in chosen for i in rng.integers(0, len(group), PIECES)]
    inputs, levels = _batch(pieces, length, rng)
    strength = network(*inputs).reshape(CHAPTERS, PIECES)
    loss: Tensor = _within(strength, levels.reshape(CHAPTERS, PIECES)).mean()
    loss += CENTRE * (strength.mean(dim=1) / UNIT_DB).square().mean()
    return loss


def _within(strength: Tensor, levels: Tensor) -> Tensor:
    """Error of the deviations from the mean of the last axis, dB."""
    given, wanted = (x - x.mean(dim=-1, keepdim=True) for x in (strength, levels))
    losses: Tensor = F.smooth_l1_loss(given, wanted, beta=BETA_DB, reduction="none").mean(-1)
    return losses


def _actor_loss(network: Member, actors: Sequence[list[MeasuredClip]], rng: Generator) -> Tensor:
    """Level within an actor, and the order of the strengths."""
    chosen = [actors[i] for i in rng.choice(len(actors), ACTORS_AT_ONCE, replace=False)]
    inputs, levels = _batch([clip for group in chosen for clip in group], ACTED, rng)
    output = network(*inputs)
    loss, start = torch.zeros(()), 0
    for group in chosen:
        rows = slice(start, start + len(group))
        start += len(group)
        strength = output[rows]
        loss = loss + ACTED_LEVEL * _within(strength, levels[rows])
        upper, lower, weight = _pairs(group)
        order = F.softplus(-SHARPNESS * (strength[upper] - strength[lower]) / UNIT_DB)
        loss = loss + ORDER * (weight * order).sum() / weight.sum().clamp_min(1.0)
        usual = torch.tensor([clip.clip.emotion == NEUTRAL for clip in group])
        if usual.any():
            loss = loss + CENTRE * (strength[usual] / UNIT_DB).square().mean()
    return loss / len(chosen)


def _pairs(group: Sequence[MeasuredClip]) -> tuple[Tensor, Tensor, Tensor]:
    """Stronger and weaker clips of one actor, and the weight of each pair."""
    upper, lower, weights = [], [], []
    for i, high in enumerate(group):
        for j, low in enumerate(group):
            weight = _pair_weight(high, low)
            if weight:
                upper.append(i)
                lower.append(j)
                weights.append(weight)
    return (
        torch.tensor(upper, dtype=torch.long),
        torch.tensor(lower, dtype=torch.long),
        (torch.tensor(weights)),
    )


def _pair_weight(high: MeasuredClip, low: MeasuredClip) -> float:
    """Weight of "the first is stronger"; 0 if it is not known to be."""
    a, b = high.clip, low.clip
    if a.level not in LEVELS:
        return 0.0
    if b.emotion == NEUTRAL:
        return ABOVE_NEUTRAL if a.level == LEVELS[-1] and a.emotion in STRONG_EMOTIONS else 0.0
    if b.emotion != a.emotion or b.level not in LEVELS:
        return 0.0
    apart = LEVELS.index(a.level) - LEVELS.index(b.level)
    if apart < 1:
        return 0.0
    return (1.0 if a.emotion in STRONG_EMOTIONS else OTHER_PAIRS) * (
        1.0 if apart > 1 else NEIGHBOURS
    )


def _batch(
    clips: Sequence[MeasuredClip], length: int, rng: Generator
) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Pieces of at most `length` frames with augmentation, their weights, and levels in dB."""
    rows, levels = [], []
    for clip in clips:
        start = int(rng.integers(0, max(1, len(clip.frames) - length + 1)))
        frames, level = without_level(clip.frames[start : start + length])
        frames[:, :BANDS] = _augment(frames[:, :BANDS], rng)
        rows.append(frames)
        levels.append(level)
    n = max(map(len, rows))
    batch = np.zeros((len(rows), n, rows[0].shape[1]), np.float32)
    weight = np.zeros((len(rows), n), np.float32)
    for i, row in enumerate(rows):
        batch[i, : len(row)] = row
        weight[i, : len(row)] = np.maximum(row[:, -1], REST_WEIGHT)
    return (torch.tensor(batch), torch.tensor(weight)), torch.tensor(levels, dtype=torch.float32)


def _augment(bands: Float32, rng: Generator) -> Float32:
    """Random equalisation, and noise in half of the inputs."""
    place = np.linspace(0, 1, BANDS)
    basis = np.stack([place - 0.5, *(np.cos(np.pi * k * place) for k in (1, 2, 3))])
    bands = bands + (rng.normal(0, EQUALISATION) @ basis)
    if rng.random() < NOISY:
        floor = -rng.uniform(1.5, 4.5) + rng.normal(0, 0.3) * 3 * (place - 0.5)
        bands = np.log10(10.0**bands + 10.0**floor)
    return bands.astype(np.float32)


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring; an error is one line on stderr."""
    parser = argparse.ArgumentParser(prog="python -m deitalk.research.training.vocal_strength")
    parser.add_argument("--readers", type=Path, required=True, help="table of readers")
    parser.add_argument("--actors", type=Path, required=True, help="table of actors")
    parser.add_argument("-o", "--out", type=new_file, help="weights: FILE.safetensors")
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--embedded", action="store_true", help="score those of the package")
    parser.add_argument("--json", type=new_file, help="also write the scores to this file")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    clips = read_strength_clips(given.readers, READERS) + read_strength_clips(given.actors, ACTORS)
    measured = measure_clips(clips)
    held = [clip for clip in measured if clip.clip.split == given.split]
    unseen = ("test",) if given.split == "test" else ("test", "validation")
    if given.embedded:
        network = vocal_strength()
    else:
        heard = [clip for clip in measured if clip.clip.split not in unseen]
        network = train(heard, steps=given.steps, seed=given.seed)
    scores = score_strength(network, held)
    sys.stdout.write(as_markdown(scores) + "\n")
    known = shipped("deitalk.audio", WEIGHTS) if given.embedded else {}
    write_json(given.json, {"split": given.split, **known, "scores": scores})
    if given.out is not None:
        with atomic_write(given.out) as path:
            save_file({k: v.astype(np.float16) for k, v in network.weights.items()}, path)


if __name__ == "__main__":
    sys.exit(main())
