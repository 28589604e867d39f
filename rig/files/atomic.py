"""Atomic writing of one file: it is written beside its place, then renamed."""

import hashlib
import os
import re
import secrets
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rig.errors import TargetError, is_disk_full

PREFIX = ".deitalk-"
"""Beginning of the names of all temporary files and folders."""
_HOST = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:6]


def temporary_name(name: str) -> str:
    """Hidden name of the temporary file of `name`; it has the same suffix.

    ``.deitalk-<hash of name>-<hash of host>-<random><suffix>``.
    """
    suffix = Path(name).suffix
    return f"{PREFIX}{_digest(name)}-{_HOST}-{secrets.token_hex(4)}{suffix}"


def _digest(name: str) -> str:
    return hashlib.sha256(os.fsencode(name)).hexdigest()[:8]


@contextmanager
def atomic_write(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it onto `path` if the block succeeds.

    On an error (a full disk, an interrupt) the temporary file is removed and `path` stays as it
    was. A symbolic link stays a link: the file it points to is replaced. The permissions of a
    file that is replaced are kept.

    Parameters
    ----------
    path : Path or str
        File to make; its folder must exist. Whole folders are written by
        `rig.files.output_folder`.

    Yields
    ------
    Path
        File to write.

    Raises
    ------
    OSError
        If the folder cannot be written to, or `path` is a folder.
    TargetError
        If the disk is full.
    """
    path = Path(os.path.realpath(path)) if os.path.islink(path) else Path(path)
    beside = path.with_name(temporary_name(path.name))
    try:
        yield beside
        if path.is_file():
            with suppress(OSError):
                shutil.copymode(path, beside)
        os.replace(beside, path)
    except Exception as error:
        if is_disk_full(error):
            raise no_space(path) from error
        raise
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)


def no_space(path: Path) -> TargetError:
    """The error of a full disk, naming a path that the user knows, not a temporary one."""
    return TargetError(f"{path}: no space left on the disk; free some, or name another place")


def remove_leftovers(folder: Path, name: str | None = None) -> int:
    """Remove temporary files and folders that ended processes of this machine left in `folder`.

    Call it only where no other process writes to `folder`, as under `rig.files.claim`.

    Parameters
    ----------
    folder : Path
        Looked through without its subfolders; one that does not exist holds nothing.
    name : str, optional
        Only those on their way to this name.

    Returns
    -------
    int
        How many were removed.
    """
    digest = "[0-9a-f]{8}" if name is None else _digest(name)
    pattern = re.compile(rf"{re.escape(PREFIX)}{digest}-{_HOST}-[0-9a-f]{{8}}(\.[^/]*)?")
    count = 0
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if not pattern.fullmatch(entry.name):
                continue
            is_folder = entry.is_dir(follow_symlinks=False)
            with suppress(OSError):
                (shutil.rmtree if is_folder else os.unlink)(entry.path)
                count += 1
    return count
