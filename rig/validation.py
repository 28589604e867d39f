"""Check a file of curves, or a take folder, by the rules of the programs that import it.

Every finding is an error (an importer refuses it or plays it wrong), a warning (it is probably not
played as intended) or a note (an effect of the import).
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rig.arrays import AnyFloat
from rig.controls import DEFAULT_ID
from rig.conversion.arkit import ARKIT_ID, PREFIX, RAW_ID, arkit_controls
from rig.conversion.convert import known_controls
from rig.curves import RigCurves
from rig.curves.layers import SUFFIX, read_layers
from rig.errors import FormatError, RigError
from rig.files.reading import decode_text, open_file
from rig.formats import read_curves
from rig.formats.curves_json import read_object
from rig.formats.livelink_csv import COUNT, LiveLinkTake, read_take, subject_of, suffix_note
from rig.formats.named import is_face_cap
from rig.formats.units import in_units
from rig.formats.wide_csv import count_rows, read_header
from rig.limits import CURVES_BYTES, HEADER_BYTES

# One finding of a check of files.


Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One finding.

    Parameters
    ----------
    level : str
        ``error``, ``warning`` or ``note``.
    path : Path
        The file.
    text : str
        One line.
    """

    level: Level
    path: Path
    text: str


# Curves that never move, jumps, and a mouth that stays open at the end.


OPEN_MOUTH = 0.1
"""Jaw opening at the end of a clip above which a warning is given."""
JUMP = 0.8
"""Share of a control's range that is too far for one frame."""
MOUTH_SHAPES = ("JawOpen", "CTRL_C_jaw.ty", f"{PREFIX}jawOpen")


def motion(path: Path, values: AnyFloat, names: tuple[str, ...], control_set: str) -> list[Finding]:
    """Find curves that never move, jumps, and a mouth that stays open at the end."""
    findings = []
    dead = [name for name, still in zip(names, np.ptp(values, axis=0) < 1e-6, strict=True) if still]
    if len(dead) == len(names):
        findings.append(Finding("warning", path, "no curve moves at all"))
    elif dead:
        text = f"{len(dead)} of {len(names)} curves never move ({', '.join(dead[:3])}, …)"
        findings.append(Finding("note", path, text))
    controls = known_controls(control_set)
    if controls is not None and len(values) > 1:
        spans = {c.name: c.maximum - c.minimum for c in controls.controls}
        span = np.array([spans.get(name, np.inf) for name in names])
        steps = np.abs(np.diff(values, axis=0)) / span
        if steps.max() > JUMP:
            row, column = (int(i) for i in np.argwhere(steps > JUMP)[0])
            text = (
                f"{names[column]} jumps by {steps[row, column]:.0%} of its range at frame {row + 1}"
            )
            findings.append(Finding("warning", path, text))
    for name in MOUTH_SHAPES:
        if name in names and values[-1, names.index(name)] > OPEN_MOUTH:
            text = f"the clip ends with the mouth open ({name} {values[-1, names.index(name)]:.2f})"
            findings.append(Finding("warning", path, text))
    return findings


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
    if (folder / "take.json").is_file():
        findings += _take_json(folder)
    else:
        findings.append(Finding("warning", folder, "no take.json: this is no take of deitalk"))
    durations: dict[str, float] = {}
    own = _own_rig(folder / "curves.json")
    for path in sorted(folder.iterdir()):
        is_other = path.name.startswith(".") or path.name in ("take.json", "dub.json", *OTHER_CSV)
        if path.name.endswith(SUFFIX):
            findings += _layers(path)
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


def _layers(path: Path) -> list[Finding]:
    """Check a file of layers of edits."""
    try:
        layers = read_layers(path)
    except RigError as error:
        return [Finding("error", path, str(error))]
    count = sum(len(layer.edits) for layer in layers)
    return [Finding("note", path, f"{count} edits by hand")]


