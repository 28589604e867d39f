"""Files of a batch at URLs that fsspec reaches.

Outputs at a URL are made in a folder of this machine's cache, as those of any batch, and copied to
the URL at the end of a run. What was changed, added or removed there since is copied here before
the next run, which any machine can make.
"""

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from deitalk.batch.outputs import PRIVATE, STAGE, Outputs, opened_folder
from deitalk.errors import DataError, MissingError
from rig.errors import TargetError, UserError, listed, one_line, quoted
from rig.files import cache_folder, claim

COPIED = f"{PRIVATE}/copied.json"
"""For each file of the last copy its state at the URL, and its size and time here."""
_VERSIONS = (
    "ETag", "etag", "md5Hash", "content_md5", "mtime", "LastModified", "last_modified", "updated",
    "created",
)  # fmt: skip
"""Entries of file information that change with the content, the best first."""


def is_url(path: str | Path) -> bool:
    """Whether a path is one that fsspec reads."""
    return "://" in str(path)


@contextmanager
def cloud_errors(url: str) -> Iterator[None]:
    """Turn errors of a storage service into one line."""
    try:
        yield
    except UserError:
        raise
    except FileNotFoundError:
        raise DataError(f"{url} does not exist; check the address") from None
    except ImportError as error:
        raise MissingError(one_line(f"{url}: {error}")) from None
    except Exception as error:  # every service has its own
        text = f"{url}: {type(error).__name__}: {error}; check the address and the access"
        raise DataError(one_line(text)) from None


def file_system(url: str) -> tuple[Any, str]:
    """Fsspec's file system of a URL, and the path in it."""
    import fsspec

    with cloud_errors(url):
        system, path = fsspec.core.url_to_fs(url)
        return system, path.rstrip("/")


def version_of(info: dict[str, Any]) -> str:
    """State of a file in a storage service: size, and what changes with its content."""
    changing = next((info[name] for name in _VERSIONS if info.get(name)), "")
    if hasattr(changing, "timestamp"):  # one service gives a time in two ways
        changing = changing.timestamp()
    if isinstance(changing, float):
        changing = f"{changing:.3f}"
    return f"{info.get('size') or 0}-{changing}"


@contextmanager
def opened_url(url: str) -> Iterator[Outputs]:
    """The outputs at a URL, in a folder of the cache; they are copied to the URL at the end.

    Raises
    ------
    TargetError
        If another process of this machine writes there, or the URL holds files of others alone.
    """
    folder = cache_folder() / "batch" / hashlib.sha256(url.rstrip("/").encode()).hexdigest()[:32]
    with claim(folder):
        with cloud_errors(url):
            _fetch(url, folder)
        with opened_folder(folder, url) as outputs:
            yield outputs
        with cloud_errors(url):
            _copy(url, folder)


def _fetch(url: str, folder: Path) -> None:
    """Bring a folder to the state of a URL, where that is not the one that was copied there."""
    system, root = file_system(url)
    system.invalidate_cache()
    there = _versions(system, root)
    if there and not any(name.startswith(f"{PRIVATE}/") for name in there):
        raise TargetError(f"{url} holds files that deitalk did not write; name another")
    known = _copied(folder)
    for name in [name for name in known if name not in there]:
        (folder / name).unlink(missing_ok=True)
    for name, version in there.items():
        if known.get(name, [""])[0] == version and (folder / name).is_file():
            continue
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        system.get_file(f"{root}/{name}", str(folder / name))
    _note(folder, there)


def _copy(url: str, folder: Path) -> None:
    """Bring a URL to the state of a folder, if nobody changed there what would be replaced."""
    system, root = file_system(url)
    system.invalidate_cache()
    known, here, there = _copied(folder), _states(folder), _versions(system, root)
    made = [name for name, state in here.items() if known.get(name, [])[1:] != state]
    gone = [name for name in known if name not in here]
    changed = [
        name for name in (*made, *gone) if there.get(name) not in (None, *known.get(name, [])[:1])
    ]
    if changed:
        raise DataError(
            f"{url}: {listed(changed)} changed there during the run; nothing was copied, the "
            "results are kept here: run again"
        )
    for name in made:
        system.makedirs(f"{root}/{name}".rpartition("/")[0], exist_ok=True)
        system.put_file(str(folder / name), f"{root}/{name}")
    for name in gone:
        if name in there:
            system.rm_file(f"{root}/{name}")
    system.invalidate_cache()
    _note(folder, _versions(system, root))


def _versions(system: Any, root: str) -> dict[str, str]:
    found = system.find(root, detail=True).items()
    there = {name[len(root) + 1 :]: version_of(info) for name, info in found}
    there.pop(COPIED, None)  # of this machine alone
    for name in there:
        path = Path(name)
        if path.is_absolute() or path.drive or ".." in path.parts:
            raise DataError(f"{quoted(name)} at {root} names a file outside of it; remove it")
    return there


def _states(folder: Path) -> dict[str, list[int]]:
    """Size and time of the files of a folder that are copied."""
    return {
        name: [path.stat().st_size, path.stat().st_mtime_ns]
        for path in folder.rglob("*")
        if path.is_file()
        and (name := path.relative_to(folder).as_posix()) != COPIED
        and not name.startswith(f"{STAGE}/")
    }


def _copied(folder: Path) -> dict[str, list[Any]]:
    path = folder / COPIED
    return dict(json.loads(path.read_text())) if path.is_file() else {}


def _note(folder: Path, there: dict[str, str]) -> None:
    states = _states(folder)
    (folder / PRIVATE).mkdir(parents=True, exist_ok=True)
    copied = {name: [there[name], *state] for name, state in states.items() if name in there}
    (folder / COPIED).write_text(json.dumps(copied))
