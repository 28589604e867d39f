"""Cache of heads on disk: plain arrays in the user's cache folder."""

import hashlib
import zipfile
from collections.abc import Callable
from dataclasses import astuple
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.face.identity import Identity
from rig.files import atomic_write, cache_folder

Arrays = dict[str, NDArray[Any]]


@lru_cache(maxsize=1)
def _source_key() -> str:
    """Digest of the code that builds heads: heads of older code are not used."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def load_or_build(identity: Identity, build: Callable[[Identity], Arrays]) -> Arrays:
    """Arrays of a head from the cache, or built and then kept where the folder can be written."""
    key = hashlib.sha256(f"{_source_key()} {astuple(identity)}".encode()).hexdigest()[:20]
    path = cache_folder() / f"head-{key}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, zipfile.BadZipFile):
        arrays = build(identity)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as beside:
            np.savez(beside, **arrays)  # type: ignore[arg-type]
    except OSError:
        pass  # a cache that cannot be written is no error: the head is built again next time
    return arrays
