"""Rhubarb Lip Sync cues as tsv, json and xml, both ways: for Blender, Spine and After Effects.

Times are seconds with two decimals, as Rhubarb writes them.
"""

import itertools
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

from rig.controls import ControlSet
from rig.curves import RigCurves
from rig.errors import FormatError
from rig.formats.curves_json import read_json
from rig.formats.wide_csv import check_size
from rig.visemes import Cue, cues, cues_to_curves

MAX_BYTES = 32 << 20
MAX_SECONDS = 24 * 3600.0


def write_tsv(path: Path, curves: RigCurves) -> None:
    """Write ``start<TAB>shape``; the last line is the end, with the mouth at rest."""
    lines = [f"{cue.start:.2f}\t{cue.shape}\n" for cue in cues(curves)]
    lines.append(f"{curves.duration:.2f}\tX\n")
    path.write_text("".join(lines), encoding="utf-8", newline="\n")


def read_tsv(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read cues and pose the mouth."""
    starts, shapes = [], []
    for number, line in enumerate(_text(path).splitlines(), start=1):
        start, tab, shape = line.partition("\t")
        if not tab:
            raise FormatError(f"{path}: line {number} must be a time, a tab and a shape")
        starts.append(_seconds(start, f"{path}: line {number}"))
        shapes.append(shape.strip())
    pairs = itertools.pairwise([*starts, starts[-1]] if starts else [])
    return _posed(path, [Cue(a, b, s) for (a, b), s in zip(pairs, shapes, strict=True)], fps)


def write_json(path: Path, curves: RigCurves) -> None:
    """Write ``metadata`` and ``mouthCues``."""
    rows = [
        f'    {{ "start": {cue.start:.2f}, "end": {cue.end:.2f}, "value": "{cue.shape}" }}'
        for cue in cues(curves)
    ]
    text = (
        '{\n  "metadata": {\n    "soundFile": "",\n'
        f'    "duration": {curves.duration:.2f}\n  }},\n  "mouthCues": [\n'
        + ",\n".join(rows)
        + "\n  ]\n}\n"
    )
    path.write_text(text, encoding="utf-8", newline="\n")


def read_json_cues(
    path: Path, controls: ControlSet | None = None, fps: float | None = None
) -> RigCurves:
    """Read cues and pose the mouth."""
    found = read_json(path, limit=MAX_BYTES).get("mouthCues")
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


def write_xml(path: Path, curves: RigCurves) -> None:
    """Write ``rhubarbResult``."""
    lines = [
        f'    <mouthCue start="{cue.start:.2f}" end="{cue.end:.2f}">{cue.shape}</mouthCue>\n'
        for cue in cues(curves)
    ]
    text = (
        '<?xml version="1.0" encoding="utf-8"?>\n<rhubarbResult>\n  <metadata>\n'
        f"    <soundFile></soundFile>\n    <duration>{curves.duration:.2f}</duration>\n"
        "  </metadata>\n  <mouthCues>\n" + "".join(lines) + "  </mouthCues>\n</rhubarbResult>\n"
    )
    path.write_text(text, encoding="utf-8", newline="\n")


def read_xml(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read cues and pose the mouth; documents that declare entities are refused."""
    text = _text(path)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise FormatError(f"{path} declares a document type; Rhubarb's files have none")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise FormatError(f"{path} is no XML: {' '.join(str(error).split())}") from error
    given = []
    for number, cue in enumerate(root.iter("mouthCue"), start=1):
        where = f"{path}: cue {number}"
        start, end = (_seconds(cue.get(key), f"{where}, {key}") for key in ("start", "end"))
        given.append(Cue(start, end, (cue.text or "").strip()))
    return _posed(path, given, fps)


def _posed(path: Path, given: Sequence[Cue], fps: float | None) -> RigCurves:
    if not given:
        raise FormatError(f"{path} holds no cues")
    try:
        return cues_to_curves(given, fps or 30.0)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None


def _seconds(text: object, where: str) -> float:
    try:
        seconds = float(text)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise FormatError(f"{where}: {text!r} is no time in seconds") from None
    if not (math.isfinite(seconds) and 0 <= seconds <= MAX_SECONDS):
        raise FormatError(f"{where}: {seconds} s must be from 0 to {MAX_SECONDS:g}")
    return seconds


def _text(path: Path) -> str:
    check_size(path, MAX_BYTES)
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is no UTF-8 text: {error.reason}") from error
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error
