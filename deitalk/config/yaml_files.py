"""YAML from untrusted files: plain values only, with bounded size and nesting.

With aliases a text of 1 kB may expand to gigabytes, so they are refused; values are counted
while the text is parsed and before anything is built.
"""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from deitalk.errors import ConfigError
from rig import limits
from rig.errors import quoted, shorten
from rig.files.reading import read_text

ErrorClass = Callable[[str], Exception]

_Plain: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
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


class _Loader(_Plain):  # type: ignore[misc]
    """Plain values; a key that is given twice in a mapping is an error."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        for key, count in keys.items():
            if count > 1:
                raise ValueError(f"key {quoted(key)} is given twice; give it once")
        return super().construct_mapping(node, deep)


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
        # Raise ValueError if a text has aliases, is too large or is nested too deep.
        events = yaml.parse(text, Loader=_Loader)
        depth, values = 0, 1
        for event in events:
            if isinstance(event, yaml.AliasEvent):
                raise ValueError(
                    f"alias {quoted(f'*{event.anchor}')} is not read; repeat the value"
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            values += isinstance(event, yaml.CollectionStartEvent | yaml.ScalarEvent)
            if depth > limits.NESTING:
                raise ValueError(_TOO_DEEP)
            if values > limits.YAML_VALUES:
                raise ValueError(f"more than {limits.YAML_VALUES} values; shorten it")
            if isinstance(event, yaml.ScalarEvent) and len(event.value) > limits.SCALAR_CHARACTERS:
                raise ValueError(
                    f"a value of {len(event.value)} characters; at most {limits.SCALAR_CHARACTERS}"
                )
        return yaml.load(text, Loader=_Loader)
    except _BUILD_ERRORS as problem:
        reason = " ".join(shorten(str(problem), 500).split()) or type(problem).__name__
        if isinstance(problem, RecursionError) or "maximum nesting depth" in reason:
            reason = _TOO_DEEP  # libyaml reads ahead, and has a limit of its own
        raise error(f"{where}: cannot be read as YAML ({shorten(reason, 200)})") from None
