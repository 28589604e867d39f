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
from typing import NamedTuple

import numpy as np
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
"""Fewest actors of whom each is left out to find the penalty of a new one."""
FOLDS = 4
"""Most parts of the captures of which each is predicted from the others."""
MANY, MANY_FOLDS = 8, 2
"""Actors from which on two folds do and all have one map, with an offset of each: minutes of one
of so many say hardly more of it, and neither time nor memory grows with the actors."""
GROUPS = 4
"""Parts of many actors, each of which is predicted from the others to choose their map."""


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
            layers = decoder.actor_layers
            if layers is not None and self.weight[1:].any():
                layers.weight.add_(_tensor(self.weight[1:], decoder), alpha=share)
            if layers is not None:
                layers.bias.add_(_tensor(self.bias[1:], decoder), alpha=share)


def _tensor(values: Float64, decoder: RigDecoder) -> torch.Tensor:
    return torch.from_numpy(values).to(decoder.output.weight)


class Sums(NamedTuple):
    """Sums of the rows (1, features, targets) [R] of clips, and of their products.

    They are gone on with when further clips are added.
    """

    folds: list[int]
    """Fold of each clip."""
    squares: Float64
    """Products, by fold and actor, of many actors by group [shape=(K, A or `GROUPS`, R, R)]."""
    rows: Float64
    """By fold and actor [shape=(K, A, R)]."""


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
    most = MANY_FOLDS if len(names) >= MANY else FOLDS
    folds = take_folds([(clip.take, clip.group) for clip in clips], most)
    shows = np.stack([clip.known & learnt for clip in clips])  # clips by controls
    places = np.array([0, *(list(actors).index(name) + 1 for name in names)])
    maps: Maps | None = None
    for pattern in np.unique(shows[:, shows.any(axis=0)], axis=1).T:
        columns = np.flatnonzero((shows == pattern[:, None]).all(axis=0))
        shown = np.flatnonzero(pattern).tolist()
        key = (*places.tolist(), *columns.tolist())
        sums[key] = _sums(clips, read, shown, folds, names, columns.tolist(), sums.get(key))
        whole, *held = _chosen(sums[key], len(columns), may_stay, new_actors)
        if maps is None:
            shape = len(actors) + 1, len(learnt), whole.weight.shape[-1]
            count = max(folds) + 1 if max(folds) else 0
            maps = _empty(shape)._replace(
                held=tuple(_empty(shape) for _ in range(count)), folds=tuple(folds)
            )
        # Clips that show these controls may all be in one fold; without it there is no other map.
        for target, found in zip((maps, *maps.held), (whole, *(held or [])), strict=False):
            target.weight[np.ix_(places[: len(found.weight)], columns)] = found.weight
            target.bias[np.ix_(places, columns)] = found.bias[: len(places)]
            target.stays[columns] = found.stays
    assert maps is not None
    return maps


def _empty(shape: tuple[int, int, int]) -> Maps:
    return Maps(np.zeros(shape), np.zeros(shape[:2]), np.zeros(shape[1], bool))


