"""What a tuning begins with: last layers by ridge regression, and the strength of expressions.

Captures are few and features many, so that a penalty holds the weights; which, is chosen for every
actor and control by cross-validation over takes. Actors are pooled in part: all share a map, and
each has a change of it with a penalty of its own and an offset without one (a ridge with one block
of features for all and one for each actor; Daumé, "Frustratingly Easy Domain Adaptation", 2007). A
face without a name gets the mean of the actors' maps. Of three actors and more it is that of a new
actor, and gets a map without changes, whose penalty is the one with which each actor is best
predicted from the others; conventions of one actor are no new actors.

Everything is computed from sums of products, so that hours of captures need no more memory than
minutes. Letters: T frames, F features, C controls, A actors, K folds.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import torch

from deitalk.models.rig_decoder import RigDecoder
from rig.arrays import Bool, Float32, Float64, Int64

SHARED = (1.0, 3.0, 10.0, 100.0)
"""Penalties of the shared map to choose from, as shares of the squares of its features; the last
leaves hardly more than the mean."""
OWN = (0.3, 1.0, 10.0)
"""Penalty of an actor's change over that of the shared map: freer, as free, or nearly none."""
LEAST_BETTER = 0.005
"""Share of a control's error by which a map must lower it, else the control stays as it is."""
LEAST_ACTORS = 3
"""From which on a new actor's penalty is told by leaving actors out."""
FOLDS = 4
"""Most parts of the captures of which each is predicted from the others."""
MANY, MANY_FOLDS = 8, 2
"""Actors from which on two folds do, an actor's change is nearly none, all actors have the same
penalties, and sums of products are in single precision: time and memory grow with the actors."""


Pair = tuple[float, float | None]
"""Shared and own penalty; without one of its own no actor has a change."""


class Capture(NamedTuple):
    """What is known of a clip before it is read.

    Attributes
    ----------
    take, actor : str
    known : ndarray [shape=(C,)]
        Controls that the clip shows; the others are left out.
    emotion : str
    """

    take: str
    actor: str
    known: Bool
    emotion: str = ""

    @property
    def group(self) -> tuple[str, str]:
        """What every fold is to be predicted from others of: its actor in its emotion."""
        return self.actor, self.emotion


Rows = tuple[Float32, Float32]
"""Features [shape=(T, F)] of a clip, and what is to be added to its curves [shape=(T, C)]."""


class Maps(NamedTuple):
    """Linear maps of the features.

    Attributes
    ----------
    weight : ndarray [shape=(A + 1, C, F)]
        The map of a face without a name, then how each actor differs from it.
    bias : ndarray [shape=(A + 1, C)]
    stays : ndarray [shape=(C,)]
        Controls whose curves stay as they are, because no map predicts better.
    held : tuple of Maps
        Those with the same penalties, fitted without each fold; empty where there is one fold.
    folds : tuple of int
        Fold of every clip.
    """

    weight: Float64
    bias: Float64
    stays: Bool
    held: "tuple[Maps, ...]" = ()
    folds: tuple[int, ...] = ()

    def add_to(self, decoder: RigDecoder, share: float = 1.0) -> None:
        """Add a share of the maps to the last layer of a decoder and to those of its actors."""
        with torch.no_grad():
            decoder.output.weight.add_(_tensor(self.weight[0], decoder), alpha=share)
            decoder.output.bias.add_(_tensor(self.bias[0], decoder), alpha=share)
            if decoder.actor_layers is not None:
                decoder.actor_layers.weight.add_(_tensor(self.weight[1:], decoder), alpha=share)
                decoder.actor_layers.bias.add_(_tensor(self.bias[1:], decoder), alpha=share)


def _tensor(values: Float64, decoder: RigDecoder) -> torch.Tensor:
    return torch.from_numpy(values).to(decoder.output.weight)


class Sums(NamedTuple):
    """Products of the rows of the first clips, to go on with when others are added."""

    folds: list[int]
    """Of these clips."""
    grams: Float64


