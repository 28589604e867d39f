"""Rows of `deitalk data check` about captures, from their survey."""

from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np

from deitalk.data.captures.reports import (
    LITTLE_SECONDS,
    NAMED,
    VOICED_FRAMES,
    VOICES_SEMITONES,
)
from deitalk.data.captures.survey import Survey

Row = tuple[str, Literal["ok", "warning", "error"], str]
"""Name, level and text."""


def capture_rows(survey: Survey) -> list[Row]:
    """Rows about offset, drift, rest pose, channels, sides, expressions and usable minutes."""
    return [
        *_sync(survey),
        _rest(survey),
        *_channels(survey),
        _listed("sides", survey.swapped(), "left and right agree", "takes seem mirrored in part"),
        _listed(
            "expressions",
            [f"{take} ({label}, face {seen})" for take, label, seen in survey.unlike()],
            "faces show their labels",
            "takes show another emotion than their label",
        ),
        _voices(survey),
        _usable(survey),
    ]


def _listed(name: str, wrong: Sequence[str], well: str, fault: str) -> Row:
    if not wrong:
        return name, "ok", well
    more = f" and {len(wrong) - NAMED} more" if len(wrong) > NAMED else ""
    return name, "warning", f"{len(wrong)} {fault}: {', '.join(wrong[:NAMED])}{more}"


def _sync(survey: Survey) -> list[Row]:
    sync = survey.sync()
    known = {take: s for take, s in sync.items() if s is not None and s.is_known}
    foreign = [
        f"{take} (r {0 if s is None else s.correlation:.2f})"
        for take, s in sync.items()
        if take not in known
    ]
    late = [f"{take} ({s.lag * 1000:+.0f} ms)" for take, s in known.items()
            if s.is_shifted and abs(s.lag) > 0.01]  # fmt: skip
    drift = [
        f"{take} ({s.drift * 1000:+.1f} ms a second{_cause(s.drift)})"
        for take, s in known.items()
        if s.drift
    ]
    lags = [abs(s.lag) * 1000 for s in known.values()]
    well = f"curves within {max(lags, default=0):.0f} ms of the sound ({len(known)} takes)"
    rows = [
        _listed("offset", late, well, "takes are early or late, offset_s is to correct"),
        _listed("drift", drift, "none", "takes drift, offset_s of every clip is to correct"),
    ]
    if foreign:
        text = "takes do not follow their sound; is it the right recording?"
        rows.append(_listed("sound", foreign, "", text))
    return rows


def _cause(drift: float) -> str:
    return ", as 29.97 against 30 or 48 against 48.048 kHz" if abs(abs(drift) - 1e-3) < 2e-5 else ""


def _rest(survey: Survey) -> Row:
    names = survey.controls.names
    rest = survey.controls.rest
    found = []
    for actor, pose in survey.rests().items():
        off = pose - rest
        moved = np.argsort(-np.abs(off))[: int((off != 0).sum())]
        if len(moved):
            found.append(f"{actor} ({len(moved)} controls, {names[moved[0]]} {off[moved[0]]:+.2f})")
    return _listed("rest pose", found, "faces rest", "actors have another pose at rest")


def _channels(survey: Survey) -> list[Row]:
    rows = []
    for name, well in (("clipped", "no channel held at its end"), ("jittering", "none")):
        counts = Counter(n for c in survey.clips for n in getattr(c.faults, name))
        found = [f"{control} ({n} clips)" for control, n in counts.most_common()]
        fault = (
            "channels stay at the end of their range" if name == "clipped" else "channels jitter"
        )
        rows.append(_listed(f"{name}", found, well, fault))
    frozen = [
        f"{c.clip.name} ({c.faults.frozen_seconds:.1f} s)"
        for c in survey.clips
        if c.faults.frozen_seconds
    ]
    rows.append(_listed("frozen", frozen, "the face moves in every frame", "clips stand still"))
    known = np.any([c.known for c in survey.clips], axis=0)
    dead = [survey.controls.names[i] for i in np.flatnonzero(survey.dead())]
    fault = "channels never move, and would be learnt as still"
    rows.append(_listed("dead", dead, f"all {known.sum()} known move", fault))
    return rows


def _voices(survey: Survey) -> Row:
    found = []
    for actor, clips in survey.by_actor().items():
        takes: dict[str, list[float]] = {}
        for c in clips:
            takes.setdefault(c.clip.take, []).extend(c.voiced.tolist())
        pitch = {take: float(np.median(v)) for take, v in takes.items() if len(v) >= VOICED_FRAMES}
        if pitch and max(pitch.values()) - min(pitch.values()) > VOICES_SEMITONES:
            low, high = min(pitch, key=lambda t: pitch[t]), max(pitch, key=lambda t: pitch[t])
            found.append(f"{actor} ({low}, {high})")
    return _listed("voices", found, "one an actor", "actors have two voices under one name")


def _usable(survey: Survey) -> Row:
    seconds = survey.usable_seconds()
    total = sum(seconds.values())
    parts = ", ".join(f"{a} {e} {s / 60:.1f}" for (a, e), s in sorted(seconds.items()))
    emotions = {emotion for (_, emotion), s in seconds.items() if s}
    text = f"{total / 60:.1f} min ({parts})"
    if total < LITTLE_SECONDS:
        return "usable", "warning", f"{text}; at least 2, better 10 minutes of an actor"
    if len(emotions) == 1:
        return "usable", "warning", f"{text}; one emotion only"
    return "usable", "ok", text