def take_folds(clips: Sequence[tuple[str, Hashable]], most: int = FOLDS) -> list[int]:
    """Fold of every clip (take, group): whole takes of a group of two or more, else parts of one.

    A fold is so always predicted from other clips of its groups, actors in an emotion; where each
    has one clip only, from other groups.
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
    if not any(folds):
        order = {group: place for place, group in enumerate(takes)}
        folds = [order[group] % most for _, group in clips]
    return folds


def _sums(
    clips: Sequence[Capture],
    read: Callable[[int], Rows],
    shown: Sequence[int],
    folds: list[int],
    names: Sequence[str],
    columns: Sequence[int],
    before: Sums | None,
) -> Sums:
    """Sums of the clips that show some controls; those of the first clips are gone on with."""
    squares, sums, done = np.zeros(0), np.zeros(0), 0
    if before is not None and folds[: len(before.folds)] == before.folds:
        squares, sums, done = before.squares, before.rows, len(before.folds)
        if (more := max(folds) + 1 - len(squares)) > 0:
            squares, sums = (
                np.concatenate((part, np.zeros((more, *part.shape[1:]))))
                for part in (squares, sums)
            )
    groups = GROUPS if len(names) >= MANY else max(len(names), 1)
    for place in [place for place in shown if place >= done]:
        features, targets = read(place)
        ones = np.ones((len(features), 1), np.float32)
        rows = np.concatenate((ones, features, targets[:, columns]), axis=1)
        if not squares.size:
            count, size = max(folds) + 1, rows.shape[1]
            squares = np.zeros((count, groups, size, size))
            sums = np.zeros((count, max(len(names), 1), size))
        actor = names.index(clips[place].actor) if names else 0
        product = rows.T @ rows
        squares[folds[place], actor % groups] += product
        sums[folds[place], actor] += product[0]
    return Sums(folds, squares, sums)


def _chosen(sums: Sums, n_controls: int, may_stay: bool, new_actors: bool) -> list[Maps]:
    """Maps with the penalties of least error of each actor and control; those without each fold.

    Without folds, as nothing can be predicted from others, they are the largest penalties.
    """
    squares, rows = sums.squares, sums.rows
    n_actors, is_one = rows.shape[1], rows.shape[1] == 1 or rows.shape[1] >= MANY
    is_new = new_actors and n_actors >= LEAST_ACTORS
    folds = [fold for fold in range(len(rows)) if rows[fold, :, 0].any()]
    best = None
    if is_one:
        if is_new and len(folds) > 1:
            best = _best_of_strangers(squares, rows.sum(axis=0), n_controls)[None]
        squares = squares.sum(axis=1, keepdims=True)
    total = squares.sum(axis=0), rows.sum(axis=0)
    pairs: list[Pair] = [(shared, shared * each) for shared in SHARED for each in OWN]
    if is_one:
        pairs = [(shared, None) for shared in SHARED]
    shape, stays = (1 if is_one else n_actors, n_controls), np.zeros(n_controls, bool)
    if len(folds) == 1:
        best = np.full(shape, len(pairs) - 1)
        return [_with_stranger(*total, pairs, best, stays, is_new)]
    errors = np.zeros((len(pairs), *shape))
    weights = np.zeros((len(rows), *shape, rows.shape[-1] - 1 - n_controls), np.float32)
    biases = np.zeros((len(rows), n_actors, n_controls))
    for place, pair in enumerate(pairs):
        found = {
            fold: _solve(total[0] - squares[fold], total[1] - rows[fold], n_controls, *pair)
            for fold in folds
        }
        for fold, (weight, bias) in found.items():
            error = _error(squares[fold], rows[fold], weight, bias)
            errors[place] += error.sum(axis=0) if is_one else error
        better = errors[place] < errors[:place].min(axis=0, initial=np.inf)
        if best is not None:
            better = best == place
        for fold, (weight, bias) in found.items():
            weights[fold][better] = weight[better]
            biases[fold] = np.where(better, bias, biases[fold])
    best = errors.argmin(axis=0) if best is None else best
    if may_stay:
        still = np.einsum("kaii->i", squares[..., -n_controls:, -n_controls:])
        least = np.take_along_axis(errors, best[None], axis=0)[0].sum(axis=0)
        stays = least > (1 - LEAST_BETTER) * still
    whole = _with_stranger(*total, pairs, best, stays, is_new)
    held = [
        _about(w, b, w.mean(axis=0), b.mean(axis=0)) for w, b in zip(weights, biases, strict=True)
    ]
    return [whole, *(_staying(*maps, stays) for maps in held)]


def _with_stranger(
    squares: Float64, rows: Float64, pairs: Sequence[Pair], best: Int64, stays: Bool, is_new: bool
) -> Maps:
    """Maps of all clips by the penalties of each actor and control, and that without a name."""
    weight, bias = _each_solved(squares, rows, pairs, best)
    strange = weight.mean(axis=0), bias.mean(axis=0)
    if is_new and len(weight) > 1:
        shared: list[Pair] = [(each, None) for each in SHARED]
        chosen = _best_of_strangers(squares[None], rows, best.shape[1])[None]
        each, rest = _each_solved(squares, rows, shared, chosen)
        strange = each[0], rest.mean(axis=0)
    return _staying(*_about(weight, bias, *strange), stays)


def _staying(weight: Float64, bias: Float64, stays: Bool) -> Maps:
    """Maps without those of controls that stay as they are."""
    return Maps(np.where(stays[:, None], 0, weight), np.where(stays, 0, bias), stays)


def _each_solved(
    squares: Float64, rows: Float64, pairs: Sequence[Pair], best: Int64
) -> tuple[Float64, Float64]:
    """`_solve` with the penalties of each map and control: their places in `pairs` (A or 1, C)."""
    first, *others = dict.fromkeys(best.ravel().tolist())
    weight, bias = _solve(squares, rows, best.shape[1], *pairs[first])
    for place in others:
        weights, biases = _solve(squares, rows, best.shape[1], *pairs[place])
        chosen = best == place
        weight[chosen], bias = weights[chosen], np.where(chosen, biases, bias)
    return weight, bias


def _best_of_strangers(squares: Float64, rows: Float64, n_controls: int) -> Int64:
    """Places in `SHARED` with which groups of actors are best predicted from others [shape=(C,)].

    Of `squares` by fold and group (K, G, R, R), `rows` by actor (A, R). Offsets have no part in
    the choice: no speech tells how a stranger's face rests.
    """
    errors, total = np.zeros((len(SHARED), n_controls)), squares.sum(axis=(0, 1))[None]
    count = squares.shape[1]
    group_of = np.arange(len(rows)) % count
    for left in range(count):
        of_group, theirs = squares[:, left].sum(axis=0), rows[group_of == left]
        own = of_group - theirs.T @ (theirs / np.maximum(theirs[:, :1], 1))
        for place, shared in enumerate(SHARED):
            others = rows[group_of != left]
            weight, _ = _solve(total - of_group, others, n_controls, shared, None)
            errors[place] += _square(own, weight[0])
    best: Int64 = errors.argmin(axis=0)
    return best


def _about(
    weight: Float64, bias: Float64, stranger: Float64, rest: Float64
) -> tuple[Float64, Float64]:
    """The map without a name, how each actor's differs [shape=(A + 1, …)], if they do."""
    changes = weight - stranger if len(weight) > 1 else weight[:0]
    return (
        np.concatenate((stranger[None], changes)),
        np.concatenate((rest[None], bias - rest)),
    )