def fit_ridge(
    clips: Sequence[Capture],
    read: Callable[[int], Rows],
    actors: Sequence[str],
    learnt: Bool,
    sums: dict[tuple[int, ...], Sums] | None = None,
    *,
    may_stay: bool = False,
    new_actors: bool = True,
) -> Maps:
    """Fit the maps of all learnt controls.

    Parameters
    ----------
    clips : sequence of Capture
        All to train on.
    read : callable
        Gives the rows of the clip of a place.
    actors : sequence of str
        Those that have a change of their own, in the model's order; one without clips has none.
    learnt : array [shape=(C,)]
        Controls to fit; the maps of the others are 0.
    sums : dict or None
        Gets the products, by the places of the controls; those of a call with the same actors on
        the first of the clips are gone on with, so that these are read once.
    may_stay : bool
        Whether a control that no map predicts better stays as it is.
    new_actors : bool
        Whether a face without a name is that of an actor of no capture; else it is one of these.
    """
    sums = {} if sums is None else sums
    names = [name for name in actors if any(clip.actor == name for clip in clips)]
    are_many = len(names) >= MANY
    most = MANY_FOLDS if are_many else FOLDS
    folds = take_folds([(clip.take, clip.group) for clip in clips], most)
    shows = np.stack([clip.known & learnt for clip in clips])  # clips by controls
    places = np.array([0, *(list(actors).index(name) + 1 for name in names)])
    maps: Maps | None = None
    for pattern in np.unique(shows[:, shows.any(axis=0)], axis=1).T:
        columns = np.flatnonzero((shows == pattern[:, None]).all(axis=0))
        shown = np.flatnonzero(pattern).tolist()
        key = (*places.tolist(), *columns.tolist())
        grams = _grams(clips, read, shown, folds, names, columns.tolist(), sums.get(key))
        sums[key] = Sums(folds, grams)
        whole, *held = _chosen(grams, len(columns), may_stay, new_actors)
        if maps is None:
            shape = len(actors) + 1, len(learnt), whole.weight.shape[-1]
            count = max(folds) + 1 if max(folds) else 0
            maps = _empty(shape)._replace(
                held=tuple(_empty(shape) for _ in range(count)), folds=tuple(folds)
            )
        # Clips that show these controls may all be in one fold; without it there is no other map.
        for target, found in zip((maps, *maps.held), (whole, *(held or [])), strict=False):
            target.weight[np.ix_(places, columns)] = found.weight[: len(places)]
            target.bias[np.ix_(places, columns)] = found.bias[: len(places)]
            target.stays[columns] = found.stays
    assert maps is not None
    return maps


def _empty(shape: tuple[int, int, int]) -> Maps:
    return Maps(np.zeros(shape), np.zeros(shape[:2]), np.zeros(shape[1], bool))