def _own_rig(path: Path) -> str:
    """Control set of a file if it is a user's own; empty if it is not, or cannot be read."""
    try:
        name = read_curves(path, control_set=None).control_set
    except RigError:
        return ""
    return "" if known_controls(name) else name


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
        if path.suffix.lower() == ".glb":
            return [Finding("note", path, check_glb(path)), *_shapes(path)]
        if path.suffix.lower() == ".csv" and is_live_link(path):
            return check_live_link(path)
        if path.suffix.lower() == ".txt" and not is_face_cap(path):  # EmoFace's hold no rate
            curves = read_curves(path, fps=FRAME_RATE, control_set=None)
            note = Finding("note", path, f"holds no frame rate: checked at {FRAME_RATE:g} fps")
            return [note, *_curves(path, curves)]
        curves = read_curves(path, control_set=None)
        if path.name.lower().endswith(".unreal.json"):
            _check_functions(path)
        return _curves(path, curves)
    except RigError as error:
        return [Finding("error", path, str(error))]


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


def _shapes(path: Path) -> list[Finding]:
    """Check the curves of a GLB's shapes, if their names are known."""
    try:
        return _curves(path, read_curves(path, control_set=None))
    except RigError as error:
        return [Finding("note", path, f"its values are not checked: {error}")]


def _curves(path: Path, curves: RigCurves) -> list[Finding]:
    """Check values, which are finite and in range after reading."""
    findings = [Finding("note", path, _summary(curves))]
    findings += [Finding("warning", path, note) for note in curves.notes]
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


# Checks of a Live Link Face CSV by the rules of Unreal's importer.


TAKE = re.compile(r"(?P<slate>.+)_(?P<take>\d+)_(?P<subject>[^_]+)")
"""The app's names, ``<Slate>_<Take>_<Subject>``."""


MARK = f"{PREFIX}mouthUp"
"""Property by which the face blueprint recognises raw curves."""
SWITCH = "HeadControlSwitch"


def is_live_link(path: Path) -> bool:
    """Return whether a CSV begins as a Live Link Face CSV, with any separator or quotes."""
    header = [cell.lower() for cell in read_header(path)[:2]]
    return header == ["timecode", COUNT.lower()]


def check_live_link(path: Path) -> list[Finding]:
    """Return the findings on a file that `is_live_link`.

    Raises
    ------
    FormatError
        If the importer refuses the file, stops inside it, or it cannot be read.
    """
    _check_header(path, _first_line(path))
    highest = _highest_frame_field(path)
    take = read_take(path)
    subject = subject_of(path)
    text = f"Unreal makes the Live Link subject {subject!r}"
    parts = TAKE.fullmatch(path.stem)
    if parts and subject == path.stem:
        better = f"{parts['slate']}_take_{parts['take']}_{parts['subject']}.csv"
        text += f", the whole name; {better} gives {parts['subject']!r}"
    if suffix_note(path):
        text = suffix_note(path)
    findings = [
        Finding("note", path, _count_of_frames(take)),
        Finding("note", path, text),
    ]
    if take.ticks[0] > 60_000:
        text = "the time code starts late: Unreal places the section at that hour of the timeline"
        findings.append(Finding("warning", path, text))
    findings += _clock(path, take) or _pace(path, take, highest)
    findings += _units(path, take) + _metahuman(path, take)
    missing = [name for name in arkit_controls().names if name not in take.names]
    if missing and not any(name.startswith(PREFIX) for name in take.names):
        text = f"{len(missing)} of 61 columns are missing ({missing[0]}, …): they stay at 0"
        findings.append(Finding("warning", path, text))
    shapes = [i for i, name in enumerate(take.names) if name in arkit_controls().names[:52]]
    values = np.asarray(take.values[:, shapes], np.float64)
    outside = (values < 0) | (values > 1)
    if outside.any():
        worst = float(np.maximum(values - 1, -values).max())
        count = int(outside.sum())
        text = f"{count} values are outside 0 to 1, by {worst:.3g} at most: Unreal keeps them"
        findings.append(Finding("warning", path, text))
    return findings + motion(path, take.values, take.names, ARKIT_ID)


def _first_line(path: Path) -> str:
    with open_file(path, CURVES_BYTES) as stream:
        return decode_text(stream.readline(HEADER_BYTES), path).rstrip("\r\n")


def _check_header(path: Path, line: str) -> None:
    """Refuse what the importer's comparison of the first two columns refuses."""
    if "=" in line.split(",")[0]:
        raise FormatError(f"{path} begins with {line!r}; Unreal takes it for the header: remove it")
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in line and "," not in line:
            raise FormatError(f"{path} has {name} between its cells; Unreal reads commas")
    if '"' in line:
        raise FormatError(f"{path} has quotes in its first line; Unreal compares names with them")
    for cell in line.split(","):
        if cell != cell.strip():
            raise FormatError(
                f"{path} has white space at {cell[:40]!r}; Unreal compares names with it"
            )


