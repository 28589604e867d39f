"""Conventions of takes: animators, solvers and days round one and the same vowel by other controls.

How the controls of a take relate to its sound is a linear map from the mouth that a model predicts
from the sound to the captured curves. Takes of which one map predicts the other as well as it may
share a convention; a model of all takes averages conventions, and is worse on each than one of the
few takes that share it. Letters: P predictors, C controls.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from deitalk.data.clips import Clip
from rig import RigCurves, default_controls
from rig.arrays import Bool, Float32, Float64

LEAST_TAKES = 3
"""Of one actor in one emotion; of two takes that differ neither is told from the other."""
MOST_TAKES = 100
"""Beyond them takes are not compared: every one is with every other."""
LEAST_FRAMES = 240
"""Of a take that is compared: 8 s."""
LEAST_GAIN = 0.03
"""Share of the error by which conventions must lower it against one map of all takes. Parts of one
take and takes of one hand gave at most .007, takes of different ones .05 to .2."""
PENALTY = 0.03
"""Of a map, as a share of the squares of its predictors."""
MOVING = 0.02
"""Least standard deviation of a control that counts, where it is not said which do."""
SHOWN = 2
"""Controls that are named for a convention."""


@dataclass
class TakeProducts:
    """Products of the rows (1, predictors, curves) of a take."""

    total: Float64 | None = None
    known: Bool | None = None
    """Controls that all of its clips hold [shape=(C,)]."""

    def add(self, predicted: Float32, curves: Float32, known: Bool) -> None:
        """Add the frames of a clip: predictors (T, P) and curves (T, C)."""
        ones = np.ones((len(curves), 1))
        rows = np.concatenate((ones, predicted, curves), axis=1, dtype=np.float64)
        products = rows.T @ rows
        self.total = products if self.total is None else self.total + products
        self.known = known if self.known is None else self.known & known


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
        take = self.takes.setdefault((clip.speaker, clip.emotion), {})
        own = take.setdefault(clip.take or clip.name, TakeProducts())
        own.add(rows[within], curves.values[near], known)

    def conventions(self, names: Sequence[str]) -> dict[str, "Convention"]:
        """Conventions by the name of their style; empty where every actor has one."""
        every = {(actor, how, take) for (actor, how), own in self.takes.items() for take in own}
        products = [take.total for own in self.takes.values() for take in own.values()]
        total = np.sum([one for one in products if one is not None], axis=0)
        if not total.any():
            return {}
        variance = np.diagonal(_centred(total))[-len(names) :] / total[0, 0]
        return name_styles(self.takes, every, names, variance > MOVING**2)[0]


class Convention(NamedTuple):
    """Takes that relate the face to the sound alike."""

    takes: tuple[str, ...]
    controls: tuple[str, ...]
    """Those that move more in these takes than in the others, most first."""

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
        name: take.total
        for name, take in takes.items()
        if take.total is not None and take.total[0, 0] >= LEAST_FRAMES
    }
    if not LEAST_TAKES <= len(long) <= MOST_TAKES:
        return []
    known = np.all([takes[name].known for name in long], axis=0) & moving
    if not known.any():
        return []
    order = list(long)
    size = len(long[order[0]]) - len(names)
    columns = np.concatenate((np.arange(size), size + np.flatnonzero(known)))
    compared = _Compared([_centred(long[name][np.ix_(columns, columns)]) for name in order], size)
    groups = compared.best_groups()
    groups.sort(key=lambda group: (-len(group), group))
    chosen = [names[place] for place in np.flatnonzero(known)]
    return [
        Convention(tuple(order[i] for i in group), _most(compared.spreads, group, chosen))
        for group in groups
        if len(groups) > 1
    ]


def nearest_convention(
    take: TakeProducts, conventions: Sequence[Sequence[TakeProducts]], moving: Bool
) -> int:
    """Place of the convention whose map predicts a take best."""
    assert take.total is not None
    size = len(take.total) - len(moving)
    columns = np.concatenate((np.arange(size), size + np.flatnonzero(moving)))
    parts = np.ix_(columns, columns)
    own = _centred(take.total[parts])
    errors = []
    for members in conventions:
        others = [_centred(m.total[parts]) for m in members if m.total is not None]
        errors.append(_Compared([*others, own], size).error(range(len(others)), len(others)))
    return int(np.argmin(errors))


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


def _centred(products: Float64) -> Float64:
    """Products about the means of a take: how it rests is no convention."""
    about: Float64 = products - np.outer(products[:, 0], products[0]) / products[0, 0]
    return about[1:, 1:]


class _Compared:
    """Takes by places, and how well maps of some predict another."""

    def __init__(self, takes: Sequence[Float64], size: int) -> None:
        self.takes, self.size = takes, size - 1
        squares = np.array([np.diagonal(take)[self.size :] for take in takes])
        self.scale = np.maximum(squares.sum(axis=1), 1e-9)
        self.spreads = np.sqrt(squares / squares.sum(axis=1, keepdims=True).clip(1e-9))
        """Standard deviation of every control over the take's motion [shape=(takes, C)]."""

    def map_of(self, members: Sequence[int]) -> Float64:
        """Map (P, C) fitted on some takes."""
        total = np.sum([self.takes[i] for i in members], axis=0)
        squares = total[: self.size, : self.size]
        diagonal = np.diagonal(squares)
        penalty = np.diag(PENALTY * diagonal + 1e-6 * max(float(diagonal.max()), 1e-9))
        found: Float64 = np.linalg.solve(squares + penalty, total[: self.size, self.size :])
        return found

    def error_of(self, found: Float64, take: int) -> float:
        """Squared error of a map on a take over the take's motion."""
        both = np.concatenate((found, -np.eye(found.shape[1])))
        return float((both * (self.takes[take] @ both)).sum() / self.scale[take])

    def error(self, members: Sequence[int], take: int) -> float:
        """The same of a map that is fitted on some takes."""
        return self.error_of(self.map_of(members), take)

    def best_groups(self) -> list[list[int]]:
        """The grouping whose takes are best predicted from the others of their group.

        A take that is alone is predicted from all others. Groups are joined by the mean of the
        errors of each take's map on the others' takes.
        """
        count = len(self.takes)
        maps = [self.map_of([i]) for i in range(count)]
        apart = np.array([[self.error_of(maps[i], j) for j in range(count)] for i in range(count)])
        distance = (apart + apart.T) / 2
        groups = [[i] for i in range(count)]
        best, lowest = groups, np.inf
        while True:
            cost = sum(self._cost(group) for group in groups)
            if len(groups) == 1:
                return best if lowest < (1 - LEAST_GAIN) * cost else groups
            if cost < lowest:
                best, lowest = groups, cost
            pairs = [
                (float(distance[np.ix_(a, b)].mean()), i, j)
                for i, a in enumerate(groups)
                for j, b in enumerate(groups)
                if i < j
            ]
            _, i, j = min(pairs)
            joined = sorted(groups[i] + groups[j])
            groups = [group for k, group in enumerate(groups) if k not in (i, j)] + [joined]

    def _cost(self, group: Sequence[int]) -> float:
        everyone = range(len(self.takes))
        others = group if len(group) > 1 else everyone
        return sum(self.error([i for i in others if i != take], take) for take in group)


def _most(spreads: Float64, group: Sequence[int], names: Sequence[str]) -> tuple[str, ...]:
    """Controls that move most in a group against the other takes."""
    inside = [i in group for i in range(len(spreads))]
    own, others = spreads[inside].mean(axis=0), spreads[np.logical_not(inside)].mean(axis=0)
    more = own - others
    order = np.argsort(-more, kind="stable")
    return tuple(names[i] for i in order[:SHOWN] if more[i] > 0.2 * own[i])
