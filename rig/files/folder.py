"""A whole folder written at once: staged, then exchanged file by file.

A folder that does not exist yet is filled beside its place and renamed. An existing one receives a
hidden stage within it; once the stage is complete, a journal lists what is to be moved and removed,
so that the next start finishes the exchange of a killed process.

::

    take/
      .deitalk-manifest.json        files that deitalk wrote, with hashes
      .deitalk-journal.json         only while files are exchanged
      .deitalk-<hash>-<host>-…/     only while files are written: the stage
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rig.errors import ExistsError, TargetError, is_disk_full, listed
from rig.files.atomic import PREFIX, atomic_write, no_space, remove_leftovers, temporary_name
from rig.files.claims import claim
from rig.files.manifest import (
    MANIFEST,
    Manifest,
    digest_of,
    is_changed,
    is_inside,
    read_manifest,
    write_manifest,
)
from rig.files.targets import Inputs, check_place, is_same

JOURNAL = ".deitalk-journal.json"
_STAGE = "stage"
_IGNORED = (".DS_Store", "Thumbs.db", "desktop.ini")
"""Files that file managers leave in any folder they show."""


def check_folder(
    folder: Path | str,
    *,
    kind: str,
    force: bool = False,
    inputs: Inputs = (),
    names: Iterable[str] = (),
) -> None:
    """Refuse a folder that must not or cannot be filled, before any work is done.

    Parameters
    ----------
    folder : Path or str
        Folder to write: new, empty, or of the same kind and written by deitalk before.
    kind : str
        Kind of the folder in its manifest: take, model, frames, shapes …
    force : bool
        Whether a folder that deitalk wrote before may be written again.
    inputs : iterable of path or None
        Files that are read; none of them is ever replaced.
    names : iterable of str
        Files that will be written, where they are known already.

    Raises
    ------
    ExistsError
        If deitalk wrote it before and `force` is not set.
    TargetError
        If it is a place that is never filled (`rig.files.targets.check_place`), holds files that
        deitalk did not write or something of another kind, or a file of it was edited or is an
        input.
    """
    folder = Path(folder)
    check_place(folder)
    if not folder.is_dir() or not _visible(folder):
        return
    manifest = read_manifest(folder)
    if manifest is None:
        raise TargetError(
            f"{folder} holds files that deitalk did not write ({listed(_visible(folder))}); "
            "name another folder"
        )
    if manifest.kind != kind:
        raise TargetError(f"{folder} holds {manifest.kind}, not {kind}; name another folder")
    if not force:
        raise ExistsError(
            f"{folder} exists; name another folder, or set `force=True`", parameter="force"
        )
    _check_kept(folder, manifest.files, names)
    for source in inputs:
        for name in (*manifest.files, *names):
            if source is not None and is_same(folder / name, source):
                raise TargetError(f"{source} is also an input; name another folder")


@contextmanager
def output_folder(
    folder: Path | str, *, kind: str, force: bool = False, inputs: Inputs = ()
) -> Iterator[Path]:
    """Yield an empty stage; make it, or exchange it for, `folder` if the block succeeds.

    Files that deitalk wrote there before are replaced, those it no longer writes are removed, and
    all others stay. On an error the folder stays as it was.

    Parameters
    ----------
    folder, kind, force, inputs
        See `check_folder`; missing folders above are made.

    Yields
    ------
    Path
        Folder to write into.

    Raises
    ------
    TargetError
        As `check_folder`, if another process writes to the folder, or if a file that deitalk did
        not write is where one is to be written.
    """
    folder = Path(folder)
    check_place(folder)
    with claim(folder):
        recover(folder)
        check_folder(folder, kind=kind, force=force, inputs=inputs)
        if folder.is_dir():
            remove_leftovers(folder)
            stage = folder / temporary_name(_STAGE)
        else:
            folder.parent.mkdir(parents=True, exist_ok=True)
            remove_leftovers(folder.parent, folder.name)
            stage = folder.parent / temporary_name(folder.name)
        with _staged(stage, folder, kind):
            yield stage


def begin_folder(folder: Path, *, kind: str) -> None:
    """Make a folder that stays in use, or open it again; it has a manifest afterwards.

    What killed processes left is finished or removed. The caller holds the folder
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
        As `check_folder` with `force`: if it holds what deitalk did not write, or a file of it was
        edited.
    """
    recover(folder)
    check_folder(folder, kind=kind, force=True)
    folder.mkdir(parents=True, exist_ok=True)
    if read_manifest(folder) is None:
        write_manifest(folder, Manifest(kind, {}))
    remove_leftovers(folder)


def replace_recorded(folder: Path, name: str, text: str) -> None:
    """Write one file of a folder that stays in use; a file that is equal is left.

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
    recover(folder)
    manifest, data = read_manifest(folder) or Manifest("folder", {}), text.encode("utf-8")
    digest = hashlib.sha256(data).hexdigest()
    if os.path.lexists(folder / name) and not is_changed(folder / name, digest):
        if manifest.files.get(name) != digest:
            write_manifest(folder, Manifest(manifest.kind, manifest.files | {name: digest}))
        return
    stage = folder / temporary_name(_STAGE)
    with _staged(stage, folder, manifest.kind, is_addition=True):
        (stage / name).parent.mkdir(parents=True, exist_ok=True)
        (stage / name).write_bytes(data)


@contextmanager
def _staged(stage: Path, folder: Path, kind: str, *, is_addition: bool = False) -> Iterator[None]:
    """Make a stage, and bring what the block leaves in it to its place.

    Files that deitalk wrote before and that are not staged again are removed, unless the stage is
    an addition to them.
    """
    try:
        stage.mkdir()
        yield
        _commit(stage, folder, kind, is_addition)
    except Exception as error:
        if is_disk_full(error):
            raise no_space(folder) from error
        raise
    finally:
        recover(folder)  # where an interrupt came while files were exchanged
        shutil.rmtree(stage, ignore_errors=True)