def _highest_frame_field(path: Path) -> float:
    """Return the highest FF.mmm; rows must have as many cells as the header.

    Unreal drops empty cells, and ends its import at a row of another number of cells.
    """
    width = _first_line(path).count(",") + 1
    count_rows(path, width)
    highest = 0.0
    with open_file(path, CURVES_BYTES) as stream:
        stream.readline()
        for number, data in enumerate(stream, 1):
            line = decode_text(data, path).strip("\r\n")
            if not line:
                continue
            n_cells = line.count(",") + 1
            if ",," in line or line.endswith(",") or line.startswith(","):
                n_cells = sum(bool(cell) for cell in line.split(","))
            if n_cells != width:
                raise FormatError(
                    f"{path}: data row {number} has {n_cells} filled cells, the header {width}; "
                    "Unreal ends its import there"
                )
            field = line.partition(",")[0].rpartition(":")[2]
            highest = max(highest, float(field) if re.fullmatch(r"\d+(\.\d+)?", field) else 0.0)
    return highest


def _metahuman(path: Path, take: LiveLinkTake) -> list[Finding]:
    """Find raw curves that the face blueprint of Unreal 5.6 and later does not take as such."""
    if not any(name.startswith(PREFIX) for name in take.names):
        return []
    texts = []
    if MARK not in take.names:
        texts.append(f"no column {MARK}: Unreal takes the columns for ARKit shapes")
    turns = [i for i, name in enumerate(take.names) if name in ("HeadYaw", "HeadPitch", "HeadRoll")]
    switch = [i for i, name in enumerate(take.names) if name == SWITCH]
    if take.values[:, turns].any() and not take.values[:, switch].any():
        texts.append(f"the head turns, but {SWITCH} is not 1: Unreal leaves the head still")
    return [Finding("warning", path, text) for text in texts]


def _clock(path: Path, take: LiveLinkTake) -> list[Finding]:
    """Find time codes that Unreal takes for others."""
    return [
        Finding(
            "error",
            path,
            f"{note}: Unreal takes FF for sixtieths, or for thirtieths where it never exceeds 30; "
            "deitalk convert writes sixtieths",
        )
        for note in take.notes
        if note.startswith(("time codes count", "drop-frame"))
    ]


def _units(path: Path, take: LiveLinkTake) -> list[Finding]:
    """Find percent and degrees, which Unreal takes for shares and nearly radians."""
    try:
        curves = take.to_curves()
    except FormatError:  # properties of another rig
        return []
    known = known_controls(curves.control_set)
    assert known is not None
    notes = in_units(curves, known, path).notes[len(curves.notes) :]
    return [
        Finding("error", path, f"{note}; Unreal takes them as they are, deitalk convert mends them")
        for note in notes
        if "radians" not in note
    ] + [Finding("warning", path, note) for note in notes if "radians" in note]


def _pace(path: Path, take: LiveLinkTake, highest: float) -> list[Finding]:
    """Find files that Unreal reads at 30 fps, and dropped frames."""
    if 0 < highest <= 30.0:
        if take.ticks[-1] - take.ticks[0] <= 60_000:
            text = (
                "FF never exceeds 30, so Unreal counts thirtieths: if FF are sixtieths, the clip "
                "plays at half speed; hold the last frame for a second"
            )
            return [Finding("warning", path, text)]
        text = (
            "FF never exceeds 30: read as 30 frames a second, as by Unreal since August 2023; an "
            "older importer plays each second in half a second, then freezes"
        )
        return [Finding("warning", path, text)]
    if len(take.ticks) < 3:
        return []
    steps = np.diff(take.ticks)
    jumps = steps > 1.5 * float(np.median(steps))
    if jumps.any():
        text = f"{int(jumps.sum())} gaps in the time codes: frames were dropped there"
        return [Finding("warning", path, text)]
    return []


def _count_of_frames(take: LiveLinkTake) -> str:
    seconds = (take.ticks[-1] - take.ticks[0]) / 60_000
    return f"Live Link take, {len(take.ticks)} frames at {take.fps:g} fps over {seconds:.2f} s"