def take_folds(clips: Sequence[tuple[str, Hashable]], most: int = FOLDS) -> list[int]:
    """Fold of every clip (take, group): whole takes of a group of two or more, else parts of one.

    A fold is so always predicted from other clips of its groups, actors in an emotion.
    """
    takes: dict[Hashable, dict[str, int]] = {}
    for take, group in clips:
        own = takes.setdefault(group, {})
        own.setdefault(take, len(own))
    sizes = Counter(clips)
    seen = dict.fromkeys(sizes, 0)
    folds = []
    for clip in clips:
        take, group = clip
        if len(takes[group]) >= 2:
            folds.append(takes[group][take] % most)
        else:
            folds.append(seen[clip] * min(most, sizes[clip]) // sizes[clip])
            seen[clip] += 1
    return folds


def _grams(
    clips: Sequence[Capture],
    read: Callable[[int], Rows],
    shown: Sequence[int],
    folds: Sequence[int],
    names: Sequence[str],
    columns: Sequence[int],
    before: Sums | None,
) -> Float64:
    """Products of rows (1, features, targets) [shape=(K, A, 1 + F + C, 1 + F + C)]."""
    grams, done = np.zeros(0), 0
    if before is not None and folds[: len(before.folds)] == before.folds:
        grams, done = before.grams, len(before.folds)
        if (more := max(folds) + 1 - len(grams)) > 0:
            grams = np.concatenate((grams, np.zeros((more, *grams.shape[1:]))))
    for place in [place for place in shown if place >= done]:
        features, targets = read(place)
        ones = np.ones((len(features), 1), np.float32)
        rows = np.concatenate((ones, features, targets[:, columns]), axis=1)
        if not grams.size:
            shape = max(folds) + 1, max(len(names), 1), rows.shape[1], rows.shape[1]
            grams = np.zeros(shape, np.float32 if len(names) >= MANY else np.float64)
        actor = names.index(clips[place].actor) if names else 0
        grams[folds[place], actor] += rows.T @ rows
    return grams


def _chosen(grams: Float64, n_controls: int, may_stay: bool, new_actors: bool) -> list[Maps]:
    """Maps with the penalties of least error of each actor and control; those without each fold.

    Without folds, as nothing can be predicted from others, they are the largest penalties.
    """
    n_actors, total = grams.shape[1], grams.sum(axis=0)
    own = OWN[-1:] if n_actors >= MANY else OWN
    pairs: list[Pair] = [(shared, shared * each) for shared in SHARED for each in own]
    if n_actors == 1:
        pairs = [(shared, shared) for shared in SHARED]
    shape, stays = (n_actors, n_controls), np.zeros(n_controls, bool)
    folds = [fold for fold in range(len(grams)) if grams[fold, :, 0, 0].any()]
    if len(folds) == 1:
        best = np.full(shape, len(pairs) - 1)
        return [_with_stranger(total, pairs, best, stays, new_actors)]
    errors = np.zeros((len(pairs), *shape))
    weights = np.zeros((len(grams), *shape, grams.shape[-1] - 1 - n_controls), np.float32)
    biases = np.zeros((len(grams), *shape))
    for place, pair in enumerate(pairs):
        found = {fold: _solve(total - grams[fold], n_controls, *pair) for fold in folds}
        for fold, (weight, bias) in found.items():
            errors[place] += _error(grams[fold], weight, bias)
        if n_actors >= MANY:
            errors[place] = errors[place].sum(axis=0)
        better = errors[place] < errors[:place].min(axis=0, initial=np.inf)
        for fold, (weight, bias) in found.items():
            weights[fold][better], biases[fold][better] = weight[better], bias[better]
    if may_stay:
        squares = np.einsum("kaii->i", grams[..., -n_controls:, -n_controls:], dtype=np.float64)
        least = errors.min(axis=0)
        least = least[0] if n_actors >= MANY else least.sum(axis=0)
        stays = least > (1 - LEAST_BETTER) * squares
    whole = _with_stranger(total, pairs, errors.argmin(axis=0), stays, new_actors)
    held = [
        _about(w, b, w.mean(axis=0), b.mean(axis=0)) for w, b in zip(weights, biases, strict=True)
    ]
    return [whole, *(_staying(*maps, stays) for maps in held)]


def _with_stranger(
    total: Float64, pairs: Sequence[Pair], best: Int64, stays: Bool, new_actors: bool
) -> Maps:
    """Maps of all clips by the penalties of each actor and control, and that without a name."""
    weight, bias = _each_solved(total, pairs, best)
    strange = weight.mean(axis=0), bias.mean(axis=0)
    if new_actors and len(total) >= LEAST_ACTORS:
        strange = _of_stranger(total, best.shape[1])
    return _staying(*_about(weight, bias, *strange), stays)


def _staying(weight: Float64, bias: Float64, stays: Bool) -> Maps:
    """Maps without those of controls that stay as they are."""
    return Maps(np.where(stays[:, None], 0, weight), np.where(stays, 0, bias), stays)


def _each_solved(grams: Float64, pairs: Sequence[Pair], best: Int64) -> tuple[Float64, Float64]:
    """`_solve` of every actor and control with the penalties of its place (A, C) in `pairs`."""
    weight, bias = _solve(grams, best.shape[1], *pairs[best[0, 0]])
    for place in set(best.flat) - {best[0, 0]}:
        weights, biases = _solve(grams, best.shape[1], *pairs[place])
        chosen = best == place
        weight[chosen], bias[chosen] = weights[chosen], biases[chosen]
    return weight, bias


def _of_stranger(grams: Float64, n_controls: int) -> tuple[Float64, Float64]:
    """Weights (C, F) and biases (C,) for an actor of no capture, from the products of each.

    Offsets have no part in the choice: no speech tells how a stranger's face rests.
    """
    pairs: list[Pair] = [(shared, None) for shared in SHARED]
    errors = np.zeros((len(pairs), n_controls))
    for left, of_actor in enumerate(grams):
        others = [gram for place, gram in enumerate(grams) if place != left]
        own = of_actor - np.outer(of_actor[:, 0], of_actor[0]) / max(of_actor[0, 0], 1)
        for place, pair in enumerate(pairs):
            weight, bias = _solve(others, n_controls, *pair)
            errors[place] += _error(own[None], weight[:1], bias[:1])[0]
    best = np.tile(errors.argmin(axis=0), (len(grams), 1))
    weight, bias = _each_solved(grams, pairs, best)
    return weight[0], bias.mean(axis=0)


def _about(
    weight: Float64, bias: Float64, stranger: Float64, rest: Float64
) -> tuple[Float64, Float64]:
    """The map without a name, and how each actor's differs [shape=(A + 1, …)]."""
    return (
        np.concatenate((stranger[None], weight - stranger)),
        np.concatenate((rest[None], bias - rest)),
    )


def _solve(
    grams: Sequence[Float64] | Float64, n_controls: int, shared: float, own: float | None
) -> tuple[Float64, Float64]:
    """Weights (A, C, F) and biases (A, C) of each actor from their products (A, …).

    Each actor's change is eliminated: with S its centred products, D the penalty and b the centred
    products with the targets, it is (S + own D)^-1 (b - S W) for the shared map W.
    """
    firsts = np.stack([gram[0] for gram in grams])
    counts = np.maximum(firsts[:, :1], 1)
    means = firsts / counts
    size = firsts.shape[1] - n_controls
    inner = sum(gram.diagonal() for gram in grams) - (firsts * means).sum(axis=0)
    scale = np.maximum(inner[1:size], 1e-6 * firsts[:, 0].sum())
    left, right = np.diag(shared * scale), np.zeros((size - 1, n_controls))
    parts = []
    for gram, first, mean in zip(grams, firsts, means, strict=True):
        centred = gram[1:size, 1:] - np.outer(first[1:size], mean[1:])
        square, product = centred[:, : size - 1], centred[:, size - 1 :]
        if own is None or len(grams) == 1:
            left += square
            right += product
            continue
        part = _positive(square + np.diag(own * scale), centred)
        left += square - square @ part[:, : size - 1]
        right += product - square @ part[:, size - 1 :]
        parts.append(part)
    common = _positive(left, right)
    weight = [common] * len(grams)
    if parts:
        weight = [common + part[:, size - 1 :] - part[:, : size - 1] @ common for part in parts]
    stacked = np.stack(weight).transpose(0, 2, 1).astype(np.float64)
    # The biases with which each actor's mean is met; one without rows has the mean of the others'.
    bias = np.stack([m[size:] - each @ m[1:size] for m, each in zip(means, stacked, strict=True)])
    absent = means[:, 0] == 0
    bias[absent] = bias[~absent].mean(axis=0)
    return stacked, bias


def _positive(matrix: Float64, right: Float64) -> Any:
    """Solution in single precision, which the penalty makes exact enough, in half the time."""
    factors = scipy.linalg.cho_factor(matrix.astype(np.float32), check_finite=False)
    return scipy.linalg.cho_solve(factors, right.astype(np.float32), check_finite=False)


def _error(grams: Float64, weight: Float64, bias: Float64) -> Float64:
    """Squared error of every actor and control on the products of a fold [shape=(A, C)]."""
    minus = -np.eye(weight.shape[1])
    rows = [
        np.column_stack((offset, each, minus)) for each, offset in zip(weight, bias, strict=True)
    ]
    return np.stack(
        [(both @ gram * both).sum(axis=1) for both, gram in zip(rows, grams, strict=True)]
    )
