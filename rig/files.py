"""Write beside, then rename: a reader never meets a half-written file."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it onto `path` if the block succeeds.

    The temporary name keeps the suffix, so that writers which look at it still work. On an
    error (a full disk, an interrupt) the temporary file or folder is removed and `path` stays
    as it was.

    Parameters
    ----------
    path : Path or str
        File or folder to make. Its parent must exist. An existing file is replaced; an existing
        folder is replaced only if it can be removed first.

    Yields
    ------
    Path
        Where to write; a file, or a folder the block makes itself.
    """
    path = Path(path)
    beside = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        yield beside
        if beside.is_dir() and path.is_dir():
            shutil.rmtree(path)
        os.replace(beside, path)
    finally:
        if beside.is_dir():
            shutil.rmtree(beside, ignore_errors=True)
        else:
            beside.unlink(missing_ok=True)
