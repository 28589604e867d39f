"""Single files of a folder that stays in use; replaced only while they are unedited.

A manifest and the file it lists cannot change in one step. So the hash of the new file is added
to the manifest first, under a name of its own; after a kill `settle` decides by it.
"""

import hashlib
import os
from pathlib import Path

from rig.errors import TargetError
from rig.files.folder import (
    Manifest,
    check_folder,
    digest_of,
    is_changed,
    kind_of,
    read_manifest,
    write_manifest,
)
from rig.files.targets import (
    atomic_write,
    remove_leftovers,
)

_NEXT = ".deitalk-next/"
"""Before the name of a file that is about to be replaced."""


def begin_folder(folder: Path, *, kind: str) -> None:
    """Make a folder that stays in use, or open it again; it has a manifest afterwards.

    Files of killed processes are settled or removed. The caller holds the folder
    (`rig.files.claim`).

    Parameters
    ----------
    folder : Path
        New, empty, or begun with the same kind before.
    kind : str
        Kind of the folder: run, dataset …

    Raises
    ------
    TargetError
        As `rig.files.check_folder` with `force`: if it holds what deitalk did not write, or a file
        of it was edited.
    """
    if kind_of(folder) == kind:
        settle(folder)
    check_folder(folder, kind=kind, force=True)
    folder.mkdir(parents=True, exist_ok=True)
    if read_manifest(folder) is None:
        write_manifest(folder, Manifest(kind, {}))
    remove_leftovers(folder)


def replace_recorded(folder: Path, name: str, text: str) -> None:
    """Write a file and list it in its folder's manifest; a file that is equal is left.

    A process killed at any point leaves the old file or the new one, and `settle` accepts either as
    deitalk's.

    Parameters
    ----------
    folder : Path
        With a manifest (`begin_folder`); no other process writes to it (`rig.files.claim`).
    name : str
        Path within the folder, with ``/``.
    text : str
        Content, written in UTF-8.

    Raises
    ------
    TargetError
        If the file is there and is not the one that deitalk wrote.
    """
    path, manifest = folder / name, settle(folder)
    data = text.encode("utf-8")
    digest = hashlib.sha256(data).hexdigest()
    is_there = os.path.lexists(path)
    if is_there and not is_changed(path, digest):
        if manifest.files.get(name) != digest:
            write_manifest(folder, Manifest(manifest.kind, manifest.files | {name: digest}))
        return
    if is_there:
        _check_own(path, manifest.files.get(name))
    write_manifest(folder, Manifest(manifest.kind, manifest.files | {_NEXT + name: digest}))
    with atomic_write(path) as beside:
        beside.write_bytes(data)
    write_manifest(folder, Manifest(manifest.kind, manifest.files | {name: digest}))


def settle(folder: Path) -> Manifest:
    """Finish the entries of the manifest that a killed `replace_recorded` left; return it.

    Raises
    ------
    TargetError
        If the manifest is damaged.
    """
    manifest = read_manifest(folder) or Manifest("folder", {})
    pending = {n: d for n, d in manifest.files.items() if n.startswith(_NEXT)}
    if not pending:
        return manifest
    files = {n: d for n, d in manifest.files.items() if n not in pending}
    for entry, digest in pending.items():
        path = folder / entry.removeprefix(_NEXT)
        if path.is_file() and digest_of(path) == digest:
            files[entry.removeprefix(_NEXT)] = digest
    settled = Manifest(manifest.kind, files)
    write_manifest(folder, settled)
    return settled


def _check_own(path: Path, digest: str | None) -> None:
    if digest is None:
        raise TargetError(
            f"{path} was not written by deitalk and would be replaced; move it away, or name "
            "another folder"
        )
    if is_changed(path, digest):
        raise TargetError(
            f"{path} was changed since deitalk wrote it; move it away, or name another folder"
        )
