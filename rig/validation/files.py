"""Check a file of curves, or a take folder, by the rules of the programs that import it.

Every finding is an error (an importer refuses it or plays it wrong), a warning (it is probably not
played as intended) or a note (an effect of the import).
"""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rig.controls import DEFAULT_ID
from rig.conversion.convert import known_controls
from rig.conversion.raw import PREFIX, RAW_ID
from rig.curves import RigCurves
from rig.curves.layer_files import read_layers
from rig.curves.layers import SUFFIX
from rig.errors import FormatError, RigError
from rig.formats import read_curves
from rig.formats.curves_json import read_object
from rig.formats.named import is_face_cap
from rig.validation.findings import Finding, Rows, motion
from rig.validation.live_link import check_live_link, is_live_link

CURVE_SUFFIXES = (".csv", ".json", ".npz", ".tsv", ".glb", ".vrma", ".anim")
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
    about = folder / "take.json"
    if about.is_file():
        findings += _file(about)
    else:
        findings.append(Finding("warning", folder, "no take.json: this is no take of deitalk"))
    durations: dict[str, float] = {}
    own = ""  # the control set of a user's own rig
    with suppress(RigError):  # reported with the file
        name = read_curves(folder / "curves.json", control_set=None).control_set
        own = "" if known_controls(name) else name
    for path in sorted(folder.iterdir()):
        is_other = path.name.startswith(".") or path.name in ("take.json", "dub.json", *OTHER_CSV)
        if path.name.endswith(SUFFIX):
            findings += _file(path)
            continue
        if is_other or path.suffix.lower() not in CURVE_SUFFIXES:
            continue
        if own and path.name == "curves.csv":  # it does not name its rig
            findings.append(Finding("note", path, f"of the rig {own}: not checked"))
            continue
        found = _file(path)
        findings += found
        is_good = all(finding.level != "error" for finding in found)
        if is_good and path.suffix.lower() != ".glb":
            seconds = read_curves(path, control_set=None).duration
            if seconds > SHORT or not is_live_link(path):
                durations[path.name] = seconds
    if not durations:
        findings.append(Finding("error", folder, "no file of curves can be read here"))
    elif max(durations.values()) - min(durations.values()) > 0.1:
        lengths = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in durations.items())
        findings.append(Finding("warning", folder, f"files differ in length: {lengths}"))
    return findings


def _file(path: Path) -> list[Finding]:
    """Check one file; what cannot be read is an error."""
    try:
        rows = _rows(path)
    except RigError as error:
        rows = [("error", str(error))]
    return [Finding(level, path, text) for level, text in rows]


def _rows(path: Path) -> Rows:
    name, suffix = path.name.lower(), path.suffix.lower()
    if name == "take.json":
        listed = read_object(path).get("files", {})
        files = [file for file in listed if isinstance(file, str)] if listed else []
        missing = [file for file in files if not (path.parent / file).exists()]
        return [("error", f"lists {file}, which is not in the folder") for file in missing]
    if name.endswith(SUFFIX):
        return [("note", f"{sum(len(layer.edits) for layer in read_layers(path))} edits by hand")]
    if suffix == ".glb":
        summary: Rows = [("note", check_glb(path))]
        try:
            return summary + _curves(read_curves(path, control_set=None))
        except RigError as error:  # names of its shapes that are unknown
            return [*summary, ("note", f"its values are not checked: {error}")]
    if is_live_link(path):
        return check_live_link(path)
    if suffix == ".txt" and not is_face_cap(path):  # EmoFace's hold no rate
        curves = read_curves(path, fps=FRAME_RATE, control_set=None)
        return [("note", f"holds no frame rate: checked at {FRAME_RATE:g} fps"), *_curves(curves)]
    curves = read_curves(path, control_set=None)
    if name.endswith(".unreal.json"):
        _check_functions(path)
    return _curves(curves)


def _check_functions(path: Path) -> None:
    """Refuse raw curves that are no functions of the board, as the script inside Unreal does."""
    data = read_object(path)
    raw, board = (data.get(key) or {} for key in ("raw", "board"))
    parts = [(control, axes) for control, axes in board.items() if isinstance(axes, dict)]
    known = {f"{control}.{axis}" for control, axes in parts for axis in axes}
    for name, function in raw.items():
        if not isinstance(function, dict):
            continue
        try:
            places, _ = np.array(function["knots"], np.float64).T
            is_one = {*function["of"]} <= known and function["of"] and (np.diff(places) > 0).all()
        except (KeyError, TypeError, ValueError):
            is_one = False
        if not is_one:
            raise FormatError(f"{path}: {name} is no function of channels of the board")


def _curves(curves: RigCurves) -> Rows:
    """Check values, which are finite and in range after reading."""
    summary = (
        f"{len(curves)} frames at {curves.fps:g} fps, {curves.duration:.2f} s, {len(curves.names)} "
        f"curves of {curves.control_set}"
    )
    findings: Rows = [("note", summary)]
    findings += [("warning", note) for note in curves.notes]
    findings += motion(curves.values, curves.names, curves.control_set)
    if curves.control_set == RAW_ID:
        findings += [
            ("warning", f"{name} falls to {curves[name].min():g}; it rests at 1")
            for name in WRINKLES
            if name in curves.names and curves[name].min() < 0.5
        ]
        findings.append(("note", "Unreal takes these as float curves of an AnimSequence"))
    if curves.control_set == DEFAULT_ID:
        findings.append(("note", "Unreal takes these through rig/unreal or deitalk convert"))
    return findings


def check_glb(path: Path) -> str:
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
