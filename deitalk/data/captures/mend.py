"""Rows of `deitalk data check` about captures, and its `--fix`.

Offsets, drift, rest poses, known controls and names of emotions are corrected.

Recordings and captured curves stay as they are. ``offset_s`` of the clips is changed; clips whose
actor's rest pose is removed get a new file ``mended/<clip>.npz``; channels that never move are left
out of new lists ``mended/known-<n>.txt``. ``clips.csv``, replaced last and whole, names these.
``check/`` holds the report, and the table as it was before the first change.
"""

import csv
import io
import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from deitalk.data.captures.labels import SPELLINGS
from deitalk.data.captures.rest_pose import without_rest
from deitalk.data.captures.survey import Survey
from deitalk.data.clips import SPLITS
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from rig import ControlSet, read_curves, write_curves
from rig.arrays import Bool, Float32
from rig.controls import DEFAULT_ID
from rig.errors import TargetError, as_line, listed
from rig.files import (
    atomic_write,
    claim,
    kind_of,
    record,
    remove_leftovers,
    replace_recorded,
)
from rig.files.reading import read_text
from rig.limits import DATASET_TABLE_BYTES

# Rows of `deitalk data check` about captures, from their survey.


Level = Literal["ok", "warning", "error"]


class Check(NamedTuple):
    """One row of the table: what was checked, and the result."""

    name: str
    level: Level
    text: str


def verdict(
    name: str, wrong: Sequence[str], well: str, fault: str, level: Level = "warning"
) -> Check:
    """A row without a fault, or with the first few clips or takes that have it."""
    if not wrong:
        return Check(name, "ok", well)
    return Check(name, level, f"{len(wrong)} {fault}: {listed(wrong)}")


def capture_rows(survey: Survey) -> list[Check]:
    """Rows about offset, drift, rest pose, channels, sides, expressions and usable minutes."""
    return [
        *_sync(survey),
        _rest(survey),
        *_channels(survey),
        verdict("sides", survey.swapped(), "left and right agree", "takes seem mirrored in part"),
        verdict(
            "expressions",
            [f"{take} ({label}, face {seen})" for take, label, seen in survey.unlike()],
            "faces show their labels",
            "takes show another emotion than their label",
        ),
        verdict(
            "conventions",
            [str(one) for one in survey.relations.conventions(survey.controls.names).values()],
            "takes of an actor move alike",
            "conventions among an actor's takes, each to be a style of a tuned model",
        ),
        _voices(survey),
        _usable(survey),
    ]


def _sync(survey: Survey) -> list[Check]:
    sync = survey.sync()
    known = {take: s for take, s in sync.items() if s is not None and s.is_known}
    apart = [take for take in sync if take not in known and take not in survey.misread()]
    far = {take: lag for take in apart if (lag := survey.far(take)) is not None}
    foreign = [
        f"{take} (r {0 if (s := sync[take]) is None else s.correlation:.2f})"
        for take in apart
        if take not in far
    ]
    late = [f"{take} ({s.lag * 1000:+.0f} ms)" for take, s in known.items()
            if s.is_shifted and abs(s.lag) > 0.01 and take not in survey.misread()]  # fmt: skip
    drift = [
        f"{take} ({s.drift * 1000:+.1f} ms a second{_cause(s.drift)})"
        for take, s in known.items()
        if s.drift
    ]
    lags = [abs(s.lag) * 1000 for s in known.values()]
    well = f"curves within {max(lags, default=0):.0f} ms of the sound ({len(known)} takes)"
    rows = [
        verdict("offset", late, well, "takes are early or late, offset_s is to correct"),
        verdict("drift", drift, "none", "takes drift, offset_s of every clip is to correct"),
    ][: 2 if known else 0]
    if misread := survey.misread():
        found = [
            f"{take} ({own:.5g} Hz, the sound fits {fit:.5g})"
            for take, (own, fit) in misread.items()
        ]
        text = "takes are at another rate than their sound; mend the files, import them again"
        rows.append(verdict("rate", found, "", text, "error"))
    if far:
        found = [f"{take} ({lag:+.2f} s)" for take, lag in far.items()]
        text = (
            "takes are seconds early (-) or late (+) against their sound; cut or pad the recording "
            "by so much, import again"
        )
        rows.append(verdict("apart", found, "", text, "error"))
    if foreign:
        text = "takes do not follow their sound; is it the right recording?"
        rows.append(verdict("sound", foreign, "", text))
    return rows


