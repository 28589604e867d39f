"""Check a file of curves, or a take folder, by the rules of the programs that import it.

Every finding is an error (an importer refuses it or plays it wrong), a warning (it is probably not
played as intended) or a note (an effect of the import).
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rig.controls import DEFAULT_ID
from rig.conversion.raw import PREFIX, RAW_ID, raw_controls
from rig.curves import RigCurves
from rig.errors import FormatError, RigError, quoted
from rig.formats import read_curves
from rig.formats.curves_json import read_object
from rig.validation.findings import Finding, motion
from rig.validation.live_link import check_live_link, is_live_link

CURVE_SUFFIXES = (".csv", ".json", ".npz", ".tsv", ".xml", ".glb", ".vrma", ".anim")
OTHER_CSV = ("intensity.csv",)
"""Tables of a take that hold no curves."""
FRAME_RATE = 30.0
SHORT = 0.6
"""Seconds of a Live Link CSV that may hold its last frame to be read at its rate."""
WRINKLES = tuple(f"{PREFIX}noseWrinkleUpper{side}" for side in "LR")


@dataclass(frozen=True)
class Validation:
    """All findings, in the order in which they were made."""

    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether there is no error."""
        return all(finding.level != "error" for finding in self.findings)


def validate(path: Path | str) -> Validation:
    """Check a file of any format that we read or write, or a take folder.

    Raises
    ------
    FormatError
        If the path does not exist.
    """
    path = Path(path)
    if path.is_dir():
        return Validation(tuple(_take_folder(path)))
    if not path.exists():
        raise FormatError(f"{path} does not exist; name a take folder or a file of curves")
    return Validation(tuple(_file(path)))


def _take_folder(folder: Path) -> list[Finding]:
    """Check every file of curves, and that they agree on their length."""
    findings: list[Finding] = []
    if (folder / "take.json").is_file():
        findings += _take_json(folder)
    else:
        findings.append(Finding("warning", folder, "no take.json: this is no take of deitalk"))
    durations: dict[str, float] = {}
    for path in sorted(folder.iterdir()):
        is_other = path.name.startswith(".") or path.name in ("take.json", *OTHER_CSV)
        if is_other or path.suffix.lower() not in CURVE_SUFFIXES:
            continue
        found = _file(path)
        findings += found
        is_good = all(finding.level != "error" for finding in found)
        if is_good and not path.name.lower().endswith(tuple(CHECKS)):
            seconds = read_curves(path, control_set=None).duration
            if seconds > SHORT or not is_live_link(path):
                durations[path.name] = seconds
    if not durations:
        findings.append(Finding("error", folder, "no file of curves can be read here"))
    elif max(durations.values()) - min(durations.values()) > 0.1:
        lengths = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in durations.items())
        findings.append(Finding("warning", folder, f"files differ in length: {lengths}"))
    return findings


def _take_json(folder: Path) -> list[Finding]:
    path = folder / "take.json"
    try:
        data = read_object(path)
    except RigError as error:
        return [Finding("error", path, str(error))]
    listed = data.get("files", {})
    names = listed if isinstance(listed, list) else list(listed) if isinstance(listed, dict) else []
    return [
        Finding("error", path, f"lists {name}, which is not in the folder")
        for name in names
        if isinstance(name, str) and not (folder / name).exists()
    ]


def _file(path: Path) -> list[Finding]:
    try:
        for ending, check in CHECKS.items():
            if path.name.lower().endswith(ending):
                return [Finding("note", path, check(path)), *_shapes(path)]
        if path.suffix.lower() == ".csv" and is_live_link(path):
            return check_live_link(path)
        if path.suffix.lower() == ".txt":  # EmoFace's hold no rate
            curves = read_curves(path, fps=FRAME_RATE, control_set=None)
            note = Finding("note", path, f"holds no frame rate: checked at {FRAME_RATE:g} fps")
            return [note, *_curves(path, curves)]
        return _curves(path, read_curves(path, control_set=None))
    except RigError as error:
        return [Finding("error", path, str(error))]


def _shapes(path: Path) -> list[Finding]:
    """Check the curves of a GLB's shapes, if their names are known."""
    if path.suffix.lower() != ".glb":
        return []
    try:
        return _curves(path, read_curves(path, control_set=None))
    except RigError as error:
        return [Finding("note", path, f"its values are not checked: {error}")]


def _curves(path: Path, curves: RigCurves) -> list[Finding]:
    """Check values, which are finite and in range after reading."""
    findings = [Finding("note", path, _summary(curves))]
    findings += motion(path, curves.values, curves.names, curves.control_set)
    if curves.control_set == RAW_ID:
        findings += [
            Finding("warning", path, f"{name} falls to {curves[name].min():g}; it rests at 1")
            for name in WRINKLES
            if name in curves.names and curves[name].min() < 0.5
        ]
        findings.append(
            Finding("note", path, "Unreal takes these as float curves of an AnimSequence")
        )
    if curves.control_set == DEFAULT_ID:
        findings.append(
            Finding("note", path, "Unreal takes these through rig/unreal or deitalk convert")
        )
    return findings


def _summary(curves: RigCurves) -> str:
    return (
        f"{len(curves)} frames at {curves.fps:g} fps, {curves.duration:.2f} s, {len(curves.names)} "
        f"curves of {curves.control_set}"
    )


# Checks of files that are only written: JSON for Unreal, visemes, GLB.


Note = str


