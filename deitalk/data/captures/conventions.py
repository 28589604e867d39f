"""Conventions of takes: animators, solvers and days round one and the same vowel by other controls.

How the controls of a take relate to its sound is a linear map from the mouth that a model predicts
from the sound to the captured curves. Where takes share a convention, a map of all predicts half
of one better than a map of its other half, which has less to learn from; a map of several
conventions averages them, and is worse on each. Letters: P predictors, C controls.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from deitalk.data.clips import Clip
from rig import RigCurves, default_controls
from rig.arrays import Bool, Float32, Float64, Int64

LEAST_TAKES = 2
"""Fewest takes of one actor in one emotion that are compared."""
MOST_TAKES = 100
"""Most takes that are compared, every one with every other."""
LEAST_FRAMES = 150
"""Fewest frames of a take that is compared: 5 s."""
LEAST_GAIN = 0.03
"""Share of the error by which conventions must lower it against one map of all takes. Parts of one
take and takes of one hand gave at most .007, takes of different ones .05 to .2."""
MOST_APART = 1.06
"""Error with which a half of a take is predicted from halves of others of its convention, over that
from its own other half. Takes of one hand gave .99 and 1.01, takes of different ones 1.11 to 2."""
LEAST_HELP = 0.1
"""Share of the smaller group's error by which a join lowers that of both, where they are alike."""
PENALTY = 0.03
"""Penalty of a map, as a share of the squares of its predictors."""
MOVING = 0.02
"""Least standard deviation of a control that counts, where it is not said which do."""
SHOWN = 2
"""Controls that are named for a convention."""


@dataclass
class TakeProducts:
    """Products of the rows (1, predictors, curves) of both halves of a take's clips."""

    halves: Float64 | None = None
    """[shape=(2, 1 + P + C, 1 + P + C)]."""
    known: Bool | None = None
    """Controls that all of its clips hold [shape=(C,)]."""

    def add(self, predicted: Float32, curves: Float32, known: Bool) -> None:
        """Add the frames of a clip: predictors (T, P) and curves (T, C)."""
        ones = np.ones((len(curves), 1))
        rows = np.concatenate((ones, predicted, curves), axis=1, dtype=np.float64)
        parts = np.stack([part.T @ part for part in np.array_split(rows, 2)])
        self.halves = parts if self.halves is None else self.halves + parts
        self.known = known if self.known is None else self.known & known

    def of(self, columns: Int64) -> Float64:
        """Products of some columns, about the means of the take, whose rest is no convention."""
        assert self.halves is not None
        halves = self.halves[:, columns[:, None], columns]
        mean = halves.sum(axis=0)[0] / halves[:, 0, 0].sum()
        about = halves - halves[:, :, :1] * mean - mean[:, None] * halves[:, :1]
        centred: Float64 = about[:, 1:, 1:] + halves[:, :1, :1] * np.outer(mean, mean)[1:, 1:]
        return centred


@dataclass
class Relations:
    """Takes of captures with the mouth that a model of the board predicts from their sound."""

    takes: dict[tuple[str, str], dict[str, TakeProducts]] = field(default_factory=dict)
    """By actor and emotion, and by name."""

    def add(self, clip: Clip, predicted: RigCurves, curves: RigCurves, known: Bool) -> None:
        """Add a clip: what is predicted at every frame of its sound, and its captured curves."""
        lip = [predicted.names[i] for i in default_controls().subset("lip")]
        rows = predicted.select(lip).values
        places = (np.arange(len(rows)) / predicted.fps - clip.offset_seconds) * curves.fps
        within = (places >= 0) & (places <= len(curves) - 1)
        near = np.rint(places[within]).astype(int)
        take = self.takes.setdefault(clip.group, {})
        own = take.setdefault(clip.take_name, TakeProducts())
        own.add(rows[within], curves.values[near], known)

    def conventions(self, names: Sequence[str]) -> dict[str, "Convention"]:
        """Conventions by the name of their style; empty where every actor has one."""
        every = {(actor, how, take) for (actor, how), own in self.takes.items() for take in own}
        halves = [take.halves for own in self.takes.values() for take in own.values()]
        known = [one for one in halves if one is not None]
        if not known:
            return {}
        total = np.sum(known, axis=(0, 1))
        means, squares = total[0] / total[0, 0], np.diagonal(total) / total[0, 0]
        variance = np.maximum(squares - np.square(means), 0)[-len(names) :]
        return name_styles(self.takes, every, names, variance > MOVING**2)[0]


