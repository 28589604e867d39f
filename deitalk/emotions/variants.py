"""Variants of the emotions, as given: ``hot``, ``hot=.7,cold=.3``, ``plain``.

The variants of an emotion (`rig.emotions.VARIANTS`) are points around its own pose; weights of at
most 1 together are a point between them, so that all of them are one continuous space.
"""

from collections.abc import Mapping
from typing import Any

from deitalk.emotions.track_files import number
from deitalk.errors import EmotionError
from rig.emotions import PLAIN, VARIANTS
from rig.errors import quoted

EMOTION_OF = {name: emotion for emotion, own in VARIANTS.items() for name in own}
"""Emotion of each variant; the order of the columns of the variants."""
ROUNDING = 1e-4


def parse_variant(given: Any) -> dict[str, float]:
    """Weights of named variants, of their text or of a mapping; empty: they are drawn.

    Parameters
    ----------
    given : str or mapping
        ``"hot"``; ``"hot,warm"``, one for each of two emotions; ``"hot=.7,cold=.3"``; or
        ``"plain"``: the poses of the emotions themselves.

    Raises
    ------
    EmotionError
        If a name is unknown, a weight is not 0 to 1, or those of an emotion are above 1.
    """
    if isinstance(given, Mapping):
        parts = [(str(name), weight) for name, weight in given.items()]
    elif isinstance(given, str):
        split = [part.partition("=") for part in given.split(",") if given.strip()]
        parts = [
            (name.strip().lower(), weight if equals else 1.0) for name, equals, weight in split
        ]
    else:
        raise EmotionError(f"variant {quoted(given)} must be a text such as hot or hot=.7,cold=.3")
    if [name for name, _ in parts] == [PLAIN]:
        return {PLAIN: 1.0}
    found: dict[str, float] = {}
    for name, weight in parts:
        if name not in EMOTION_OF:
            raise EmotionError(f"unknown variant {quoted(name)}; known are {known_variants()}")
        if name in found:
            raise EmotionError(f"variant {name} is given twice; give it once")
        found[name] = number(weight, name, "variant")
        if not 0 <= found[name] <= 1:
            raise EmotionError(f"variant {name}={found[name]:g}: weights must be 0 to 1")
    for emotion, own in VARIANTS.items():
        total = sum(found.get(name, 0.0) for name in own)
        if total > 1 + ROUNDING:
            raise EmotionError(
                f"variants of {emotion} sum to {total:g}; they must not exceed 1: lower them"
            )
    return found


def known_variants() -> str:
    """The names by emotion, in one line."""
    lists = (f"{emotion}: {', '.join(own)}" for emotion, own in VARIANTS.items())
    return f"{'; '.join(lists)}; or {PLAIN}"


def written_variant(variant: Mapping[str, float]) -> str:
    """The text that `parse_variant` reads."""
    return ",".join(n if w == 1 else f"{n}={w:.9g}" for n, w in variant.items())
