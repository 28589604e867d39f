"""Files written whole, and rules of the paths that may be written to, checked before any work."""

import os
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path

from rig.errors import ExistsError, TargetError

Inputs = Iterable[Path | str | None]

LONGEST_SUFFIX = 8
"""Most characters of a suffix that is a file type."""


def check_file(path: Path | str, *, force: bool = False, inputs: Inputs = ()) -> None:
    """Refuse a file that must not or cannot be written.

    Parameters
    ----------
    path : Path or str
        File to write.
    force : bool
        Whether an existing file may be replaced.
    inputs : iterable of path or None
        Files that are read; none of them is ever replaced.

    Raises
    ------
    ExistsError
        If the file is there and `force` is not set.
    TargetError
        If it is a folder, a device, a pipe or an input, or its folder is not there or cannot be
        written to.
    """
    path = Path(path)
    mode = _mode(path)
    if mode is not None and stat.S_ISDIR(mode):
        raise TargetError(f"{path} is a folder; name a file")
    if mode is not None and not stat.S_ISREG(mode):
        raise TargetError(f"{path} is a device or a pipe; name a file")
    for source in inputs:
        if source is not None and is_same(path, source):
            raise TargetError(f"{path} is also an input; name another file")
    if mode is not None and not force:
        raise ExistsError(
            f"{path} exists; name another file, or set `force=True`", parameter="force"
        )
    parent = Path(os.path.realpath(path)).parent
    if not parent.is_dir():
        raise TargetError(f"{parent} is not a folder; make it first, or name another file")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise TargetError(f"{parent} cannot be written to; name another folder")


def is_folder_name(target: Path | str, suffixes: Sequence[str]) -> bool:
    """Whether a target is a folder or one file; the same rule for commands and Python.

    A folder is: an existing folder, a name that ends with a slash, a name without suffix, and a
    name whose suffix is no file type (``Scene 1.2``: only digits, a space in it, or more than 8
    characters). A file is a name that ends with one of `suffixes`.

    Parameters
    ----------
    target : Path or str
        A `Path` keeps no slash at its end: give text where that matters.
    suffixes : sequence of str
        Of the files that can be written, lower case, such as ``.csv``.

    Raises
    ------
    TargetError
        If the name is empty, or its suffix may be a file type but is none of `suffixes`.
    """
    text = os.fspath(target)
    if not text:
        raise TargetError("the name of the output is empty; name a file or a folder")
    separators = tuple(filter(None, (os.sep, os.altsep)))
    if text.endswith(separators) or os.path.isdir(text):
        return True
    name = os.path.basename(text)
    if name.lower().endswith(tuple(suffixes)):
        return False
    ending = Path(name).suffix.removeprefix(".")
    if not ending or ending.isdigit() or " " in ending or len(ending) > LONGEST_SUFFIX:
        return True
    raise TargetError(
        f"{text}: '.{ending}' is no suffix that is written; files end with "
        f"{', '.join(suffixes)}, a folder with a slash: {text}/"
    )


def check_place(folder: Path | str) -> None:
    """Refuse a folder that no command may fill, empty or not.

    Raises
    ------
    TargetError
        If it is the current folder or above it, the home folder or above it, a mount point, a
        symbolic link, no folder, or cannot be made or written to.
    """
    folder = Path(folder)
    if folder.is_symlink():
        raise TargetError(f"{folder} is a symbolic link; name the folder it points to, or another")
    mode = _mode(folder)
    if mode is not None and not stat.S_ISDIR(mode):
        raise TargetError(f"{folder} is a file; a folder is written, name another")
    real = Path(os.path.realpath(folder))
    home = Path(os.path.realpath(os.path.expanduser("~")))
    for kept, what in ((Path.cwd(), "the current folder"), (home, "the home folder")):
        if real == kept or real in kept.parents:
            where = what if real == kept else f"above {what}"
            raise TargetError(f"{folder} is {where}; name a new folder, such as {folder}/take")
    if os.path.ismount(real):
        raise TargetError(f"{folder} is a mount point; name a folder in it")
    # The folder, or the nearest one above it that exists, must take new files.
    nearest = real
    while not nearest.exists():
        nearest = nearest.parent
    if not nearest.is_dir():
        raise TargetError(f"cannot write {real}: {nearest} is a file; name another folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise TargetError(f"cannot write {real}: {nearest} is read-only; name another folder")


def is_same(one: Path | str, other: Path | str) -> bool:
    """Whether two paths name one existing file, by links too."""
    try:
        return os.path.samefile(one, other)
    except (OSError, ValueError):
        return False


def _mode(path: Path) -> int | None:
    """Kind of the file at a path; None if there is none."""
    try:
        return os.stat(path).st_mode
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise TargetError(f"cannot write {path}: {reason}; name another path") from None
