"""How much of the motion above the mouth is wanted: ``brows=.8,head=1.2,blinks=1,gaze=.5``."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from deitalk.config.rules import Idle
from deitalk.errors import DeitalkError
from deitalk.postprocess.life.listener import NO_PLACE
from rig.errors import quoted
from rig.written_number import number_of

MOST = 2.0
FURTHEST_LOOK = 35.0
"""Degrees; an eye turns little further."""
DISTANCES = (20.0, 10_000.0)
"""Cm, of the listener."""
USUAL_CM = NO_PLACE[2]


@dataclass(frozen=True)
class Life:
    """Factors on the motion that a model's rules have; 0 is off, 1 as measured on people.

    Attributes
    ----------
    blinks, gaze, brows, head : float, range 0 to 2
        Of the blinks more or fewer; of the others wider or smaller.
    look_at : tuple of float
        Place of the listener: degrees to the character's left and up, -35 to 35, and its distance,
        20 to 10,000 cm, on which both eyes meet.
    """

    blinks: float = 1.0
    gaze: float = 1.0
    brows: float = 1.0
    head: float = 1.0
    look_at: tuple[float, float, float] = NO_PLACE

    @classmethod
    def of(cls, life: "Life | Mapping[str, float] | str") -> "Life":
        """Check text (factors, ``on`` or ``off``) or a mapping of names to factors.

        Raises
        ------
        DeitalkError
            If a name is unknown, or a factor is not a number from 0 to 2.
        """
        if isinstance(life, Life):
            return life
        if life in ("on", "off"):
            return cls() if life == "on" else OFF
        if isinstance(life, str):
            life = _parsed(life)
        if not isinstance(life, Mapping):
            raise DeitalkError(
                f"life {quoted(life)} is a {type(life).__name__}; give text such as {_EXAMPLE}, or "
                "a mapping"
            )
        factors: dict[str, Any] = {
            _known(name): _factor(name, value) for name, value in life.items()
        }
        return cls(**factors)

    @property
    def is_off(self) -> bool:
        """Whether nothing moves."""
        return not any(getattr(self, name) for name in PARTS) and self.look_at[:2] == (0.0, 0.0)

    def times(self, idle: Idle) -> "Life":
        """These factors on a model's own."""
        return replace(self, **{part: getattr(idle, part) * getattr(self, part) for part in PARTS})

    def __str__(self) -> str:
        """The text that `of` reads."""
        factors = {name: getattr(self, name) for name in PARTS}
        if not any(factors.values()):
            return "off"
        named = (f"{name}={factor:.9g}" for name, factor in factors.items() if factor != 1)
        return ",".join(named) or "on"


PARTS = tuple(part.name for part in fields(Life) if part.name != "look_at")
OFF = Life(0.0, 0.0, 0.0, 0.0)
_EXAMPLE = "brows=.8,head=1.2,blinks=1,gaze=.5"


def _parsed(text: str) -> dict[str, Any]:
    """Names and factors of text."""
    factors: dict[str, Any] = {}
    for pair in filter(None, (part.strip() for part in text.split(","))):
        name, sign, value = (part.strip() for part in pair.partition("="))
        if not sign or name in factors:
            raise DeitalkError(f"life {quoted(pair)}; write it as {_EXAMPLE}, each name once")
        factors[name] = value
    return factors


def _known(name: Any) -> str:
    if name not in PARTS:
        raise DeitalkError(f"life has no {quoted(name)}; known are {', '.join(PARTS)}")
    return str(name)


def _factor(name: Any, value: Any) -> float:
    number = number_of(value) if isinstance(value, str | int | float) else math.nan
    if not 0 <= number <= MOST:
        raise DeitalkError(f"life: {name}={quoted(value)} must be a number from 0 to {MOST:g}")
    return float(f"{number:.9g}")  # as text has it


def place_of(look_at: Any) -> tuple[float, float, float]:
    """The listener's place of two or three numbers, or of text such as ``10,-5`` or ``10,-5,120``.

    Raises
    ------
    DeitalkError
        If it is not two numbers from -35 to 35, with or without a distance in cm.
    """
    parts = look_at.split(",") if isinstance(look_at, str) else look_at
    try:
        side, up, *distance = (float(part) for part in parts)
    except (TypeError, ValueError):
        side = up = math.nan
        distance = []
    far = distance[0] if distance else USUAL_CM
    is_near = math.isfinite(side) and math.isfinite(up) and max(abs(side), abs(up)) <= FURTHEST_LOOK
    if not is_near or len(distance) > 1 or not DISTANCES[0] <= far <= DISTANCES[1]:
        raise DeitalkError(
            f"look_at {quoted(look_at)} must be two numbers, degrees to the character's left and "
            f"up, -{FURTHEST_LOOK:g} to {FURTHEST_LOOK:g}, and may have a third, the distance, "
            f"{DISTANCES[0]:g} to {DISTANCES[1]:g} cm: such as 10,-5 or 10,-5,120"
        )
    return side, up, far
