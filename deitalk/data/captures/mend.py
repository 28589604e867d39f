"""Corrections of captures: `deitalk data check --fix`.

Offsets, drift, rest poses, known controls and names of emotions are corrected.

Recordings and captured curves stay as they are. ``offset_s`` of the clips is changed; clips whose
actor's rest pose is removed get a new file ``mended/<clip>.npz``; channels that never move are left
out of new lists ``mended/known-<n>.txt``. ``clips.csv``, replaced last and whole, names these.
``check/`` holds the report, and the table as it was before the first change.
"""

import csv
import io
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.data.captures.labels import SPELLINGS
from deitalk.data.captures.rest_pose import without_rest
from deitalk.data.captures.survey import Survey
from deitalk.data.captures.verdicts import Check
from deitalk.data.clips import MAX_BYTES
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from rig import ControlSet, read_curves, write_curves
from rig.arrays import Bool, Float32
from rig.controls import DEFAULT_ID
from rig.errors import TargetError
from rig.files import (
    atomic_write,
    claim,
    kind_of,
    record,
    remove_leftovers,
    replace_recorded,
)
from rig.files.text_rows import read_rows

KIND = "dataset"
REPORT = "check/report.md"


@dataclass(frozen=True)
class Mended:
    """Result of a fix."""

    moved_takes: int
    rest_poses: dict[str, int]
    """Controls by actor."""
    dead: int
    """Controls that never move and are no longer known."""
    emotions: int

    @property
    def summary(self) -> str:
        """One line."""
        parts = []
        if self.emotions:
            parts.append(f"{self.emotions} names of emotions")
        if self.moved_takes:
            parts.append(f"offset of {self.moved_takes} takes")
        parts += [f"rest pose of {a} ({n} controls)" for a, n in self.rest_poses.items()]
        if self.dead:
            parts.append(f"{self.dead} controls that never move")
        return f"fixed: {', '.join(parts)}" if parts else "nothing to fix"


def rename_emotions(folder: Path) -> int:
    """Replace other spellings of the five emotions in ``clips.csv``; return how many."""
    with claim(folder):
        header, rows = read_rows(folder / "clips.csv", MAX_BYTES, error=DataError)
        count = 0
        for row in rows:
            for column in {"emotion", "voice"} & set(header):
                text = row[column].lower()
                right = SPELLINGS.get(text, text)
                if right != row[column] and right in EMOTIONS:
                    row[column] = right
                    count += 1
        if count:
            _write(folder, header, rows)
    return count


def mend(folder: Path, survey: Survey, rows: Sequence[Check], *, emotions: int = 0) -> Mended:
    """Write offsets and curves without rest pose into a dataset, and a report beside.

    Parameters
    ----------
    folder : Path
        Dataset folder.
    survey : Survey
        Of its captured clips.
    rows : sequence of Check
        All rows of the check, for the report.
    emotions : int
        Names that `rename_emotions` changed.

    Raises
    ------
    TargetError
        If another process writes to the folder, or a file that is not deitalk's is in the way.
    """
    sync = survey.sync()
    misread = survey.misread()
    shifted = {
        take for take, s in sync.items() if s is not None and s.is_shifted and take not in misread
    }
    rests = {
        actor: pose
        for actor, pose in survey.rests().items()
        if (pose != survey.controls.rest).any()
    }
    dead = survey.dead()
    with claim(folder):
        for place in (folder, folder / "check", folder / "mended"):
            remove_leftovers(place)  # of a fix that was killed
        header, table = read_rows(folder / "clips.csv", MAX_BYTES, error=DataError)
        by_name = {row["clip"]: row for row in table}
        files: set[str] = set()
        for c in survey.clips:
            row, take = by_name[c.clip.name], sync[c.clip.take]
            if c.clip.take in shifted and take is not None:
                middle = c.clip.span[0] + c.seconds / 2
                row["offset_s"] = f"{c.clip.offset_seconds - take.lag_at(middle):.4f}"
            if c.clip.speaker in rests:
                target = f"mended/{c.clip.name}.npz"
                (folder / "mended").mkdir(exist_ok=True)
                own = None if survey.controls.id == DEFAULT_ID else survey.controls
                curves = read_curves(c.clip.curves, controls=own)
                write_curves(
                    folder / target,
                    without_rest(curves, rests[c.clip.speaker], c.known, survey.controls),
                )
                row["curves"] = target
                files.add(row["curves"])
            if (c.known & dead).any() and (c.known & ~dead).any():
                row["known"] = _list_of_known(folder, c.known & ~dead, survey.controls)
                files.add(row["known"])
        is_wrong = bool(shifted or rests or files)
        if is_wrong or not (folder / REPORT).exists():
            # Write the report.
            (folder / "check").mkdir(exist_ok=True)
            if (folder / "check").is_symlink():
                raise TargetError(f"{folder / 'check'} is a symbolic link; remove it")
            with atomic_write(folder / REPORT) as beside:
                beside.write_text(_markdown(survey, rows, rests), encoding="utf-8")
        if is_wrong:
            header = list(dict.fromkeys([*header, "offset_s", "known"]))
            _write(folder, header, table)
        if kind_of(folder) is not None:
            record(folder, _written(folder), kind=KIND)
    counts = {actor: int((pose != survey.controls.rest).sum()) for actor, pose in rests.items()}
    return Mended(len(shifted), counts, int(dead.sum()), emotions)


