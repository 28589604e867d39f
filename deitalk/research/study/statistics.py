"""Statistics of choices: exact intervals, Luce's model of choice, agreement of raters.

Letters: Q systems, N choices.
"""

from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp
from scipy.stats import binomtest

from rig.arrays import Float64

CONFIDENCE = 0.95
RESAMPLES = 1000
STEPS = 200
PRIOR = 0.5
"""Wins and losses of every system against an average one, which keep strengths finite."""


class Share(NamedTuple):
    """A share of choices, with Clopper and Pearson's exact interval."""

    wins: int
    n: int
    share: float
    low: float
    high: float
    p: float
    """Exact two-sided probability of a share at least as far from chance."""


class Strengths(NamedTuple):
    """Log strengths, mean 0, and their interval [each shape=(Q,)]."""

    best: Float64
    low: Float64
    high: Float64


def share_of(wins: int, n: int, chance: float = 0.5) -> Share:
    """Share of `wins` in `n` choices, and its exact binomial interval and test.

    Choices count as independent; several of one rater are not quite: `strengths` has intervals over
    raters.
    """
    if not n:
        return Share(0, 0, float("nan"), float("nan"), float("nan"), float("nan"))
    test = binomtest(wins, n, chance)
    interval = test.proportion_ci(CONFIDENCE, method="exact")
    return Share(wins, n, wins / n, float(interval.low), float(interval.high), float(test.pvalue))


Choices = Sequence[tuple[Sequence[int], int]]
"""Numbers of the systems side by side, 0 to Q - 1, and of the chosen one."""


def strengths(by_rater: Mapping[str, Choices], n_systems: int) -> Strengths:
    """Strengths of the systems by Luce's model of choice, with intervals over raters.

    Of systems side by side, i is chosen with probability exp(s_i) over the sum of all exp(s_j); for
    pairs that is Bradley and Terry's model. Fitted by minorisation and maximisation (Hunter 2004,
    The Annals of Statistics 32), with `PRIOR` wins and losses of each system against an average
    one. Intervals are percentiles of fits to raters drawn with replacement.

    Parameters
    ----------
    by_rater : mapping
        Choices of every rater, at least one.
    n_systems : int
        Q.
    """
    sets = sorted({tuple(sorted(shown)) for rows in by_rater.values() for shown, _ in rows})
    wins = np.zeros((len(by_rater), n_systems))
    counts = np.zeros((len(by_rater), len(sets)))
    for rater, rows in enumerate(by_rater.values()):
        for shown, chosen in rows:
            wins[rater, chosen] += 1
            counts[rater, sets.index(tuple(sorted(shown)))] += 1
    rng = np.random.default_rng(0)
    often = rng.multinomial(len(wins), np.full(len(wins), 1 / len(wins)), RESAMPLES)
    often = np.vstack((np.ones(len(wins)), often))
    fits = _fit(often @ wins, often @ counts, [list(group) for group in sets])
    tail = 50 * (1 - CONFIDENCE)
    low, high = np.percentile(fits[1:], (tail, 100 - tail), axis=0)
    return Strengths(fits[0], low, high)


def _fit(wins: Float64, counts: Float64, sets: Sequence[list[int]]) -> Float64:
    """Log strengths of every row of counts, mean 0 [shape=(rows, Q)]."""
    log = np.zeros_like(wins)
    for _ in range(STEPS):
        load = 2 * PRIOR / (np.exp(log) + 1)
        for column, group in enumerate(sets):
            total = np.exp(logsumexp(log[:, group], axis=1))
            load[:, group] += (counts[:, column] / total)[:, None]
        log = np.log((wins + PRIOR) / load)
        log -= log.mean(axis=1, keepdims=True)
    return log


def agreement(ratings: Mapping[Hashable, Sequence[Hashable]]) -> float:
    """Krippendorff's alpha of nominal ratings: 1 for agreement, 0 for chance.

    Krippendorff 2011, Computing Krippendorff's Alpha-Reliability: one less the observed over the
    expected disagreement, over units with at least two ratings.

    Parameters
    ----------
    ratings : mapping
        What the raters of each unit gave.

    Returns
    -------
    float
        NaN without two ratings of any unit, or if all ratings are the same.
    """
    usable = [list(values) for values in ratings.values() if len(values) > 1]
    everything = [value for values in usable for value in values]
    total = len(everything)
    counts = {value: everything.count(value) for value in set(everything)}
    expected = total**2 - sum(n * n for n in counts.values())
    if not expected:
        return float("nan")
    observed = 0.0
    for values in usable:
        same = sum(values.count(value) ** 2 for value in set(values))
        observed += (len(values) ** 2 - same) / (len(values) - 1)
    return 1 - (total - 1) * observed / expected
