"""Models by their names on the Hugging Face hub: ``org/name`` or ``org/name@revision``.

A revision is a branch, a tag or a commit; without one it is ``main``. The hub is asked once in a
process; where it does not answer, or with ``HF_HUB_OFFLINE=1``, the cache of `huggingface_hub` is
what there is. Settings of that package (``HF_HOME``, ``HF_ENDPOINT``, ``HF_TOKEN``) hold.
"""

import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path, PurePath
from typing import Any

from deitalk.errors import CheckpointError
from rig.errors import quoted, shorten

SUFFIXES = (".yaml", ".json", ".safetensors", ".npz", "graph.gz")
"""Suffixes of the files of a model folder, all of which are pushed and fetched; none runs code."""
NEEDED: tuple[str, ...] = ("config.yaml", "model.safetensors")
SECONDS = 5.0
"""Longest wait for the hub's first answer."""
_PART = r"[A-Za-z0-9_][A-Za-z0-9_.-]*"
_NAME = re.compile(rf"({_PART}/{_PART})(?:@([A-Za-z0-9_][A-Za-z0-9_./-]*))?")


def is_hub_name(name: str | Path) -> bool:
    """Whether a name is of the hub's form and no file or folder here, which come first."""
    return _NAME.fullmatch(PurePath(name).as_posix()) is not None and not Path(name).exists()


def check_repository(name: str) -> None:
    """Check the name of a whole repository, without a revision.

    Raises
    ------
    CheckpointError
        If it is none.
    """
    if "@" in name or not _NAME.fullmatch(name):
        raise CheckpointError(f"{quoted(name)} is no name on the hub; it must be org/name")


def pinned(name: str | Path) -> str:
    """A name that stays the same model: of the hub's ``org/name@commit``, others as they are.

    Errors as `fetch`.
    """
    if not is_hub_name(name):
        return str(name)
    name = PurePath(name).as_posix()
    return f"{name.partition('@')[0]}@{fetch(name).name}"


def model_files(names: Iterable[str]) -> tuple[str, ...]:
    """Sorted files of a folder or a repository that belong to a model.

    Parameters
    ----------
    names : iterable of str
        Paths within it.
    """
    return tuple(
        sorted(
            name
            for name in names
            if PurePath(name).name == name
            and (not name.startswith(".") and name.endswith(SUFFIXES))
        )
    )


@lru_cache
def fetch(name: str) -> Path:
    """Return the folder of a hub's model in the cache, fetched if it is not there.

    Parameters
    ----------
    name : str
        Of `is_hub_name`.

    Raises
    ------
    CheckpointError
        If the hub has no such model or refuses it, or there is neither an answer nor a copy.
    """
    from huggingface_hub import snapshot_download

    repo, _, revision = name.partition("@")
    branch = revision or None
    if (info := hub_metadata(name)) is None:
        folder, wanted = _cached(repo, branch), NEEDED
    else:
        wanted = model_files(file.rfilename for file in info.siblings or ())
        if not {*NEEDED} <= {*wanted}:
            raise CheckpointError(
                f"{name}: the hub's model is not one of deitalk, which has {' and '.join(NEEDED)}"
            )
        folder = _cached(repo, info.sha)
        if not _has(folder, wanted):
            try:
                folder = Path(snapshot_download(repo, revision=branch, allow_patterns=[*wanted]))
            except Exception as error:  # of the package, its client of HTTP, and the disk
                raise CheckpointError(f"{name}: not fetched ({cause(error)}") from None
    if folder is None or not _has(folder, wanted):
        raise CheckpointError(
            f"{name}: no folder here, no whole copy in the cache, and no answer of the hub; go "
            "online once, or name a folder"
        )
    return folder


@lru_cache
def hub_metadata(name: str) -> Any:
    """Metadata of a model on the hub, a `huggingface_hub.ModelInfo`; None if it does not answer.

    It is requested once, for `SECONDS` at most, where the package's own functions try for longer.

    Raises
    ------
    CheckpointError
        If it has no such model, or refuses it.
    """
    from huggingface_hub import HfApi, constants
    from huggingface_hub.errors import HfHubHTTPError

    repo, _, revision = name.partition("@")
    if constants.HF_HUB_OFFLINE:
        return None
    try:
        return HfApi().model_info(repo, revision=revision or None, timeout=SECONDS)
    except HfHubHTTPError as error:
        if error.response is None or error.response.status_code >= 500:
            return None
        raise CheckpointError(
            f"{name}: no folder here, and the hub has no such model or revision for you; check "
            "the name, or log in with `hf auth login` if it is private"
        ) from None
    except Exception:  # no connection, in the words of whichever client of HTTP is installed
        return None


def cause(error: Exception) -> str:
    """What failed, the network or the hub, and the way out: ``reason); way out``."""
    from huggingface_hub import constants
    from huggingface_hub.errors import LocalTokenNotFoundError

    status = getattr(getattr(error, "response", None), "status_code", None)
    if status in (401, 403) or isinstance(error, LocalTokenNotFoundError):
        way = "`hf auth login` logs in"
    elif constants.HF_HUB_OFFLINE:
        way = "unset HF_HUB_OFFLINE"
    elif isinstance(error, OSError) and error.filename:
        way = "check the path, the permissions and the space"
    elif status is None:
        way = f"no answer of {constants.ENDPOINT}: check the network"
    else:
        way = "try again" if status >= 500 else "check the name"
    return f"{shorten(' '.join(str(error).split()), 160)}); {way}"


def _cached(repo: str, revision: str | None) -> Path | None:
    from huggingface_hub import try_to_load_from_cache

    found = try_to_load_from_cache(repo, NEEDED[0], revision=revision)
    return Path(found).parent if isinstance(found, str) else None


def _has(folder: Path | None, files: tuple[str, ...]) -> bool:
    return folder is not None and all((folder / file).is_file() for file in files)
