"""Manifest of the files that deitalk wrote into a folder: a hidden JSON file of names and hashes.

A command replaces and removes only files that are listed there and unchanged since.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from rig.errors import TargetError
from rig.files.atomic import atomic_write, remove_leftovers
from rig.files.claims import claim

MANIFEST = ".deitalk-manifest.json"
SCHEMA = "deitalk.manifest/1"
MAX_BYTES = 64 * 1024**2
"""Some 600,000 files; three hours of frames at 30 per second, a file each, are 324,000."""


class Manifest(NamedTuple):
    """Kind of a folder, and the SHA-256 of each file that deitalk wrote into it."""

    kind: str
    """take, model, frames, shapes …"""
    files: dict[str, str]
    """Path within the folder, with ``/``: hexadecimal SHA-256."""


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a folder; None if there is none.

    Raises
    ------
    TargetError
        If it is damaged.
    """
    path = folder / MANIFEST
    if not path.is_file() or path.is_symlink():
        return None
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"{path.stat().st_size} bytes")
        tree = json.loads(path.read_text(encoding="utf-8"))
        files = {str(name): str(digest) for name, digest in tree["files"].items()}
        if tree["schema"] != SCHEMA or not all(is_inside(name) for name in files):
            raise ValueError("unknown content")
        return Manifest(str(tree["kind"]), files)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise TargetError(
            f"{path} is damaged, so what deitalk wrote there is unknown; name another folder"
        ) from None


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest of a folder, whole or not at all."""
    tree: dict[str, Any] = {
        "schema": SCHEMA,
        "about": "files deitalk wrote here; it replaces and removes no others",
        "kind": manifest.kind,
        "files": dict(sorted(manifest.files.items())),
    }
    with atomic_write(folder / MANIFEST) as beside:
        text = json.dumps(tree, indent=1, ensure_ascii=True) + "\n"
        beside.write_text(text, encoding="utf-8")


def record(folder: Path, names: Iterable[str], *, kind: str) -> None:
    """Add files to a folder's manifest as they are now; one is begun if there is none.

    Parameters
    ----------
    folder : Path
        Holds the files.
    names : iterable of str
        Paths within the folder, with ``/``.
    kind : str
        What the folder is, where the manifest is begun.
    """
    with claim(folder):
        remove_leftovers(folder, MANIFEST)  # of a process that was killed here
        old = read_manifest(folder)
        new = {name: digest_of(folder / name) for name in names}
        write_manifest(
            folder, Manifest(old.kind if old else kind, (old.files if old else {}) | new)
        )


def kind_of(folder: Path) -> str | None:
    """Kind of a folder in its manifest; None if it has none."""
    manifest = read_manifest(folder)
    return None if manifest is None else manifest.kind


def is_changed(path: Path, digest: str) -> bool:
    """Whether the path exists and is not the file with this hash."""
    if not os.path.lexists(path):
        return False
    return path.is_symlink() or not path.is_file() or digest_of(path) != digest


def digest_of(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_inside(name: str) -> bool:
    """Whether a path stays within its folder: relative, without ``..`` and without a drive."""
    parts = PurePosixPath(name).parts
    return bool(parts) and not name.startswith("/") and ".." not in parts and ":" not in parts[0]
