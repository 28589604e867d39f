"""YAML files and ``section.key=value`` to checked settings; an unknown key is an error."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from deitalk.config.curves import Config
from deitalk.config.finetuning import FinetuneConfig
from deitalk.config.mesh import SDFAConfig
from deitalk.config.section import checked
from deitalk.config.yaml_files import load_yaml, read_yaml
from deitalk.errors import ConfigError
from rig import limits
from rig.errors import quoted

AnyConfig = Config | SDFAConfig
CONFIGS: dict[str, type[AnyConfig]] = {
    "deitalk": Config,
    "finetune": FinetuneConfig,
    "sdfa": SDFAConfig,
}
"""Class of each ``kind``; a package with kinds of its own adds them."""


def parse_config(tree: dict[str, Any], where: object = "configuration") -> AnyConfig:
    """Check a tree of settings; its ``kind`` chooses the class, ``deitalk`` if it has none.

    Parameters
    ----------
    tree : dict
        Content of a YAML file; missing keys take their defaults.
    where : path or str
        Begins the message of an error.

    Raises
    ------
    ConfigError
        With the key, the value and the rule of every problem, in one line.
    """
    kind = tree.get("kind", "deitalk")
    if not isinstance(kind, str) or kind not in CONFIGS:
        raise ConfigError(f"{where}: kind={quoted(kind)}: must be one of {', '.join(CONFIGS)}")
    return checked(CONFIGS[kind], tree | {"kind": kind}, where)


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
    return parse_config(read_tree(path, overrides), named(path, overrides))


def named(path: Path | str | None, overrides: Sequence[str] = ()) -> str:
    """Name of a configuration in messages."""
    if path is None:
        return "configuration"
    return f"{path} with overrides" if overrides else str(path)


OF_MODEL = ("name", "model", "rules")
"""Sections of a configuration that a model folder has; those of its training stay with the run."""


def load_model_config(folder: Path) -> AnyConfig:
    """Read the configuration of a model folder: what describes the model.

    Settings of a training that earlier versions left there, and those of a user's own training,
    are not read. Errors as `load_config`.
    """
    tree = read_tree(folder / "config.yaml")
    kind = CONFIGS.get(tree.get("kind", "deitalk"))
    if kind is not None:
        tree = {key: tree[key] for key in OF_MODEL if key in tree} | {"kind": kind.stored_kind}
    return parse_config(tree, folder / "config.yaml")


def model_text(config: AnyConfig) -> str:
    """Text of a model folder's ``config.yaml``."""
    tree = config.model_dump(mode="json", include=set(OF_MODEL))
    return yaml.safe_dump({"kind": config.stored_kind, **tree}, sort_keys=False)


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
    """A model's configuration without folders of this machine; of a model's the last part stays."""
    tree = config.model_dump(mode="json")
    frontend = tree["model"]["frontend"]
    if Path(frontend.get("checkpoint") or "").is_absolute():
        frontend["checkpoint"] = Path(frontend["checkpoint"]).name
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