class Convention(NamedTuple):
    """Takes that relate the face to the sound alike."""

    takes: tuple[str, ...]
    controls: tuple[str, ...]
    """Controls that move more in these takes than in the others, most first."""

    def __str__(self) -> str:
        more = f" (more {', '.join(self.controls)})" if self.controls else ""
        return " + ".join(self.takes) + more


def find_conventions(
    takes: Mapping[str, TakeProducts], names: Sequence[str], moving: Bool
) -> list[Convention]:
    """Conventions of the takes of one actor in one emotion.

    Parameters
    ----------
    takes : mapping of str to TakeProducts
        By name.
    names : sequence of str
        Of the controls [C].
    moving : array of bool [shape=(C,)]
        Controls that count.

    Returns
    -------
    list of Convention
        Of most takes first; empty where all takes share one, or nothing can be told.
    """
    long = {
        name: take
        for name, take in takes.items()
        if take.halves is not None and take.halves[:, 0, 0].sum() >= LEAST_FRAMES
    }
    if not LEAST_TAKES <= len(long) <= MOST_TAKES:
        return []
    held = [take.known for take in long.values() if take.known is not None]
    known = np.all(held, axis=0) & moving
    if not known.any():
        return []
    order = list(long)
    columns = _columns(long[order[0]], known)
    compared = _Compared([long[name].of(columns) for name in order], int(known.sum()))
    groups = compared.best_groups()
    groups.sort(key=lambda group: (-len(group), group))
    chosen = [names[place] for place in np.flatnonzero(known).tolist()]
    return [
        Convention(tuple(order[i] for i in group), _most(compared.spreads, group, chosen))
        for group in groups
        if len(groups) > 1
    ]


def nearest_convention(
    take: TakeProducts, conventions: Sequence[Sequence[TakeProducts]], moving: Bool
) -> int:
    """Place of the convention whose map predicts a take best."""
    columns = _columns(take, moving)
    errors = []
    for members in conventions:
        others = [member.of(columns) for member in members]
        compared = _Compared([*others, take.of(columns)], int(moving.sum()))
        whole = compared.map_of(np.sum(others, axis=(0, 1)))
        errors.append(sum(compared.error(whole, len(others), half) for half in (0, 1)))
    return int(np.argmin(errors))


def _columns(take: TakeProducts, chosen: Bool) -> Int64:
    """Places of the 1, the predictors and some controls in the products of takes."""
    assert take.halves is not None
    size = take.halves.shape[1] - len(chosen)
    return np.concatenate((np.arange(size), size + np.flatnonzero(chosen)))


Takes = Mapping[tuple[str, str], Mapping[str, TakeProducts]]
"""By actor and emotion, and by name."""


def name_styles(
    takes: Takes, learnt: Collection[tuple[str, str, str]], names: Sequence[str], moving: Bool
) -> tuple[dict[str, Convention], dict[tuple[str, str, str], str]]:
    """Conventions by the names of their styles, and the style of every take.

    The conventions of an actor are those of the emotion with most takes; takes of others get the
    nearest, as takes do that are not learnt from.

    Parameters
    ----------
    takes : mapping
        All takes.
    learnt : collection of (actor, emotion, take)
        Those that conventions are found in.
    names, moving
        As for `find_conventions`.

    Returns
    -------
    conventions : dict of str to Convention
        By style, the actor's name and a number from 1; empty where nobody has several.
    styles : dict of (actor, emotion, take) to str
        Of the actors that have several.
    """
    conventions: dict[str, Convention] = {}
    styles: dict[tuple[str, str, str], str] = {}
    for actor in dict.fromkeys(actor for actor, _ in takes):
        emotions = {emotion: own for (name, emotion), own in takes.items() if name == actor}
        trained = {
            emotion: {take: own[take] for take in own if (actor, emotion, take) in learnt}
            for emotion, own in emotions.items()
        }
        most = max(trained, key=lambda emotion: len(trained[emotion]))
        found = find_conventions(trained[most], names, moving)
        if not found:
            continue
        own_names = [f"{actor or 'style'}-{place}" for place in range(1, len(found) + 1)]
        conventions |= dict(zip(own_names, found, strict=True))
        members = [[trained[most][take] for take in one.takes] for one in found]
        home = {take: place for place, one in enumerate(found) for take in one.takes}
        for emotion, own in emotions.items():
            for take, products in own.items():
                place = home.get(take) if emotion == most else None
                if place is None:
                    place = nearest_convention(products, members, moving)
                styles[actor, emotion, take] = own_names[place]
    return conventions, styles


