"""Traits of an actor's motion from captured takes, with or without sound.

A factor is what the takes show over what neutral takes of the usual person show, measured alike.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from deitalk.audio.frames import runs
from deitalk.config.rules import Idle
from deitalk.data.captures.take import CapturedCurves
from deitalk.emotions.actor import TRAITS
from deitalk.postprocess.life.blinks import LEAST_INTERVAL
from deitalk.postprocess.life.gaze import SIDE_DEGREES
from rig import RigCurves
from rig.arrays import Float32, Float64
from rig.curves.filters import gaussian_smooth

TRAIT_SECONDS, WINDOW_SECONDS, TRACKER_SECONDS = 20.0, 3.0, 0.06
"""Least length of takes to measure a trait on; windows in which motion is measured, so that
postures and moods do not count; sigma of the Gaussian against a tracker's noise."""
BLINK_RISE, BLINK_SECONDS, LEAST_WAITS = 0.3, 0.5, 6
"""Closure of the lids in a blink, its most seconds at half of that (more is a look down), and the
least intervals, double blinks apart, for their median."""
AVERTED_DEGREES, AVERTED_SECONDS, LEAST_LOOKS = 4.0, 0.25, 8
"""What counts as a look aside, and the least number for their balance."""
USUAL_BROWS = {"raiseIn": 0.064, "raiseOut": 0.032, "down": 0.039}
USUAL_HEAD = (0.55, 0.83, 0.41)
"""Mean standard deviation within a window: of a side's control, and of yaw, pitch and roll in
degrees. Of 403 s of neutral takes of 12 LibriSpeech readers with `Traits()`."""
Timed = tuple[Float32 | Float64, float]
"""A track [shape=(T,)] and its frames per second."""


def measure_traits(captures: Sequence[CapturedCurves]) -> dict[str, float]:
    """Traits of the motion of one actor, relative to the usual person of the life model.

    Parameters
    ----------
    captures : sequence of CapturedCurves
        Takes on the board, as `deitalk.data.captures.take.read_capture` gives them.

    Returns
    -------
    dict of str to float
        Those of `deitalk.emotions.actor.TRAITS` that can be measured, within their ranges: none on
        less than `TRAIT_SECONDS`, nor on controls that are not known or never move.
    """
    parts = [part for capture in captures for part in _captured_parts(capture)]
    brows = {
        (side, stem): spread
        for side in "LR"
        for stem in USUAL_BROWS
        if (spread := _spread(_tracks(parts, f"CTRL_{side}_brow_{stem}.ty")))
    }
    heads = [
        _spread([(p.head[:, k], p.fps) for p in parts if p.head is not None]) for k in (0, 1, 2)
    ]
    found = {
        "blink_interval": _blink_interval(parts),
        "side": _side(brows),
        "brow_range": _over(list(brows.values()), [USUAL_BROWS[stem] for _, stem in brows]),
        "head_range": _over(heads, USUAL_HEAD),
        "avoids": _avoids(parts),
    }
    known = {name: value for name, value in found.items() if value is not None}
    return {name: float(np.clip(value, *TRAITS[name])) for name, value in known.items()}


def _over(spreads: Sequence[float], usual: Sequence[float]) -> float | None:
    return sum(spreads) / sum(usual) if any(spreads) else None


def _captured_parts(capture: CapturedCurves) -> list[RigCurves]:
    """Known controls of a take, without frames that were not captured."""
    curves = capture.curves.select(capture.known)
    seen = np.ones(len(curves), bool) if capture.seen is None else capture.seen
    return [curves.slice_frames(*span) for span in runs(seen).tolist()]


def _tracks(parts: Sequence[RigCurves], *names: str) -> list[Timed]:
    """Mean of some controls in the parts that hold them all; empty if those are too short."""
    tracks = [
        (part.select(names).values.mean(axis=1, dtype=np.float64), part.fps)
        for part in parts
        if set(names) <= set(part.names)
    ]
    return tracks if _seconds(tracks) >= TRAIT_SECONDS else []


def _seconds(tracks: Sequence[Timed]) -> float:
    return sum(len(track) / fps for track, fps in tracks)


def _spread(tracks: Sequence[Timed]) -> float:
    """Mean standard deviation within `WINDOW_SECONDS`; 0 if the tracks are too short."""
    found: list[Float64] = []
    for track, fps in tracks if _seconds(tracks) >= TRAIT_SECONDS else ():
        length = round(WINDOW_SECONDS * fps)
        smooth = gaussian_smooth(np.asarray(track, float), TRACKER_SECONDS * fps, "mirror")
        found += list(smooth[: len(track) // length * length].reshape(-1, length).std(axis=1))
    return float(np.mean(found)) if found else 0.0


def _blink_interval(parts: Sequence[RigCurves]) -> float | None:
    from scipy.signal import find_peaks

    waits: list[float] = []
    for track, fps in _tracks(parts, "CTRL_L_eye_blink.ty", "CTRL_R_eye_blink.ty"):
        places, _ = find_peaks(track, prominence=BLINK_RISE, width=(0, BLINK_SECONDS * fps))
        waits += [wait for wait in np.diff(places) / fps if wait >= LEAST_INTERVAL]
    return float(np.median(waits)) / Idle().interval_seconds if len(waits) >= LEAST_WAITS else None


def _side(brows: Mapping[tuple[str, str], float]) -> float | None:
    """Relative difference of the brows' ranges, on controls with different values on both sides."""
    pairs = [(brows.get(("L", stem)), brows.get(("R", stem))) for stem in USUAL_BROWS]
    apart = [(left, right) for left, right in pairs if left and right and left != right]
    left, right = np.sum(apart, axis=0) if apart else (0.0, 0.0)
    return float(2 * (left - right) / (left + right)) if apart else None


def _avoids(parts: Sequence[RigCurves]) -> float | None:
    """Balance of the looks to the left and to the right of where the actor looks most."""
    looks: list[float] = []
    eyes = ("CTRL_L_eye.tx", "CTRL_R_eye.tx")
    seen = [part for part in parts if set(eyes) <= set(part.names)]
    for part, (track, fps) in zip(seen, _tracks(parts, *eyes), strict=False):
        left = SIDE_DEGREES * track - (0.0 if part.head is None else part.head[:, 0])
        aside = gaussian_smooth(left - np.median(left), TRACKER_SECONDS * fps, "mirror")
        for sign in (1.0, -1.0):
            lengths = np.diff(runs(sign * aside > AVERTED_DEGREES), axis=1) / fps
            looks += [sign] * int((lengths >= AVERTED_SECONDS).sum())
    return float(np.mean(looks)) if len(looks) >= LEAST_LOOKS else None
