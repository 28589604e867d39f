"""Layers of edits in files, and the text of their fields."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from rig import limits
from rig.curves.edit import MAX_FACTOR
from rig.curves.layers import (
    DECIMALS,
    KEY_LENGTHS,
    LEVELS,
    MODES,
    MOST_EDITS,
    MOST_LAYERS,
    SCHEMA,
    SUFFIX,
    Edit,
    Layer,
    Sound,
)
from rig.errors import CurveError, quoted
from rig.files.reading import load_json, read_text

LIST: Any = list | tuple


def read_layers(path: Path) -> tuple[Layer, ...]:
    """Read a file of a layer or of a list of layers, or the layers that lie in a take folder.

    Raises
    ------
    CurveError
        As `parse_layers`; if the file is missing or too large, or the folder has no layers.
    """
    if path.is_dir():
        files = sorted(path.glob(f"*{SUFFIX}"))
        if not files:
            raise CurveError(f"{path} holds no layers (*{SUFFIX}); name a file of edits")
        return tuple(layer for file in files for layer in read_layers(file))
    layers = parse_layers(read_text(path, limits.EDIT_BYTES, error=_unreadable), path.name)
    if not layers:
        raise CurveError(f"{path} is an empty list of layers; name another file of edits")
    return layers


def parse_layers(given: Any, where: str = "edit") -> tuple[Layer, ...]:
    """Layers of JSON text or of what it holds: a layer, or a list of layers.

    Raises
    ------
    CurveError
        One line: which edit, the value and the rule.
    """
    tree = given
    if isinstance(given, str | bytes):
        tree = load_json(given, where, error=_unreadable)
    trees = list(tree) if isinstance(tree, list | tuple) else [tree]
    if len(trees) > MOST_LAYERS:
        raise CurveError(f"{where} holds {len(trees)} layers; at most {MOST_LAYERS} are read")
    return tuple(one if isinstance(one, Layer) else _layer(one, where) for one in trees)


def _unreadable(told: str) -> CurveError:
    return CurveError(f"{told}; `deitalk diff` writes a file of edits")


def _layer(tree: Any, where: str) -> Layer:
    if not isinstance(tree, Mapping) or tree.get("schema") != SCHEMA:
        raise CurveError(f"{where} is no layer of edits: its schema must be {SCHEMA}")
    _known(tree, ("schema", "name", "muted", "sound", "words", "phones", "edits"), where)
    edits = _of(LIST, tree.get("edits"), f"{where}: edits", MOST_EDITS)
    return Layer(
        tuple(_edit(one, f"{where}, edit {k}") for k, one in enumerate(edits, 1)),
        _of(str, tree.get("name", ""), f"{where}: name"),
        _of(bool, tree.get("muted", False), f"{where}: muted"),
        _sound(tree.get("sound"), where),
        _words(tree.get("words", []), where),
        _phones(tree.get("phones", ""), where),
    )


def _edit(tree: Any, where: str) -> Edit:
    if not isinstance(tree, Mapping):
        raise CurveError(f"{where} is {quoted(tree)}; it must be an object with target and keys")
    _known(tree, ("target", "mode", "span", "ease", "keys", "owns", "words"), where)
    target, mode = _of(str, tree.get("target", ""), f"{where}: target"), tree.get("mode", "offset")
    if not target:
        raise CurveError(f"{where} has no target; name a control, a region or head.yaw")
    if mode not in MODES:
        raise CurveError(f"{where}: mode {quoted(mode)} must be {', '.join(MODES)}")
    given = _of(LIST, tree.get("keys"), f"{where}: keys", limits.KEYS)
    keys = [_key(key, where) for key in given]
    if not keys:
        raise CurveError(f"{where} has no keys; give at least one [time, value]")
    for before, after in pairwise(keys):
        if after[0] <= before[0]:
            raise CurveError(f"{where}: key at {after[0]:g} s comes after {before[0]:g}; sort them")
    span = _numbers(tree.get("span", (keys[0][0], keys[-1][0])), 2, f"{where}: span")
    ease = _numbers(tree.get("ease", (0, 0)), 2, f"{where}: ease")
    if not 0 <= span[0] <= span[1] <= limits.SECONDS:
        raise CurveError(f"{where}: span {span[0]:g} to {span[1]:g} s must rise, from 0 on")
    if min(ease) < 0:
        raise CurveError(f"{where}: ease {min(ease):g} s must be 0 or more")
    owns = _of(bool, tree.get("owns", False), f"{where}: owns")
    words = _of(str, tree.get("words", ""), f"{where}: words")
    return Edit(target, tuple(keys), mode, (span[0], span[1]), (ease[0], ease[1]), owns, words)


def _key(given: Any, where: str) -> tuple[float, float, float, float]:
    if not isinstance(given, list | tuple) or len(given) not in KEY_LENGTHS:
        raise CurveError(
            f"{where}: key {quoted(given)} must be [time, value] or [time, value, arriving slope, "
            "leaving slope]"
        )
    time, value, arrive, leave = (*_numbers(given, len(given), f"{where}: key"), 0.0, 0.0)[:4]
    if not 0 <= time <= limits.SECONDS:
        raise CurveError(f"{where}: key at {time:g} s must be within 0 to {limits.SECONDS:g} s")
    return time, value, arrive, leave


def _sound(tree: Any, where: str) -> Sound | None:
    if tree is None:
        return None
    if not isinstance(tree, Mapping) or not isinstance(tree.get("levels"), str):
        raise CurveError(f"{where}: sound must hold seconds and levels; leave it out")
    if not set(tree["levels"]) <= set(LEVELS):
        raise CurveError(f"{where}: levels of the sound must be letters and digits; leave it out")
    (seconds,) = _numbers([tree.get("seconds")], 1, f"{where}: sound")
    return Sound(seconds, tree["levels"])


def _words(given: Any, where: str) -> tuple[tuple[str, float, float], ...]:
    found = []
    for word in _of(LIST, given, f"{where}: words"):
        if not isinstance(word, list | tuple) or len(word) != 3:
            raise CurveError(f"{where}: word {quoted(word)} must be [text, start, end]")
        start, end = _numbers(word[1:], 2, f"{where}: word")
        found.append((_of(str, word[0], f"{where}: word"), start, end))
    return tuple(found)


def _phones(given: Any, where: str) -> tuple[tuple[str, int], ...]:
    parts = _of(str, given, f"{where}: phones").split()
    names, lengths = parts[::2], parts[1::2]
    if len(names) != len(lengths) or not all(n.isascii() and n.isdigit() for n in lengths):
        raise CurveError(f"{where}: phones must be names, each with a whole number; leave them out")
    return tuple((name, int(length[:7])) for name, length in zip(names, lengths, strict=True))


def _known(tree: Mapping[str, Any], names: Sequence[str], where: str) -> None:
    for name in tree:
        if name not in names:
            raise CurveError(f"{where}: no field {quoted(name)}; known are {', '.join(names)}")


def _of(kind: Any, given: Any, where: str, most: int = limits.KEYS) -> Any:
    """A value of a kind: a list of at most so many, a text or a flag."""
    if not isinstance(given, kind):
        name = {str: "a text", bool: "true or false"}.get(kind, "a list")
        raise CurveError(f"{where} must be {name}, not {quoted(given)}")
    if kind is LIST and len(given) > most:
        raise CurveError(f"{where} are {len(given)}; at most {most} are read")
    return given


def _numbers(given: Any, count: int, where: str) -> list[float]:
    """Finite numbers of a list."""
    numbers = list(given) if isinstance(given, list | tuple) else []
    for number in numbers:
        is_number = isinstance(number, int | float) and not isinstance(number, bool)
        if not is_number or not math.isfinite(number) or abs(number) > MAX_FACTOR:
            raise CurveError(f"{where} {quoted(number)} must be a finite number within ±1e6")
    if len(numbers) != count:
        raise CurveError(f"{where} {quoted(given)} must be {count} numbers")
    return [round(float(number), DECIMALS) for number in numbers]