def _solve(
    squares: Float64, rows: Float64, n_controls: int, shared: float, own: float | None
) -> tuple[Float64, Float64]:
    """Weights (A, C, F), without changes (1, C, F), and biases (A, C) from sums of all folds.

    Each actor's change is eliminated: with S its centred products, D the penalty and b the centred
    products with the targets, it is (S + own D)^-1 (b - S W) for the shared map W.
    """
    means = rows / np.maximum(rows[:, :1], 1)
    size = rows.shape[1] - n_controls
    inner = squares.sum(axis=0) - rows.T @ means
    scale = np.maximum(inner.diagonal()[1:size], 1e-6 * rows[:, 0].sum())
    left, right = np.diag(shared * scale), np.zeros((size - 1, n_controls))
    parts = []
    if own is None:
        left += inner[1:size, 1:size]
        right += inner[1:size, size:]
    else:
        for gram, row, mean in zip(squares, rows, means, strict=True):
            centred = gram[1:size, 1:] - np.outer(row[1:size], mean[1:])
            square, product = centred[:, : size - 1], centred[:, size - 1 :]
            part = _positive(square + np.diag(own * scale), centred)
            left += square - square @ part[:, : size - 1]
            right += product - square @ part[:, size - 1 :]
            parts.append(part)
    common = _positive(left, right)
    weight = [common + part[:, size - 1 :] - part[:, : size - 1] @ common for part in parts]
    stacked = np.stack(weight or [common]).transpose(0, 2, 1).astype(np.float64)
    # The biases with which each actor's mean is met; one without rows has the mean of the others'.
    bias = means[:, size:] - _products(stacked, means[:, 1:size])
    absent = means[:, 0] == 0
    bias[absent] = bias[~absent].mean(axis=0)
    return stacked, bias


def _products(weight: Float64, rows: Float64) -> Float64:
    """Map (A or 1, C, F) of a row (F,) of each actor [shape=(A, C)]."""
    maps = np.broadcast_to(weight, (len(rows), *weight.shape[1:]))
    return np.stack([each @ row for each, row in zip(maps, rows, strict=True)])


def _positive(matrix: Float64, right: Float64) -> Float32:
    """Solution in single precision, which the penalty makes exact enough, in half the time."""
    single, sides = (torch.from_numpy(part).float() for part in (matrix, right))
    return torch.cholesky_solve(sides, torch.linalg.cholesky(single)).numpy()


def _error(squares: Float64, rows: Float64, weight: Float64, bias: Float64) -> Float64:
    """Squared error of every actor or group and control on a fold [shape=(A or groups, C)]."""
    size = 1 + weight.shape[2]
    off = _products(weight, rows[:, 1:size]) - rows[:, size:]
    offsets = bias * (bias * rows[:, :1] + 2 * off)
    maps = np.broadcast_to(weight, (len(squares), *weight.shape[1:]))
    errors = [_square(square, each) for square, each in zip(squares, maps, strict=True)]
    np.add.at(found := np.stack(errors), np.arange(len(rows)) % len(squares), offsets)
    return found


def _square(square: Float64, weight: Float64) -> Float64:
    """Squared error of every control by a map without offsets, from products [shape=(C,)]."""
    both = np.column_stack((weight, -np.eye(len(weight))))
    error: Float64 = (both @ square[1:, 1:] * both).sum(axis=1)
    return error
