"""The people whose heads are embedded."""

from dataclasses import dataclass

from rig.errors import RigError


@dataclass(frozen=True)
class Identity:
    """One person; files of that name are in ``rig/face/data``."""

    name: str = "Ada"


IDENTITIES = tuple(map(Identity, ("Ada", "Bruno", "Chidi", "Kaya")))
"""A woman, two men and a girl; index 0 is the reference head."""
ROLES = {"female": "Ada", "male": "Bruno", "child": "Kaya"}
"""Heads that stand for a kind of person."""


def resolve_identity(identity: int | str | Identity) -> Identity:
    """Turn a number, a name, a role or an `Identity` into an `Identity`.

    Raises
    ------
    RigError
        For an unknown number or name.
    """
    word = (identity.name if isinstance(identity, Identity) else str(identity)).lower()
    word = ROLES.get(word, word).lower()
    for number, known in enumerate(IDENTITIES):
        if word in (str(number), known.name.lower()):
            return known
    names = ", ".join((*ROLES, *(known.name for known in IDENTITIES)))
    raise RigError(
        f"identity {identity!r} is unknown; use 0 to {len(IDENTITIES) - 1} or one of {names}"
    )
