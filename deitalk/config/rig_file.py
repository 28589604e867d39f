"""Files that describe a rig other than the board: the controls a model is to move.

::

    id: my_rig@1
    controls:                       # in any order; the model's output has this one
      jaw_open: {region: jaw}       # 0 to 1 and 0 at rest, unless said otherwise
      mouth_wide: {minimum: -1, maximum: 1, rest: 0.1}
      smile_l: {}
      smile_r: {}
    mirror: [[smile_l, smile_r]]    # pairs of one motion on two sides
    lip: [jaw_open, mouth_wide, smile_l, smile_r]
    upper_face: []

The sets say which controls shut in silence (``lip``), and what LPE and EPE are measured on.

Rigs of `RIGS` need no file. Their names are public: ARKit's 52 shapes and 9 rotations of Live Link
Face, MetaHuman's raw curves, Character Creator 4, Daz Genesis 8 and 9 (tables of `rig.conversion`),
and the 116 weights of FACEGOOD-Audio2Face (MIT), in the order of its files.
"""

import re
from collections.abc import Iterable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field, ValidationError

from deitalk.config.section import Section, rule
from deitalk.config.yaml_files import load_yaml, read_yaml
from deitalk.errors import ConfigError
from rig import ControlSet, default_controls
from rig.controls import DEFAULT_ID, Control
from rig.conversion.arkit import ARKIT_ID
from rig.conversion.convert import known_controls
from rig.conversion.raw import RAW_ID
from rig.errors import ControlError, quoted

RIG_SUFFIXES = (".yaml", ".yml")
DATASET_RIG = "rig.yaml"
"""Name of the rig file in a dataset folder of another rig than the board."""
RIGS = {
    "arkit": ARKIT_ID,
    "metahuman-raw": RAW_ID,
    "cc4": "cc4",
    "daz8": "daz8",
    "daz9": "daz9",
    "facegood": "facegood-116",
}
"""Public rigs by name, and their control sets."""
_SIDES = {"left": "right", "right": "left", "l": "r", "r": "l"}
_SIDE = re.compile(r"left|right|[lr]$|(?<![a-z0-9])[lr](?=_)")
"""Parts of names in lower case that differ between a pair."""
_PARTS = {
    "lip": re.compile("mouth|jaw|lip|tongue|tooth|teeth|viseme|^v_|ctrlv"),
    "upper_face": re.compile("brow|eye|blink|lid"),
}
"""Names of controls that shut in silence, and of those that are scored as upper face."""


class RigControl(Section):
    """One control of a rig."""

    minimum: float = 0.0
    maximum: float = 1.0
    rest: float = 0.0
    region: str = ""


class RigFile(Section):
    """Content of a rig file."""

    id: str = Field(min_length=1, max_length=100)
    controls: dict[str, RigControl | None] = Field(min_length=1)
    mirror: tuple[tuple[str, str], ...] = ()
    lip: tuple[str, ...] = ()
    upper_face: tuple[str, ...] = ()


def read_controls(name: str) -> ControlSet:
    """Control set of a configuration: the board by its id, one of `RIGS`, or that of a rig file.

    Raises
    ------
    ConfigError
        If it is none, or the file describes no rig: unknown keys, doubled or unknown names, a rest
        value outside its range.
    """
    if name == DEFAULT_ID:
        return default_controls()
    if name in RIGS:
        id = RIGS[name]
        controls = known_controls(id)
        if controls is None:
            with resources.as_file(
                resources.files("rig.conversion").joinpath("facegood.csv")
            ) as path:
                controls = ControlSet.from_csv(path, id=id)
        return classified_by_names(id, controls.controls)
    path = Path(name)
    if path.suffix not in RIG_SUFFIXES:
        raise ConfigError(
            f"rig {quoted(name)} is no rig file (.yaml), and none of {DEFAULT_ID}, "
            f"{', '.join(RIGS)}"
        )
    return _checked(path, read_yaml(path))


def classified_by_names(id: str, controls: Iterable[Control]) -> ControlSet:
    """A control set whose sides, mouth and upper face follow from the controls' names."""
    by_lower = {control.name.lower(): control for control in controls}
    classified = []
    for lower, control in by_lower.items():
        other = _SIDE.sub(lambda part: _SIDES[part[0]], lower)
        mirror = by_lower[other].name if other != lower and other in by_lower else ""
        part = next((part for part, names in _PARTS.items() if names.search(lower)), None)
        sets = frozenset([part] if part else ())
        classified.append(replace(control, mirror=mirror, sets=sets))
    return ControlSet(id, tuple(classified))


def rig_of_dataset(folder: Path, rig: str | None = None) -> str | None:
    """File of the rig of a dataset folder: the given one, else the one that it holds."""
    own = folder / DATASET_RIG
    return str(own) if rig is None and own.is_file() else rig


def parse_controls(text: str, where: Path) -> ControlSet:
    """Control set of the text of a rig file; `where` begins messages. Errors as `read_controls`."""
    return _checked(where, load_yaml(text, where))


def _checked(path: Path, tree: Any) -> ControlSet:
    try:
        rig = RigFile.model_validate(tree)
        mirrors = {a: b for pair in rig.mirror for a, b in (pair, pair[::-1])}
        sets = {"lip": rig.lip, "upper_face": rig.upper_face}
        named = {*mirrors, *rig.lip, *rig.upper_face}
        for name in sorted(named - rig.controls.keys()):
            raise ConfigError(f"{path}: {quoted(name)} is in a pair or a set, but is no control")
        return ControlSet(
            rig.id,
            tuple(
                Control(
                    name,
                    **(settings or RigControl()).model_dump(),
                    mirror=mirrors.get(name, ""),
                    sets=frozenset(key for key, names in sets.items() if name in names),
                )
                for name, settings in rig.controls.items()
            ),
        )
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        key = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ConfigError(f"{path}: {key}: {rule(first, RigFile)}") from None
    except ControlError as error:
        raise ConfigError(f"{path}: {error}") from None


def rig_text(controls: ControlSet) -> str:
    """Text of a rig file, from which `read_controls` makes an equal control set."""
    mirror = [[c.name, c.mirror] for c in controls.controls if c.mirror and c.name < c.mirror]
    tree: dict[str, Any] = {
        "id": controls.id,
        "controls": {
            c.name: {"minimum": c.minimum, "maximum": c.maximum, "rest": c.rest, "region": c.region}
            for c in controls.controls
        },
        "mirror": mirror,
    }
    for key in ("lip", "upper_face"):
        tree[key] = [c.name for c in controls.controls if key in c.sets]
    return yaml.safe_dump(tree, sort_keys=False)
