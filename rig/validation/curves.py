"""Check a file of curves, or a take folder, by the rules of the programs that import it.

Every finding is an error (an importer refuses it or plays it wrong), a warning (it is probably not
played as intended) or a note (an effect of the import).
"""

from dataclasses import dataclass
from pathlib import Path

from rig.controls import DEFAULT_ID
from rig.conversion.raw import PREFIX, RAW_ID
from rig.curves import RigCurves
from rig.errors import FormatError, RigError
from rig.formats import read_curves
from rig.formats.curves_json import read_object
from rig.validation.exports import CHECKS
from rig.validation.findings import Finding
from rig.validation.live_link import check_live_link, is_live_link
from rig.validation.motion import motion

CURVE_SUFFIXES = (".csv", ".json", ".npz", ".tsv", ".xml", ".glb")
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
                return [Finding("note", path, check(path))]
        if path.suffix.lower() == ".csv" and is_live_link(path):
            return check_live_link(path)
        if path.suffix.lower() == ".txt":  # EmoFace's hold no rate
            curves = read_curves(path, fps=FRAME_RATE, control_set=None)
            note = Finding("note", path, f"holds no frame rate: checked at {FRAME_RATE:g} fps")
            return [note, *_curves(path, curves)]
        return _curves(path, read_curves(path, control_set=None))
    except RigError as error:
        return [Finding("error", path, str(error))]


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