def _commit(stage: Path, folder: Path, kind: str, is_addition: bool) -> None:
    staged = sorted(path for path in stage.rglob("*") if not path.is_dir())
    files = {path.relative_to(stage).as_posix(): digest_of(path) for path in staged}
    if stage.parent != folder:
        write_manifest(stage, Manifest(kind, files))
        try:
            os.rename(stage, folder)
        except OSError:
            if not folder.exists():
                raise
            raise TargetError(f"{folder} appeared meanwhile; name another folder") from None
        return
    old = read_manifest(folder) or Manifest(kind, {})
    others = {name: digest for name, digest in old.files.items() if name not in files}
    replaced = {name: old.files[name] for name in files if name in old.files}
    _check_kept(folder, replaced if is_addition else old.files, files)
    write_manifest(stage, Manifest(kind, others | files if is_addition else files))
    journal = {
        "stage": stage.name,
        "moves": {name: old.files.get(name) for name in files},
        "removes": {} if is_addition else others,
    }
    with atomic_write(folder / JOURNAL) as beside, beside.open("w", encoding="utf-8") as file:
        json.dump(journal, file)
        file.flush()
        os.fsync(file.fileno())
    _exchange(folder, journal)


def recover(folder: Path | str) -> bool:
    """Finish the exchange that a killed process began in a folder.

    Returns
    -------
    bool
        Whether there was one.

    Raises
    ------
    TargetError
        If another process writes to the folder.
    """
    folder = Path(folder)
    path = folder / JOURNAL
    if not path.is_file():
        return False
    with claim(folder):
        journal = _read_journal(path)
        if journal is not None:
            _exchange(folder, journal)
        path.unlink(missing_ok=True)
        remove_leftovers(folder)
    return journal is not None


def _read_journal(path: Path) -> dict[str, Any] | None:
    """A journal; None where it is not one of ours."""
    try:
        journal = json.loads(path.read_text(encoding="utf-8"))
        names = [*journal["moves"], *journal["removes"]]
        stage = str(journal["stage"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    is_ours = stage.startswith(PREFIX) and is_inside(stage) and "/" not in stage
    is_ours = is_ours and not (path.parent / stage).is_symlink()
    return journal if is_ours and all(is_inside(name) for name in names) else None


def _lies_in(folder: Path, path: Path) -> bool:
    """Whether the folder of a path, all links followed, is `folder` or below it."""
    return path.parent.resolve().is_relative_to(folder.resolve())


def _exchange(folder: Path, journal: dict[str, Any]) -> None:
    """Move what is staged, remove what is gone, the manifest last; may be repeated at any point.

    A file whose hash differs from the journal's is the user's and stays.
    """
    stage = folder / journal["stage"]
    for name, before in journal["moves"].items():
        source, target = stage / name, folder / name
        if not source.is_file() or not (_lies_in(folder, source) and _lies_in(folder, target)):
            continue  # moved by the process that was killed, or a linked subfolder leads elsewhere
        if os.path.lexists(target) and (before is None or is_changed(target, before)):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(source, target)
    for name, before in journal["removes"].items():
        target = folder / name
        if _lies_in(folder, target) and target.is_file() and not is_changed(target, before):
            target.unlink()
            _remove_empty(target.parent, folder)
    if (stage / MANIFEST).is_file():
        os.replace(stage / MANIFEST, folder / MANIFEST)
    (folder / JOURNAL).unlink(missing_ok=True)
    shutil.rmtree(stage, ignore_errors=True)


def _remove_empty(folder: Path, top: Path) -> None:
    """Remove folders between a removed file and the top that hold nothing more."""
    with suppress(OSError):
        while folder != top:
            folder.rmdir()
            folder = folder.parent


def remove_written(folder: Path) -> None:
    """Remove the unchanged files that a folder's manifest lists, and the folder if nothing is left.

    Changed files, files of others and a folder without a manifest stay.

    Raises
    ------
    TargetError
        If the manifest is damaged.
    """
    with claim(folder):
        manifest = None if folder.is_symlink() else read_manifest(folder)
        if manifest is None:
            return
        changed = {n: d for n, d in manifest.files.items() if is_changed(folder / n, d)}
        for name in manifest.files.keys() - changed.keys():
            (folder / name).unlink(missing_ok=True)
            _remove_empty((folder / name).parent, folder)
        if changed:
            write_manifest(folder, Manifest(manifest.kind, changed))
            return
        (folder / MANIFEST).unlink()
        with suppress(OSError):  # files of others
            folder.rmdir()


def _check_kept(folder: Path, own: dict[str, str], names: Iterable[str]) -> None:
    """Raise where a file would be lost: an edited one of ours, or another's of the same name."""
    edited = [n for n, digest in own.items() if is_changed(folder / n, digest)]
    if edited:
        raise TargetError(
            f"{listed([str(folder / n) for n in edited])} was changed since deitalk wrote it; "
            "move it away, or name another folder"
        )
    foreign = [n for n in names if n not in own and os.path.lexists(folder / n)]
    if foreign:
        raise TargetError(
            f"{listed([str(folder / n) for n in foreign])} was not written by deitalk and would be "
            "replaced; move it away, or name another folder"
        )


def _visible(folder: Path) -> list[str]:
    """Names in a folder without deitalk's own hidden and temporary files."""
    try:
        names = os.listdir(folder)
    except OSError as error:
        raise TargetError(f"cannot read {folder}: {error.strerror}; name another folder") from None
    return sorted(
        n for n in names if n not in _IGNORED and (not n.startswith(PREFIX) or n == MANIFEST)
    )