def _cause(drift: float) -> str:
    return ", as 29.97 against 30 or 48 against 48.048 kHz" if abs(abs(drift) - 1e-3) < 2e-5 else ""


def _rest(survey: Survey) -> Check:
    names = survey.controls.names
    rest = survey.controls.rest
    found = []
    for actor, pose in survey.rests().items():
        off = pose - rest
        moved = np.argsort(-np.abs(off))[: int((off != 0).sum())]
        if len(moved):
            found.append(f"{actor} ({len(moved)} controls, {names[moved[0]]} {off[moved[0]]:+.2f})")
    return verdict("rest pose", found, "faces rest", "actors have another pose at rest")


def _channels(survey: Survey) -> list[Check]:
    rows = []
    for name, well in (("clipped", "no channel held at its end"), ("jittering", "none")):
        counts = Counter(n for c in survey.clips for n in getattr(c.faults, name))
        found = [f"{control} ({n} clips)" for control, n in counts.most_common()]
        fault = (
            "channels stay at the end of their range" if name == "clipped" else "channels jitter"
        )
        rows.append(verdict(f"{name}", found, well, fault))
    frozen = [
        f"{c.clip.name} ({c.faults.frozen_seconds:.1f} s)"
        for c in survey.clips
        if c.faults.frozen_seconds
    ]
    rows.append(verdict("frozen", frozen, "the face moves in every frame", "clips stand still"))
    known = np.any([c.known for c in survey.clips], axis=0)
    dead = [survey.controls.names[i] for i in np.flatnonzero(survey.dead())]
    fault = "channels never move, and would be learnt as still"
    rows.append(verdict("dead", dead, f"all {known.sum()} known move", fault))
    return rows


def _voices(survey: Survey) -> Check:
    found = []
    for actor, clips in survey.by_actor().items():
        takes: dict[str, list[float]] = {}
        for c in clips:
            takes.setdefault(c.clip.take, []).extend(c.voiced.tolist())
        pitch = {take: float(np.median(v)) for take, v in takes.items() if len(v) >= VOICED_FRAMES}
        if pitch and max(pitch.values()) - min(pitch.values()) > VOICES_SEMITONES:
            low, high = min(pitch, key=lambda t: pitch[t]), max(pitch, key=lambda t: pitch[t])
            found.append(f"{actor} ({low}, {high})")
    return verdict("voices", found, "one an actor", "actors have two voices under one name")


def _usable(survey: Survey) -> Check:
    seconds = survey.usable_seconds()
    total = sum(seconds.values())
    parts = ", ".join(f"{a} {e} {s / 60:.1f}" for (a, e), s in sorted(seconds.items()))
    emotions = {emotion for (_, emotion), s in seconds.items() if s}
    text = f"{total / 60:.1f} min ({parts})"
    if total < LITTLE_SECONDS:
        return Check("usable", "warning", f"{text}; at least 2, better 10 minutes of an actor")
    if len(emotions) == 1:
        return Check("usable", "warning", f"{text}; one emotion only")
    return Check("usable", "ok", text)


# What an import has done: a row for every take, and warnings about the takes as a whole.


TAKE_HEADER = (
    "take", "kind", "actor", "emotion", "fps", "seconds", "speech_s", "clips", "notes",
)  # fmt: skip
LITTLE_SECONDS = 120.0
"""Speech of all takes below which little can be learnt."""
VOICES_SEMITONES = 7.0
"""Difference of median pitch from which on one actor's takes are two voices; a woman's and a man's
differ by about 9, an actor's emotions by less than 6."""
VOICED_FRAMES = 60
"""From which on the median pitch of a take is known."""


