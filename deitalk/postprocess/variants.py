"""Which variant of each emotion a take shows: given, or drawn for the voice.

A drawn take is between the variants of its emotion. Takes of one character (its traits are those
of a style, a voice or the take before) with one seed are alike but for their strength; of nobody
each recording has its own. A strong voice is nearer to the variants of strong voices
(`rig.emotions.VARIANTS`).

Letters: S emotions, V variants of all of them.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import astuple
from typing import NamedTuple

import numpy as np

from deitalk.emotions import LABELS
from deitalk.emotions.variants import EMOTION_OF
from deitalk.postprocess.life.voice import Traits
from rig.arrays import Float32, Float64
from rig.emotions import PLAIN, VARIANTS

SPREAD = 2.0
"""Standard deviation of the logarithms of the drawn weights: the largest of three is .74 on the
average."""
HOME = 0.9
"""Added per standard deviation of the take's strength to a variant of strong voices."""
FURTHEST_TRAIT = 10.0
"""More than any trait is below 0."""
COLUMNS = tuple(EMOTION_OF)


class Ways(NamedTuple):
    """How a take shows each emotion."""

    weights: Float32
    """Of the variants of each emotion [shape=(S, V)]; a row sums to at most 1."""
    side: float
    """1: the left side does what one side does alone, such as the smile of contempt; -1: the right
    one."""


def choose_ways(
    given: Mapping[str, float], traits: Traits, seed: int, strength: float = 0.0
) -> Ways:
    """Variants that are given, and drawn ones of the other emotions.

    Parameters
    ----------
    given : mapping of str to float
        From `deitalk.emotions.variants.parse_variant`; emotions without one are drawn.
    traits : Traits
        Of the character.
    seed : int
        Another number draws otherwise.
    strength : float
        State of the voice (`feeling.state_of`), about standard deviations from the usual one.
    """
    weights = np.zeros((len(LABELS), len(COLUMNS)), np.float32)
    side = math.copysign(1.0, traits.side)
    if PLAIN in given:
        return Ways(weights, side)
    character = (round((value + FURTHEST_TRAIT) * 1000) for value in astuple(traits))
    rng = np.random.default_rng([seed, *character])
    for emotion, own in VARIANTS.items():
        drawn = SPREAD * rng.standard_normal(len(own)) + HOME * strength * np.array([*own.values()])
        shares = np.exp(drawn - drawn.max())
        shares /= shares.sum()
        if any(name in given for name in own):
            shares = np.array([given.get(name, 0.0) for name in own])
        columns = [COLUMNS.index(name) for name in own]
        weights[LABELS.index(emotion), columns] = shares
    return Ways(weights, side)


def unused_variants(given: Mapping[str, float], emotion: Float64) -> Iterator[str]:
    """Notes on variants of emotions that no key of a track (K, S) shows."""
    for name in given:
        if name != PLAIN and not emotion[:, LABELS.index(EMOTION_OF[name])].any():
            yield f"variant {name} is of {EMOTION_OF[name]}, which is not shown"