def _list_of_known(folder: Path, known: Bool, controls: ControlSet) -> str:
    """Path of a list of controls; equal lists are one file."""
    text = "".join(f"{controls.names[i]}\n" for i in np.flatnonzero(known))
    (folder / "mended").mkdir(exist_ok=True)
    for number in itertools.count(1):
        target = f"mended/known-{number}.txt"
        if not (folder / target).exists():
            break
        if (folder / target).read_text(encoding="utf-8") == text:
            return target
    with atomic_write(folder / target) as beside:
        beside.write_text(text, encoding="utf-8")
    return target


def _write(folder: Path, header: Sequence[str], rows: Sequence[dict[str, str]]) -> None:
    """Replace ``clips.csv`` whole; its first version is kept."""
    kept = folder / "check" / "clips.csv"
    kept.parent.mkdir(exist_ok=True)
    if not kept.exists():
        with atomic_write(kept) as beside:
            beside.write_bytes((folder / "clips.csv").read_bytes())
    stream = io.StringIO()
    table = csv.DictWriter(stream, header, lineterminator="\n", restval="", extrasaction="ignore")
    table.writeheader()
    table.writerows(rows)
    if kind_of(folder) is None:
        with atomic_write(folder / "clips.csv") as beside:
            beside.write_text(stream.getvalue(), encoding="utf-8")
        return
    record(
        folder, ["clips.csv", "check/clips.csv"], kind=KIND
    )  # edits by hand are the user's right
    replace_recorded(folder, "clips.csv", stream.getvalue())


def _written(folder: Path) -> list[str]:
    """Paths of all that a fix wrote, also of one that was killed."""
    return [
        path.relative_to(folder).as_posix()
        for name in ("check", "mended")
        for path in sorted((folder / name).glob("*"))
        if path.is_file() and not path.name.startswith(".")
    ]


def _markdown(survey: Survey, rows: Sequence[Check], rests: dict[str, Float32]) -> str:
    lines = ["# Check of captures", "", "| check | level | result |", "|---|---|---|"]
    lines += [f"| {name} | {level} | {text.replace('|', '/')} |" for name, level, text in rows]
    lines += ["", "## Takes", "", "| take | actor | clips | s | lag ms | drift ms/s | r | by |",
              "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    groups = survey.by_take()
    for take, s in survey.sync().items():
        clips = groups[take]
        seconds = sum(c.seconds for c in clips)
        head = f"| {take} | {clips[0].clip.speaker} | {len(clips)} | {seconds:.1f} "
        values = "| | | | |" if s is None else (
            f"| {s.lag * 1000:+.1f} ± {s.error * 1000:.1f} | {s.drift * 1000:+.2f} "
            f"| {s.correlation:.2f} | {s.by} |"
        )  # fmt: skip
        lines.append(head + values)
    for actor, pose in rests.items():
        lines += ["", f"## Rest pose of {actor}", "", "| control | value | rest |", "|---|---|---|"]
        lines += [
            f"| {name} | {value:.3f} | {rest:g} |"
            for name, value, rest in zip(
                survey.controls.names, pose, survey.controls.rest, strict=True
            )
            if value != rest
        ]
    return "\n".join([*lines, ""])
