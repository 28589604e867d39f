"""Which variant of each emotion a take shows: given, or chosen by the voice and the character.

A take is between the variants of its emotion. A strong voice is nearer to those of strong voices
(`rig.emotions.VARIANTS`), a weak one to those of weak voices. A character (its traits are those of
a style, a voice or the take before) has its own besides, which are drawn from its traits and the
seed. Of nobody the strength alone decides, or with another seed than 0 the seed too: variants that
were drawn for each recording hid which of two takes is the stronger one.

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
HOME, WEAK_HOME, STEEPNESS = 2.0, 1.0, 1.5
"""Most that is added to a variant of strong voices, and to one of weak voices, and how suddenly
about the usual state. A calm reader is weak: an emotion that is named stays clear, as `puzzled`
alone, with one brow, is not."""
USUAL_STATE = 0.8
"""State of the voice at which strong and weak ones part, between the normal and the strong takes of
two corpora of actors."""
QUIETER = {"sad": 0.6}
"""By which that state is lower of a voice in an emotion: people are quieter in sadness."""
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
    given: Mapping[str, float], traits: Traits, seed: int, state: float | None = None
) -> Ways:
    """Variants that are given, and chosen ones of the other emotions.

    Parameters
    ----------
    given : mapping of str to float
        From `deitalk.emotions.variants.parse_variant`; of emotions without one they are chosen.
    traits : Traits
        Of the character.
    seed : int
        Another number draws otherwise.
    state : float, optional
        Of the voice (`feeling.state_of_intensity`); None: not known, neither strong nor weak.
    """
    weights = np.zeros((len(LABELS), len(COLUMNS)), np.float32)
    side = math.copysign(1.0, traits.side)
    if PLAIN in given:
        return Ways(weights, side)
    character = (round((value + FURTHEST_TRAIT) * 1000) for value in astuple(traits))
    rng = np.random.default_rng([seed, *(character if traits.own else ())])
    spread = SPREAD * (traits.own or float(seed != 0))
    for emotion, own in VARIANTS.items():
        above = 0.0 if state is None else state - USUAL_STATE + QUIETER.get(emotion, 0.0)
        strength = (HOME if above > 0 else WEAK_HOME) * math.tanh(STEEPNESS * above)
        drawn = spread * rng.standard_normal(len(own)) + strength * np.array([*own.values()])
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