class _Compared:
    """Takes by places, and how well maps of some predict a half of another."""

    def __init__(self, takes: Sequence[Float64], n_controls: int) -> None:
        self.takes = np.stack(takes)
        self.size = self.takes.shape[-1] - n_controls
        squares = np.einsum("thii->ti", self.takes)[:, self.size :]
        self.scale = np.maximum(squares.sum(axis=1), 1e-9)
        self.spreads = np.sqrt(squares / self.scale[:, None])
        """Standard deviation of every control over the take's motion [shape=(takes, C)]."""

    def map_of(self, products: Float64) -> Float64:
        """Map (P, C) of the products of some rows."""
        squares = products[: self.size, : self.size]
        diagonal = np.diagonal(squares)
        penalty = np.diag(PENALTY * diagonal + 1e-6 * max(float(diagonal.max()), 1e-9))
        right = products[: self.size, self.size :]
        return np.asarray(np.linalg.solve(squares + penalty, right), np.float64)

    def error(self, found: Float64, take: int, half: int) -> float:
        """Squared error of a map on a half of a take over the take's motion."""
        both = np.concatenate((found, -np.eye(found.shape[1])))
        return float((both * (self.takes[take, half] @ both)).sum() / self.scale[take])

    def best_groups(self) -> list[list[int]]:
        """The grouping in which halves are best predicted from the rest of their group.

        Groups are joined by the mean of the errors of each take's map on the others' takes. A join
        is undone where halves predict each other worse than their own take by `MOST_APART`, and the
        others help by less than `LEAST_HELP`.
        """
        count = len(self.takes)
        maps = [[self.map_of(half) for half in (*take, take.sum(axis=0))] for take in self.takes]
        pairs = [[(own, other) for other in range(count)] for own in maps]
        whole, halves = (
            np.array([[sum(self.error(own[k], j, half) for k, half in rows) for own, j in row]
                      for row in pairs])
            for rows in (((2, 0), (2, 1)), ((0, 1), (1, 0)))
        )  # fmt: skip
        worse = halves / np.maximum(np.diagonal(halves), 1e-9)
        distance, worse = whole + whole.T, (worse + worse.T) / 2
        groups, are_alike = [[i] for i in range(count)], True
        levels = []
        while True:
            costs = [self._cost(group) for group in groups]
            levels.append((sum(costs), are_alike, groups))
            if len(groups) == 1:
                break
            near = [
                (float(distance[np.ix_(a, b)].mean()), i, j)
                for i, a in enumerate(groups)
                for j, b in enumerate(groups)
                if i < j
            ]
            _, i, j = min(near)
            joined = sorted(groups[i] + groups[j])
            helped = costs[i] + costs[j] - self._cost(joined)
            ratio = worse[np.ix_(groups[i], groups[j])].mean()
            if ratio > MOST_APART and helped < LEAST_HELP * min(costs[i], costs[j]):
                are_alike = False
            groups = [group for k, group in enumerate(groups) if k not in (i, j)] + [joined]
        cost, are_alike, best = min(levels, key=lambda level: level[0])
        if cost >= (1 - LEAST_GAIN) * levels[-1][0]:
            return groups
        return best if are_alike else [groups for _, alike, groups in levels if alike][-1]

    def _cost(self, group: Sequence[int]) -> float:
        total = self.takes[list(group)].sum(axis=(0, 1))
        return sum(
            self.error(self.map_of(total - self.takes[take, half]), take, half)
            for take in group
            for half in (0, 1)
        )


def _most(spreads: Float64, group: Sequence[int], names: Sequence[str]) -> tuple[str, ...]:
    """Controls that move most in a group against the other takes."""
    inside = [i in group for i in range(len(spreads))]
    own, others = spreads[inside].mean(axis=0), spreads[np.logical_not(inside)].mean(axis=0)
    more = own - others
    order = np.argsort(-more, kind="stable")
    return tuple(names[i] for i in order[:SHOWN] if more[i] > 0.2 * own[i])
