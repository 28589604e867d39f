"""Report of an import: a row for every take, and warnings about the takes as a whole."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from deitalk.data.clips import SPLITS
from rig.errors import as_line, listed

TAKE_HEADER = (
    "take", "kind", "actor", "emotion", "fps", "seconds", "speech_s", "clips", "notes",
)  # fmt: skip
LITTLE_SECONDS = 120.0
"""Speech of all takes below which little can be learnt."""
VOICES_SEMITONES = 7.0
"""Difference of median pitch from which on one actor's takes are two voices; a woman's and a man's
differ by about 9, an actor's emotions by less than 6."""
VOICED_FRAMES = 60
"""Fewest voiced frames from which the median pitch of a take is known."""


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
        is_other = any(report.kind == "rig" for report in reports)
        where = ", on a rig of which nothing is known with finetune --map" if is_other else ""
        warnings.append(
            f"one emotion only ({emotions.pop()}); others change the face as the base model's do"
            f"{where}"
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