def check_unreal_json(path: Path) -> Note:
    """Return a summary of a ``*.unreal.json``.

    Raises
    ------
    FormatError
        If the script inside Unreal would refuse it, or would show a wrong face.
    """
    from rig.formats.unreal_json import SCHEMA, SCHEMAS

    data = read_object(path)
    if data.get("schema") not in SCHEMAS:
        raise FormatError(f"{path}: schema is {quoted(data.get('schema'))}; this reads {SCHEMA!r}")
    n_frames, rate = data.get("n_frames"), data.get("frame_rate")
    if not (isinstance(n_frames, int) and n_frames > 0):
        raise FormatError(f"{path}: 'n_frames' is {n_frames!r}; it must be 1 or more")
    if not (isinstance(rate, list) and len(rate) == 2 and all(_is_count(part) for part in rate)):
        raise FormatError(f"{path}: 'frame_rate' is {rate!r}; it must be two numbers above 0")
    raw, board = data.get("raw"), data.get("board")
    if not (isinstance(raw, dict) and isinstance(board, dict)):
        raise FormatError(f"{path} needs the objects 'raw' and 'board'")
    missing = [name for name in raw_controls().names if name not in raw]
    if missing:
        raise FormatError(f"{path} lacks {missing[0]} and {len(missing) - 1} more raw curves")
    for control, channels in board.items():
        if not (isinstance(channels, dict) and set(channels) in ({"value"}, {"x", "y"})):
            raise FormatError(f"{path}: {control} must have 'value', or 'x' and 'y'")
        for axis, values in channels.items():
            _check_values(path, f"{control} {axis}", values, n_frames, -1.0, 1.0)
    _check_raw(path, raw, board, n_frames)
    seconds = n_frames * rate[1] / rate[0]
    return f"{n_frames} frames at {rate[0]}/{rate[1]} fps, {seconds:.2f} s; for the Unreal script"


def check_visemes(path: Path) -> Note:
    """Return a summary of a ``*.visemes.json``.

    Raises
    ------
    FormatError
        As `rig.formats.viseme_json.read`.
    """
    from rig.formats.viseme_json import read

    curves = read(path)
    return f"{len(curves)} frames at {curves.fps:g} fps of visemes"


def check_glb(path: Path) -> Note:
    """Return a summary of a GLB, of ours or of others.

    Raises
    ------
    FormatError
        If the container is damaged, data lie outside it, or weights do not fit the targets.
    """
    from rig.mesh.glb import read_container

    document, binary = read_container(path)
    try:
        for i, view in enumerate(document.get("bufferViews", [])):
            if view.get("byteOffset", 0) + view["byteLength"] > len(binary):
                raise FormatError(f"{path}: bufferView {i} lies outside the file")
        n_targets = [
            len(mesh["primitives"][0].get("targets", [])) for mesh in document.get("meshes", [])
        ]
        n_frames = _check_animations(path, document, n_targets)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise FormatError(f"{path} is no valid glTF: {error!r}") from None
    return f"glTF 2.0, {sum(n_targets)} morph targets, {n_frames} keys of weights"


CHECKS: dict[str, Callable[[Path], Note]] = {
    ".unreal.json": check_unreal_json,
    ".visemes.json": check_visemes,
    ".glb": check_glb,
}
"""Check by the end of the file name."""


def _check_animations(path: Path, document: dict[str, Any], n_targets: list[int]) -> int:
    accessors, n_frames = document.get("accessors", []), 0
    for animation in document.get("animations", []):
        for channel in animation["channels"]:
            if channel["target"]["path"] != "weights":
                continue
            sampler = animation["samplers"][channel["sampler"]]
            times = accessors[sampler["input"]]["count"]
            node = document["nodes"][channel["target"]["node"]]
            numbers = 3 if sampler.get("interpolation") == "CUBICSPLINE" else 1
            wanted = numbers * times * n_targets[node["mesh"]]
            got = accessors[sampler["output"]]["count"]
            if got != wanted:
                raise FormatError(f"{path}: {got} weights; {times} keys need {wanted}")
            n_frames = max(n_frames, times)
    return n_frames


def _check_raw(path: Path, raw: dict[str, Any], board: dict[str, Any], n_frames: int) -> None:
    for name, values in raw.items():
        if isinstance(values, dict):
            _check_function(path, name, values, board)
        else:
            _check_values(path, name, values, n_frames, 0.0, 1.0)


def _check_function(path: Path, name: str, function: dict[str, Any], board: dict[str, Any]) -> None:
    """Check a raw curve that is a function of channels of the board."""
    channels, knots = function.get("of"), function.get("knots")
    names = [f"{control}.{axis}" for control, axes in board.items() for axis in axes]
    if not isinstance(channels, list) or not channels or any(c not in names for c in channels):
        raise FormatError(f"{path}: {name} is of channels that the board has not")
    try:
        array = np.array(knots, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.ndim != 2 or array.shape[1] != 2 or not (np.diff(array[:, 0]) > 0).all():
        raise FormatError(f"{path}: {name} needs knots: rising places, each with a value")
    _check_values(path, name, array[:, 1].tolist(), len(array), 0.0, 1.0)


def _check_values(
    path: Path, name: str, values: Any, n_frames: int, low: float, high: float
) -> None:
    numbers = values if isinstance(values, list) else [values]
    if isinstance(values, list) and len(values) != n_frames:
        raise FormatError(f"{path}: {name} has {len(values)} values, not {n_frames}")
    try:
        array = np.array(numbers, dtype=np.float64)
    except (TypeError, ValueError):
        raise FormatError(f"{path}: {name} holds something that is no number") from None
    if array.ndim != 1 or array.min() < low - 1e-4 or array.max() > high + 1e-4:
        raise FormatError(f"{path}: {name} leaves its range {low:g} to {high:g}")


def _is_count(part: object) -> bool:
    return isinstance(part, int) and not isinstance(part, bool) and part > 0
