"""Rows of `deitalk data check` about captures, from their survey."""

from collections import Counter
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from deitalk.data.captures.import_report import LITTLE_SECONDS, VOICED_FRAMES, VOICES_SEMITONES
from deitalk.data.captures.survey import Survey
from rig.errors import listed

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
    names, rests = survey.controls.names, []
    for actor, pose in survey.rests().items():
        off = pose - survey.controls.rest
        moved = np.argsort(-np.abs(off))[: int((off != 0).sum())]
        if len(moved):
            most = f"{names[moved[0]]} {off[moved[0]]:+.2f}"
            rests.append(f"{actor} ({len(moved)} controls, {most})")
    return [
        *_sync(survey),
        verdict("rest pose", rests, "faces rest", "actors have another pose at rest"),
        *_channels(survey),
        verdict(
            "columns",
            survey.exchanged.found(),
            "jaw and sides move as they should",
            "takes seem to have columns exchanged, or their names; mend the table, import again",
        ),
        verdict("sides", survey.swapped(), "left and right agree", "takes seem mirrored in part"),
        verdict(
            "expressions",
            [f"{take} ({label}, face {seen})" for take, label, seen in survey.unlike()],
            "faces show their labels",
            "takes show another emotion than their label",
        ),
        verdict(
            "conventions",
            [str(one) for one in survey.relations.conventions(names).values()],
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
        f"{take} ({s.drift * 1000:+.1f} ms a second"
        f"{', as 29.97 against 30 or 48 against 48.048 kHz' * (abs(abs(s.drift) - 1e-3) < 2e-5)})"
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


def _channels(survey: Survey) -> list[Check]:
    rows = []
    for name, well, fault in (
        ("clipped", "no channel held at its end", "channels stay at the end of their range"),
        ("jittering", "none", "channels jitter"),
    ):
        counts = Counter(n for c in survey.clips for n in getattr(c.faults, name))
        found = [f"{control} ({n} clips)" for control, n in counts.most_common()]
        rows.append(verdict(name, found, well, fault))
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
