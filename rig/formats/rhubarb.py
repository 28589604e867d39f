"""Rhubarb Lip Sync cues as tsv and json, both ways; visemes of Oculus.

Times are seconds with two decimals, as Rhubarb writes them.
"""

import itertools
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rig.controls import ControlSet, default_controls
from rig.conversion.visemes import Cue, cues, cues_to_curves
from rig.curves import RigCurves, n_frames_for
from rig.errors import FormatError, quoted
from rig.files.reading import check_expansion, check_file, read_text
from rig.formats.curves_json import read_object
from rig.limits import CUES_BYTES, SECONDS


def _spoken_cues(curves: RigCurves, seconds: float | None) -> tuple[list[Cue], float]:
    """Cues that begin within the sound, cut at its end, and its length; that of the curves if None.

    The last frame may end after the sound.
    """
    end = curves.duration if seconds is None else seconds
    return [replace(cue, end=min(cue.end, end)) for cue in cues(curves) if cue.start < end], end


def write_tsv(path: Path, curves: RigCurves, seconds: float | None = None) -> None:
    """Write ``start<TAB>shape``; the last line is the end, with the mouth at rest."""
    spoken, end = _spoken_cues(curves, seconds)
    lines = [f"{cue.start:.2f}\t{cue.shape}\n" for cue in spoken]
    lines.append(f"{end:.2f}\tX\n")
    path.write_text("".join(lines), encoding="utf-8", newline="\n")


def read_tsv(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read cues and pose the mouth."""
    starts, shapes = [], []
    for number, line in enumerate(read_text(path, CUES_BYTES).splitlines(), start=1):
        start, tab, shape = line.partition("\t")
        if not tab:
            raise FormatError(f"{path}: line {number} must be a time, a tab and a shape")
        starts.append(_seconds(start, f"{path}: line {number}"))
        shapes.append(shape.strip())
    pairs = itertools.pairwise([*starts, starts[-1]] if starts else [])
    return _posed(path, [Cue(a, b, s) for (a, b), s in zip(pairs, shapes, strict=True)], fps)


def write_json(
    path: Path, curves: RigCurves, sound: str = "", seconds: float | None = None
) -> None:
    """Write ``metadata`` with path and length of the sound, and ``mouthCues``."""
    spoken, end = _spoken_cues(curves, seconds)
    content = {
        "metadata": {"soundFile": sound, "duration": round(end, 2)},
        "mouthCues": [
            {"start": round(cue.start, 2), "end": round(cue.end, 2), "value": cue.shape}
            for cue in spoken
        ],
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8", newline="\n")


def read_json_cues(
    path: Path, controls: ControlSet | None = None, fps: float | None = None
) -> RigCurves:
    """Read cues and pose the mouth."""
    found = read_object(path, limit=CUES_BYTES).get("mouthCues")
    if not isinstance(found, list):
        raise FormatError(f"{path} has no list 'mouthCues'")
    given = []
    for number, cue in enumerate(found, start=1):
        if not isinstance(cue, dict):
            raise FormatError(f"{path}: cue {number} must have start, end and value")
        where = f"{path}: cue {number}"
        start, end = (_seconds(cue.get(key), f"{where}, {key}") for key in ("start", "end"))
        given.append(Cue(start, end, str(cue.get("value"))))
    return _posed(path, given, fps)


def _posed(path: Path, given: Sequence[Cue], fps: float | None) -> RigCurves:
    if not given:
        raise FormatError(f"{path} holds no cues")
    fps = fps or 30.0
    n_frames = n_frames_for(max(cue.end for cue in given), fps=fps)
    n_bytes = 4 * n_frames * len(default_controls())
    check_expansion(n_bytes, check_file(path, CUES_BYTES), path, error=FormatError)
    try:
        return cues_to_curves(given, fps)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None


def _seconds(text: object, where: str) -> float:
    try:
        seconds = float(text)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise FormatError(f"{where}: {quoted(text)} is no time in seconds") from None
    if not 0 <= seconds <= SECONDS:
        raise FormatError(f"{where}: {seconds:g} s must be from 0 to {SECONDS:g}")
    return seconds
