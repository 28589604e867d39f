"""The people whose heads are embedded, and files of other heads."""

from dataclasses import dataclass
from pathlib import Path

from rig.errors import RigError


@dataclass(frozen=True)
class Identity:
    """One person.

    Attributes
    ----------
    name : str
    file : Path, optional
        Head that ``deitalk face import`` wrote; without it, files of the name in ``rig/face/data``.
    stamp : int
        When the file was written, so that a new one is read.
    """

    name: str = "Ada"
    file: Path | None = None
    stamp: int = 0


IDENTITIES = tuple(map(Identity, ("Ada", "Bruno", "Chidi", "Kaya")))
"""A woman, two men and a girl; index 0 is the reference head."""
ROLES = {"female": "Ada", "male": "Bruno", "child": "Kaya"}
"""Heads that stand for a kind of person."""
HEAD_FILE = ".npz"


def identity_of(text: str) -> Identity:
    """Turn what a user typed into an `Identity`: as `resolve_identity`, or the path of a head file.

    A service must not call it: it reads any path.

    Raises
    ------
    RigError
        For an unknown number or name, or a file that is not there.
    """
    if not text.lower().endswith(HEAD_FILE):
        return resolve_identity(text)
    path = Path(text)
    if not path.is_file():
        raise RigError(f"{path} does not exist; `deitalk face import face.glb` writes a head")
    return Identity(path.stem, path.absolute(), path.stat().st_mtime_ns)


def resolve_identity(identity: int | str | Identity) -> Identity:
    """Turn a number, a name, a role or an `Identity` into an `Identity`.

    Raises
    ------
    RigError
        For an unknown number or name.
    """
    if isinstance(identity, Identity) and identity.file is not None:
        return identity
    word = (identity.name if isinstance(identity, Identity) else str(identity)).lower()
    word = ROLES.get(word, word).lower()
    for number, known in enumerate(IDENTITIES):
        if word in (str(number), known.name.lower()):
            return known
    names = ", ".join((*ROLES, *(known.name for known in IDENTITIES)))
    raise RigError(
        f"identity {identity!r} is unknown; use 0 to {len(IDENTITIES) - 1} or one of {names}"
    )