@dataclass(frozen=True)
class TakeReport:
    """Result of one take: a row of the table."""

    take: str
    kind: str
    actor: str
    emotion: str
    fps: float
    seconds: float
    speech_seconds: float
    n_clips: int
    pitch: float
    """Median of the voice, semitones over 100 Hz; NaN where unknown."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Imported:
    """Result of an import."""

    n_clips: int
    seconds: float
    takes: tuple[TakeReport, ...]
    splits: dict[str, int]
    left_out: int
    """Clips between splits."""
    warnings: tuple[str, ...]

    @property
    def summary(self) -> str:
        """One line."""
        splits = ", ".join(f"{self.splits.get(name, 0)} {name}" for name in SPLITS)
        left_out = f"; {self.left_out} between the splits left out" if self.left_out else ""
        return f"{self.n_clips} clips, {self.seconds / 60:.1f} min ({splits}){left_out}"

    def lines(self) -> list[str]:
        """A line for every take."""
        width = max(len(take.take) for take in self.takes)
        return [
            f"{t.take:{width}}  {t.kind:8} {t.actor:10} {t.emotion:9} {t.fps:6g} Hz "
            f"{t.seconds:7.1f} s {t.n_clips:3d} clips  {'; '.join(t.notes)}".rstrip()
            for t in self.takes
        ]

    def as_dict(self) -> dict[str, object]:
        """The report as values of JSON."""
        takes = [
            asdict(t) | {"pitch": t.pitch if np.isfinite(t.pitch) else None} for t in self.takes
        ]
        return asdict(self) | {"takes": takes}


def row_of(report: TakeReport) -> dict[str, str]:
    """A row of ``takes.csv``."""
    return {
        "take": report.take,
        "kind": report.kind,
        "actor": report.actor,
        "emotion": report.emotion,
        "fps": f"{report.fps:.6g}",
        "seconds": f"{report.seconds:.2f}",
        "speech_s": f"{report.speech_seconds:.2f}",
        "clips": str(report.n_clips),
        "notes": as_line("; ".join(report.notes)),
    }


def skipped_files(paths: Sequence[Path]) -> list[str]:
    """A warning about files of a folder that are no takes; none without any."""
    names = [path.name for path in paths]
    text = f"{len(paths)} files hold no known curves and were left out: {listed(names)}"
    return [text] if paths else []


def warnings_of(reports: Sequence[TakeReport]) -> list[str]:
    """Faults of the takes as a whole."""
    warnings = []
    speech = sum(report.speech_seconds for report in reports)
    if speech < LITTLE_SECONDS:
        warnings.append(
            f"{speech:.0f} s of speech in all; a model learns an actor from 2 minutes on, better 10"
        )
    emotions = {report.emotion for report in reports}
    if len(emotions) == 1:
        warnings.append(
            f"one emotion only ({emotions.pop()}); others change the face as the base model's do, "
            "on a rig of which nothing is known with finetune --map"
        )
    rates = Counter(report.fps for report in reports)
    if len(rates) > 1:
        counts = ", ".join(f"{n} at {rate:g} Hz" for rate, n in sorted(rates.items()))
        warnings.append(f"takes of mixed rates ({counts}); each keeps its own")
    return warnings + _two_voices(reports)


def _two_voices(reports: Sequence[TakeReport]) -> list[str]:
    """Actors whose takes have voices of two people."""
    warnings = []
    for actor in dict.fromkeys(report.actor for report in reports):
        own = [r for r in reports if r.actor == actor and np.isfinite(r.pitch)]
        own.sort(key=lambda report: report.pitch)
        if own and own[-1].pitch - own[0].pitch > VOICES_SEMITONES:
            warnings.append(
                f"actor {actor!r}: the voices of {own[0].take} and {own[-1].take} are "
                f"{own[-1].pitch - own[0].pitch:.0f} semitones apart; name them differently if "
                "they are two people"
            )
    return warnings


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
        header, rows = _read(folder)
        count = 0
        for row in rows:
            for column in {"emotion", "voice"} & set(header):
                text = (row[column] or "").strip().lower()
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
        header, table = _read(folder)
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


def _read(folder: Path) -> tuple[list[str], list[dict[str, str]]]:
    text = read_text(folder / "clips.csv", DATASET_TABLE_BYTES)
    reader = csv.DictReader(io.StringIO(text.removeprefix("\ufeff")))
    try:
        rows = list(reader)
    except csv.Error as error:
        raise DataError(f"{folder / 'clips.csv'}: is no CSV: {error}") from None
    return list(reader.fieldnames or ()), rows


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
