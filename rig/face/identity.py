"""Parameters of a procedural head."""

from dataclasses import dataclass
from typing import Any

from rig.errors import RigError
from rig.files.reading import rows_of

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Identity:
    """Proportions and colours of one head.

    Ratios multiply the dimensions in `rig.face.geometry`; offsets are in cm; angles in
    degrees; colours are sRGB in 0..1. The mesh has the same topology for every identity.
    """

    name: str = "Ada"
    skull_width: float = 1.0
    face_width: float = 1.0
    jaw_width: float = 1.0
    jaw_drop_cm: float = 0.0
    chin_forward_cm: float = 0.0
    chin_width: float = 1.0
    cheek: float = 1.0
    brow_ridge: float = 1.0
    eye_size: float = 1.0
    eye_spacing: float = 1.0
    eye_tilt_degrees: float = 3.0
    eye_height: float = 1.0
    nose_length: float = 1.0
    nose_width: float = 1.0
    nose_height: float = 1.0
    nose_tip_up_cm: float = 0.0
    mouth_width: float = 1.0
    mouth_lift_cm: float = 0.0
    lip_fullness: float = 1.0
    neck_width: float = 1.0
    ear_size: float = 1.0
    brow_thickness: float = 1.0
    brow_lift_cm: float = 0.0
    hair_volume_cm: float = 0.55
    hair_length_cm: float = 0.0
    hair_parting: float = 0.35
    skin: RGB = (0.86, 0.67, 0.57)
    lips: RGB = (0.72, 0.42, 0.40)
    hair: RGB = (0.23, 0.15, 0.11)
    iris: RGB = (0.33, 0.47, 0.55)
    shirt: RGB = (0.36, 0.42, 0.47)
    beard: float = 0.0
    freckles: float = 0.3
    creases: float = 0.6


def _identity(row: dict[str, str]) -> Identity:
    """An identity by a row of the table; what an empty cell names is that of every head."""
    values: dict[str, Any] = {"name": row.pop("name")}
    for name, cell in row.items():
        numbers = tuple(map(float, cell.split()))
        if numbers:
            values[name] = numbers if len(numbers) > 1 else numbers[0]
    return Identity(**values)


IDENTITIES = tuple(map(_identity, rows_of("face/identities.csv")))
"""Ten adults and two children (Kaya and Leo); index 0 is the reference head."""
ROLES = {"female": "Dana", "male": "Bruno", "child": "Kaya"}
"""Heads that stand for a kind of person."""


def resolve_identity(identity: int | str | Identity) -> Identity:
    """Turn a number, a name, a role or an `Identity` into an `Identity`.

    Raises
    ------
    RigError
        For an unknown number or name.
    """
    if isinstance(identity, Identity):
        return identity
    word = str(identity).lower()
    word = ROLES.get(word, word).lower()
    for number, known in enumerate(IDENTITIES):
        if word in (str(number), known.name.lower()):
            return known
    names = ", ".join((*ROLES, *(known.name for known in IDENTITIES)))
    raise RigError(
        f"identity {identity!r} is unknown; use 0 to {len(IDENTITIES) - 1} or one of {names}"
    )
