"""YAML files and ``section.key=value`` to checked settings; files of the Hugging Face hub."""

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path, PurePath
from typing import Annotated, Any

from pydantic import Field, TypeAdapter

from deitalk.config.curves import Config, FinetuneConfig
from deitalk.config.mesh import SDFAConfig
from deitalk.config.section import checked, load_yaml, read_yaml
from deitalk.errors import CheckpointError, ConfigError
from rig import limits
from rig.errors import quoted, shorten

AnyConfig = Config | SDFAConfig
_ANY: TypeAdapter[AnyConfig] = TypeAdapter(
    Annotated[Config | FinetuneConfig | SDFAConfig, Field(discriminator="kind")]
)


def parse_config(tree: dict[str, Any]) -> AnyConfig:
    """Check a tree of settings; its ``kind`` chooses the class, ``deitalk`` if it has none.

    Parameters
    ----------
    tree : dict
        Content of a YAML file; missing keys take their defaults.

    Raises
    ------
    ConfigError
        With the key, the value and the rule of every problem, in one line.
    """
    return checked(_ANY.validate_python, {"kind": "deitalk"} | tree)


def load_config(path: Path | str, overrides: Sequence[str] = ()) -> AnyConfig:
    """Read a YAML file and apply overrides such as ``train.batch_size=8``.

    Parameters
    ----------
    path : path
        YAML; an empty file is the paper's configuration.
    overrides : sequence of str
        ``section.key=value``, the value in YAML; later ones win.

    Raises
    ------
    ConfigError
        If the file is missing, is no YAML mapping, or holds an unknown key or a bad value.
    """
    return parse_config(read_tree(path, overrides))


def read_tree(path: Path | str | None, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Settings of a YAML file, unchecked, with overrides; parameters and errors as `load_config`.

    Without a file there are the overrides alone.
    """
    tree = {} if path is None else read_yaml(Path(path)) or {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: holds a {type(tree).__name__}; a configuration is a mapping")
    for override in overrides:
        _override(tree, override)
    return tree


def without_paths(config: AnyConfig) -> AnyConfig:
    """A configuration without folders of this machine; of a model's the last part of it stays."""
    tree = config.model_dump(mode="json")
    tree["data"] |= {"noise_folder": None, "room_folder": None}
    sections = [(tree["model"]["frontend"], "checkpoint")]
    sections += [(tree["train"], key) for key in ("teacher", "frozen_frontend")]
    if "tune" in tree:
        tree["tune"]["corpus"] = None
        sections.append((tree["tune"], "base"))
    for section, key in sections:
        if section.get(key) is not None and Path(section[key]).is_absolute():
            section[key] = Path(section[key]).name
    return parse_config(tree)


def _override(tree: dict[str, Any], override: str) -> None:
    key, equals, value = override.partition("=")
    if not equals:
        raise ConfigError(f"override {quoted(override)} has no '='; write train.batch_size=8")
    *parents, leaf = key.split(".")
    if len(parents) >= limits.NESTING:
        raise ConfigError(f"override {quoted(override)} nests {len(parents)} levels; name a key")
    for parent in parents:
        tree = tree.setdefault(parent, {})
        if not isinstance(tree, dict):
            raise ConfigError(
                f"override {quoted(override)}: {quoted(parent)} is a value, not a section"
            )
    tree[leaf] = load_yaml(value, f"override {quoted(override)}")


# Models by their names on the Hugging Face hub: ``org/name`` or ``org/name@revision``.
#
# A revision is a branch, a tag or a commit; without one it is ``main``. The hub is asked once in a
# process; where it does not answer, or with ``HF_HUB_OFFLINE=1``, the cache of `huggingface_hub` is
# what there is. Settings of that package (``HF_HOME``, ``HF_ENDPOINT``, ``HF_TOKEN``) hold.


FILES = (
    "config.yaml",
    "model.json",
    "model.safetensors",
    "encoder.safetensors",
    "controls.yaml",
    "templates.npz",
)
"""All that a model folder holds; nothing else of a repository is fetched."""
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
        wanted = tuple(f for f in FILES if f in {file.rfilename for file in info.siblings or ()})
        if not {*NEEDED} <= {*wanted}:
            raise CheckpointError(
                f"{name}: the hub's model is not one of deitalk, which has {' and '.join(NEEDED)}"
            )
        folder = _cached(repo, info.sha)
        if not _has(folder, wanted):
            try:
                folder = Path(snapshot_download(repo, revision=branch, allow_patterns=[*wanted]))
            except Exception as error:  # of the package, its client of HTTP, and the disk
                reason = shorten(" ".join(str(error).split()), 160)
                raise CheckpointError(f"{name}: not fetched ({reason}); try again") from None
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


def _cached(repo: str, revision: str | None) -> Path | None:
    from huggingface_hub import try_to_load_from_cache

    found = try_to_load_from_cache(repo, NEEDED[0], revision=revision)
    return Path(found).parent if isinstance(found, str) else None


def _has(folder: Path | None, files: tuple[str, ...]) -> bool:
    return folder is not None and all((folder / file).is_file() for file in files)
