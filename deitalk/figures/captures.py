"""Pictures of a check of captures: lags of the takes, poses at rest."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.figures.canvas import drawing
from rig import ControlSet
from rig.arrays import Float32, Float64

MOST_TAKES = 12
MOST_CONTROLS = 30
LEAST_SHOWN_MS = 67.0
"""Height of an axis of lags, two frames: on less every take would look scattered."""


class TakeLags(NamedTuple):
    """Lags of one take; all times in milliseconds but `centres`."""

    name: str
    lags: Float64
    """[shape=(L,)]."""
    scores: Sequence[Float64]
    """Of every clip, each [shape=(L,)]."""
    centres: Float64
    """Middle of every clip, seconds [shape=(K,)]."""
    peaks: Float64
    """Lag of every clip [shape=(K,)]."""
    line: Float64
    """Lag of the take at the centres [shape=(K,)]."""


def draw_lags(takes: Sequence[TakeLags], path: Path) -> None:
    """Draw the score by lag of the first takes, and the lags of their clips over time."""
    shown = takes[:MOST_TAKES]
    with drawing(path, (9, 1.0 + 1.5 * max(len(shown), 1))) as figure:
        axes = figure.subplots(max(len(shown), 1), 2, squeeze=False)
        for (left, right), take in zip(axes, shown, strict=False):
            for scores in take.scores:
                left.plot(take.lags, scores, color="0.8", lw=0.6)
            left.plot(take.lags, np.mean(take.scores, axis=0), color="C0")
            left.axvline(float(take.line.mean()), color="C3", lw=1)
            left.set_ylabel(take.name, fontsize=7)
            right.plot(take.centres, take.peaks, ".", color="C0")
            right.plot(take.centres, take.line, color="C3", lw=1)
            right.set_ylim(*shown_lags(np.concatenate([take.peaks, take.line])))
            right.set_ylabel("lag, ms", fontsize=7)
        axes[-1][0].set_xlabel("lag of the curves, ms")
        axes[-1][1].set_xlabel("time in the take, s")


def shown_lags(lags: Float64) -> tuple[float, float]:
    """Ends of an axis with all lags around its middle, `LEAST_SHOWN_MS` long at the least."""
    finite = lags[np.isfinite(lags)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    half = max(1.1 * (high - low), LEAST_SHOWN_MS) / 2
    return (low + high) / 2 - half, (low + high) / 2 + half


def draw_rests(poses: Mapping[str, Float32], controls: ControlSet, path: Path) -> None:
    """Draw the distance from rest of every actor's pose at rest."""
    with drawing(path, (9, 3.5 * len(poses))) as figure:
        axes = figure.subplots(len(poses), 1, squeeze=False)[:, 0]
        for axis, (actor, pose) in zip(axes, poses.items(), strict=True):
            off = pose - controls.rest
            order = np.argsort(-np.abs(off))[: min(MOST_CONTROLS, int((off != 0).sum()))]
            axis.bar(range(len(order)), off[order])
            names = [controls.names[i].removeprefix("CTRL_") for i in order]
            axis.set_xticks(range(len(order)), names, rotation=90, fontsize=6)
            axis.set_title(f"{actor} at rest", fontsize=9)
