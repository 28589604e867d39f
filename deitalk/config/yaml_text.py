"""YAML from untrusted files: plain values only, with bounded size and nesting.

With aliases a text of 1 kB may expand to gigabytes, so values are counted with every alias
expanded, while the text is parsed and before anything is built.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from deitalk.errors import ConfigError
from rig import limits
from rig.errors import quoted, shorten
from rig.files.reading import read_text

ErrorClass = Callable[[str], Exception]

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_BUILD_ERRORS = (
    yaml.YAMLError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    OverflowError,
    RecursionError,
)
"""Exceptions of PyYAML for values such as ``!!int x`` or the date 2024-99-99."""
_TOO_DEEP = f"nested deeper than {limits.NESTING} levels"


def read_yaml(path: Path, *, error: ErrorClass = ConfigError) -> Any:
    """Return the content of a YAML file.

    Parameters
    ----------
    path : Path
        A regular file of at most `limits.YAML_BYTES`, UTF-8 or UTF-16 with mark.
    error : callable
        Makes the exception from its message.

    Raises
    ------
    ConfigError
        Or what `error` makes: if the file cannot be read, or as in `load_yaml`.
    """
    text = read_text(path, limits.YAML_BYTES, error=error, may_be_empty=True)
    return load_yaml(text, path, error=error)


def load_yaml(text: str, where: object, *, error: ErrorClass = ConfigError) -> Any:
    """Return the content of a YAML text: null, booleans, numbers, texts, dates, lists and mappings.

    Parameters
    ----------
    text : str
        One document.
    where : object
        Begins the message: a path or a setting.
    error : callable
        Makes the exception from its message.

    Raises
    ------
    ConfigError
        Or what `error` makes: if the text is too long, no YAML, nested too deep, has too many
        values, or a tag or value that is not plain.
    """
    if len(text) > limits.YAML_BYTES:
        raise error(
            f"{where}: {len(text)} characters of YAML; at most {limits.YAML_BYTES} are read"
        )
    try:
        _check_events(yaml.parse(text, Loader=_Loader))
        return yaml.load(text, Loader=_Loader)
    except _BUILD_ERRORS as problem:
        reason = " ".join(shorten(str(problem), 500).split()) or type(problem).__name__
        if isinstance(problem, RecursionError) or "maximum nesting depth" in reason:
            reason = _TOO_DEEP  # libyaml reads ahead, and has a limit of its own
        raise error(f"{where}: cannot be read as YAML ({shorten(reason, 200)})") from None


@dataclass
class _Node:
    """A list or mapping that is being parsed: values in it, and levels below it."""

    anchor: str | None
    values: int = 1
    height: int = 1


def _check_events(events: Iterator[Any]) -> None:
    """Raise ValueError if a text is too large or nested too deep, aliases expanded."""
    open_nodes = [_Node(None)]
    anchored: dict[str, _Node] = {}
    for event in events:
        done = None
        if isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append(_Node(event.anchor))
        elif isinstance(event, yaml.CollectionEndEvent):
            done = open_nodes.pop()
        elif isinstance(event, yaml.ScalarEvent):
            done = _Node(event.anchor, height=0)
            if len(event.value) > limits.SCALAR_CHARACTERS:
                raise ValueError(
                    f"a value of {len(event.value)} characters; at most {limits.SCALAR_CHARACTERS}"
                )
        elif isinstance(event, yaml.AliasEvent):
            done = anchored.get(str(event.anchor))
            if done is None:
                raise ValueError(f"alias {quoted(event.anchor)} has no complete anchor")
        if done is not None:
            _add(open_nodes[-1], done, anchored)
        if len(open_nodes) - 2 + open_nodes[-1].height > limits.NESTING:
            raise ValueError(_TOO_DEEP)


def _add(parent: _Node, node: _Node, anchored: dict[str, _Node]) -> None:
    parent.values += node.values
    parent.height = max(parent.height, node.height + 1)
    if node.anchor is not None:
        anchored[node.anchor] = node
    if parent.values > limits.YAML_VALUES:
        raise ValueError(f"more than {limits.YAML_VALUES} values, aliases counted; shorten it")
