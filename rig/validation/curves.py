"""Check a file of curves, or a take folder, by the rules of the programs that import it.

Every finding is an error (an importer refuses it or plays it wrong), a warning (it is probably not
played as intended) or a note (an effect of the import).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from rig.arrays import AnyFloat
from rig.controls import DEFAULT_ID
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import known_controls
from rig.conversion.raw import PREFIX, RAW_ID
from rig.curves import RigCurves
from rig.errors import FormatError, RigError
from rig.formats import read_curves
from rig.formats.curves_json import read_object
from rig.formats.livelink_csv import LiveLinkTake, read_take, subject_of
from rig.formats.table import format_of_header
from rig.formats.wide_csv import read_header
from rig.validation.exports import CHECKS

Level = Literal["error", "warning", "note"]
OPEN_MOUTH = 0.1
"""Jaw opening at the end of a clip above which a warning is given."""
JUMP = 0.8
"""Share of a control's range that is too far for one frame."""
MOUTH_SHAPES = ("JawOpen", "CTRL_C_jaw.ty", f"{PREFIX}jawOpen")
CURVE_SUFFIXES = (".csv", ".json", ".npz", ".tsv", ".xml", ".glb")
OTHER_CSV = ("intensity.csv",)
"""Tables of a take that hold no curves."""
WRINKLES = tuple(f"{PREFIX}noseWrinkleUpper{side}" for side in "LR")


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
            durations[path.name] = read_curves(path, control_set=None).duration
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
        if path.suffix.lower() == ".csv" and format_of_header(read_header(path)) == "livelink":
            return _live_link(path)
        return _curves(path, read_curves(path, control_set=None))
    except RigError as error:
        return [Finding("error", path, str(error))]


def _curves(path: Path, curves: RigCurves) -> list[Finding]:
    """Check values, which are finite and in range after reading."""
    findings = [Finding("note", path, _summary(curves))]
    findings += _motion(path, curves.values, curves.names, curves.control_set)
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


def _live_link(path: Path) -> list[Finding]:
    """Check a Live Link Face CSV by the rules of Unreal's importer."""
    take = read_take(path)
    findings = [Finding("note", path, _take_summary(take))]
    subject = subject_of(path)
    if subject is None:
        text = "the name is not <Slate>_<Take>_<Subject>.csv: the importer finds no subject"
        findings.append(Finding("warning", path, text))
    else:
        findings.append(Finding("note", path, f"Unreal makes the Live Link subject {subject!r}"))
    if take.ticks[0] > 60_000:
        text = "the time code starts late: Unreal places the section at that hour of the timeline"
        findings.append(Finding("warning", path, text))
    findings += _pace(path, take)
    missing = [name for name in arkit_controls().names if name not in take.names]
    if missing and not any(name.startswith(PREFIX) for name in take.names):
        text = f"{len(missing)} of 61 columns are missing ({missing[0]}, …): they stay at 0"
        findings.append(Finding("warning", path, text))
    shapes = [i for i, name in enumerate(take.names) if name in arkit_controls().names[:52]]
    values = take.values[:, shapes]
    outside = (values < 0) | (values > 1)
    if outside.any():
        worst = float(np.abs(np.clip(values, 0, 1) - values).max())
        count = int(outside.sum())
        text = f"{count} values are outside 0 to 1, by {worst:.3g} at most: Unreal keeps them"
        findings.append(Finding("warning", path, text))
    return findings + _motion(path, take.values, take.names, ARKIT_ID)


def _pace(path: Path, take: LiveLinkTake) -> list[Finding]:
    """Find time codes that count frames instead of sixtieths, and dropped frames."""
    if len(take.ticks) < 3:
        return []
    steps = np.diff(take.ticks)
    usual = float(np.median(steps))
    jumps = steps > 1.5 * usual
    sixtieths = take.ticks // 1000 % 60
    if take.ticks[-1] - take.ticks[0] > 120_000 and sixtieths.max() < 30 and jumps.any():
        text = (
            "FF never passes 29: it counts frames where sixtieths belong; Unreal plays each second "
            "in half a second and freezes for the other half"
        )
        return [Finding("error", path, text)]
    if jumps.any():
        text = f"{int(jumps.sum())} gaps in the time codes: frames were dropped there"
        return [Finding("warning", path, text)]
    return []


def _motion(
    path: Path, values: AnyFloat, names: tuple[str, ...], control_set: str
) -> list[Finding]:
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


def _summary(curves: RigCurves) -> str:
    return (
        f"{len(curves)} frames at {curves.fps:g} fps, {curves.duration:.2f} s, {len(curves.names)} "
        f"curves of {curves.control_set}"
    )


def _take_summary(take: LiveLinkTake) -> str:
    seconds = (take.ticks[-1] - take.ticks[0]) / 60_000
    return f"Live Link take, {len(take.ticks)} frames at {take.fps:g} fps over {seconds:.2f} s"
