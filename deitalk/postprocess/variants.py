"""Which variant of each emotion a take shows: given, or chosen by the voice and the character.

A phrase is between the variants of its emotion. A strong voice is nearer to those of strong voices
(`rig.emotions.VARIANTS`), a weak one to those of weak voices. A character (its traits are those of
a style, a voice or the take before) has its own besides, which are drawn from its traits and the
seed, and habits: muscles that show more or less of every emotion, so that two characters of one
variant are no one mask. Of nobody the strength alone decides, or with another seed than 0 the
seed too: variants that were drawn for each recording hid which of two takes is the stronger one.

Letters: V variants of all emotions, H habits, C controls, T frames.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import astuple
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from deitalk.config.rules import Expressions
from deitalk.emotions import LABELS
from deitalk.emotions.variants import EMOTION_OF
from deitalk.postprocess.life.character import Traits
from rig import ControlSet
from rig.arrays import Float32, Float64
from rig.emotions import PLAIN, VARIANTS

SPREAD = 4.8
"""Standard deviation of the logarithms of the drawn weights: the largest of three is .88 on the
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
OWNERS = [LABELS.index(emotion) for emotion in EMOTION_OF.values()]
"""Place of the emotion of each variant."""
HABITS = (
    ("brow_raiseIn",), ("brow_raiseOut",), ("brow_down", "brow_lateral"),
    ("eye_squintInner", "eye_eyelidD"), ("eye_cheekRaise", "nasolabialDeepen"), ("_nose.",),
    ("cornerPull", "CornerPull", "dimple"), ("cornerDepress", "ChinRaise"),
    ("mouth_stretch", "neck_stretch"), ("mouth_tighten", "jaw_clench"), ("eye_blink", "eyelidU"),
)  # fmt: skip
"""Parts of the names of the controls that a character uses more or less together, as one muscle
moves them; none of them parts or closes the lips."""
HABIT_SPREAD, LEAST_HABIT, MOST_HABIT = 0.8, -0.45, 1.0
"""Standard deviation of the logarithms of the factors, and their limits in standard deviations,
.70 and 2.23: no muscle of an emotion is missing, a faint smile was none for those who looked."""


class Ways(NamedTuple):
    """How a take shows each emotion."""

    weights: Float32
    """Of the variants within their emotions [shape=(..., V)]; those of one sum to at most 1."""
    side: float
    """1: the left side does what one side does alone, such as the smile of contempt; -1: the right
    one."""
    habits: Float32
    """Factors on the expression of the controls of `HABITS` [shape=(H,)]."""

    def of(self, emotion: Float32) -> Float32:
        """Weights of the variants in a mixture of emotions (..., 9) [shape=(..., V)]."""
        return emotion[..., OWNERS] * self.weights


def choose_ways(
    given: Mapping[str, float], traits: Traits, seed: int, state: Float64 | float | None = None
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
    state : float or array [shape=(T,)], optional
        Of the voice (`feeling.state_of_intensity`); None: not known, neither strong nor weak.
    """
    states = None if state is None else np.asarray(state)
    weights = np.zeros((*(() if states is None else states.shape), len(COLUMNS)), np.float32)
    side = math.copysign(1.0, traits.side)
    if PLAIN in given:
        return Ways(weights, side, np.ones(len(HABITS), np.float32))
    character = (round((value + FURTHEST_TRAIT) * 1000) for value in astuple(traits))
    rng = np.random.default_rng([seed, *(character if traits.own else ())])
    spread = SPREAD * (traits.own or float(seed != 0))
    for emotion, own in VARIANTS.items():
        usual = USUAL_STATE - QUIETER.get(emotion, 0.0)
        above = np.zeros(()) if states is None else states - usual
        strength = np.where(above > 0, HOME, WEAK_HOME) * np.tanh(STEEPNESS * above)
        homes = strength[..., None] * np.array([*own.values()])
        drawn = np.exp(spread * rng.standard_normal(len(own)) + homes)
        shares = drawn / drawn.sum(axis=-1, keepdims=True)
        if any(name in given for name in own):
            shares = np.array([given.get(name, 0.0) for name in own])
        weights[..., [COLUMNS.index(name) for name in own]] = shares
    habits = spread / SPREAD * np.clip(rng.standard_normal(len(HABITS)), LEAST_HABIT, MOST_HABIT)
    return Ways(weights, side, np.exp(HABIT_SPREAD * habits).astype(np.float32))


def habit_factors(controls: ControlSet, rule: Expressions | None, habits: Float32) -> Float32:
    """Factors (..., C) on the expression of all controls, of habits (..., H).

    All are 1 where captures show an actor's emotions.
    """
    if rule is None or rule.captured:
        return np.ones((*habits.shape[:-1], len(controls)), np.float32)
    factors: Float32 = 1 + (habits - 1) @ _habit_columns(controls.names)
    return factors


@lru_cache(maxsize=8)
def _habit_columns(names: tuple[str, ...]) -> Float32:
    """1 where a control is of a habit [shape=(H, C)]."""
    rows = [[any(part in name for part in parts) for name in names] for parts in HABITS]
    return np.array(rows, np.float32)


def show_habits(
    shown: Float32, neutral: Float32, controls: ControlSet, factors: Float32
) -> Float32:
    """Finished curves whose distance from the neutral ones has these factors, within the ranges.

    A factor above 1 is that of a small distance; it falls to 1 where the range ends. A muscle that
    a character uses more does not reach its limit at a normal voice, where a strong one would show
    no more.

    Parameters
    ----------
    shown, neutral : array [shape=(..., C)]
        The former is changed in place, and returned.
    controls : ControlSet
        Their columns and ranges.
    factors : array [shape=(..., C)]
        From `habit_factors`.
    """
    if (factors != 1).any():
        distance = shown - neutral
        limit = np.where(distance > 0, controls.maximum, controls.minimum)
        share = distance / np.where(limit == neutral, 1, limit - neutral)
        shown += (factors / (1 + np.maximum(factors - 1, 0) * share) - 1) * distance
        np.clip(shown, controls.minimum, controls.maximum, out=shown)
    return shown


def unused_variants(given: Mapping[str, float], emotion: Float64) -> Iterator[str]:
    """Notes on variants of emotions that no key of a track (K, S) shows."""
    for name in given:
        if name != PLAIN and not emotion[:, LABELS.index(EMOTION_OF[name])].any():
            yield f"variant {name} is of {EMOTION_OF[name]}, which is not shown"
