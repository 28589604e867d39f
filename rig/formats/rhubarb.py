"""Rhubarb Lip Sync cues as tsv, json, xml and Moho's dat, both ways; visemes of Oculus.

Times are seconds with two decimals, as Rhubarb writes them.
"""

import itertools
import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.controls import ControlSet, default_controls
from rig.conversion.avatars import (
    OCULUS,
    Cue,
    cues,
    cues_to_curves,
    names,
    weights,
    weights_to_curves,
)
from rig.curves import RigCurves, n_frames_for
from rig.errors import FormatError, quoted
from rig.files.reading import check_expansion, check_file, read_text
from rig.formats.curves_json import read_object
from rig.formats.decimal_text import Block, rows
from rig.limits import CUES_BYTES, SECONDS

DAT_FPS = 24.0
"""Frames a second of a Moho file, which does not state them, unless a reader is told others."""


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
    rows = [
        f'    {{ "start": {cue.start:.2f}, "end": {cue.end:.2f}, "value": "{cue.shape}" }}'
        for cue in spoken
    ]
    text = (
        f'{{\n  "metadata": {{\n    "soundFile": {json.dumps(sound)},\n'
        f'    "duration": {end:.2f}\n  }},\n  "mouthCues": [\n' + ",\n".join(rows) + "\n  ]\n}\n"
    )
    path.write_text(text, encoding="utf-8", newline="\n")


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


def write_xml(path: Path, curves: RigCurves, sound: str = "", seconds: float | None = None) -> None:
    """Write ``rhubarbResult`` with path and length of the sound."""
    from xml.sax.saxutils import escape  # imports a client of HTTP

    spoken, end = _spoken_cues(curves, seconds)
    lines = [
        f'    <mouthCue start="{cue.start:.2f}" end="{cue.end:.2f}">{cue.shape}</mouthCue>\n'
        for cue in spoken
    ]
    text = (
        '<?xml version="1.0" encoding="utf-8"?>\n<rhubarbResult>\n  <metadata>\n'
        f"    <soundFile>{escape(sound)}</soundFile>\n"
        f"    <duration>{end:.2f}</duration>\n"
        "  </metadata>\n  <mouthCues>\n" + "".join(lines) + "  </mouthCues>\n</rhubarbResult>\n"
    )
    path.write_text(text, encoding="utf-8", newline="\n")


def read_xml(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read cues and pose the mouth; documents that declare entities are refused."""
    text = read_text(path, CUES_BYTES)
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


def write_dat(path: Path, curves: RigCurves, seconds: float | None = None) -> None:
    """Write ``MohoSwitch1``, then ``frame shape``, frames from 1 at the curves' rate."""
    spoken, end = _spoken_cues(curves, seconds)
    lines = {1 + int(cue.start * curves.fps + 1e-6): cue.shape for cue in spoken}
    lines[max(1 + int(end * curves.fps + 1e-6), max(lines, default=0) + 1)] = "X"
    text = "".join(f"{frame} {shape}\n" for frame, shape in lines.items())
    path.write_text("MohoSwitch1\n" + text, encoding="utf-8", newline="\n")


def note_of_dat(path: Path, curves: RigCurves) -> str:
    """Return a note on the rate, unless it is the one that readers take."""
    fps = curves.fps
    return "" if fps == DAT_FPS else f"counts {fps:g} frames a second: give readers --fps {fps:g}"


def read_dat(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read cues and pose the mouth; frames are at `fps`, `DAT_FPS` by default."""
    rate = fps or DAT_FPS
    first, *lines = read_text(path, CUES_BYTES).split("\n")
    if first.strip() != "MohoSwitch1":
        raise FormatError(f"{path} does not begin with MohoSwitch1")
    marks = []
    for number, line in enumerate(filter(None, map(str.strip, lines)), start=2):
        frame, _, shape = line.partition(" ")
        if not frame.isdecimal() or len(frame) > 9 or not 1 <= int(frame) <= 1 + SECONDS * rate:
            raise FormatError(f"{path}: line {number} must be a frame from 1 and a shape")
        marks.append(((int(frame) - 1) / rate, shape))
    pairs = itertools.pairwise([*marks, marks[-1]] if marks else [])
    curves = _posed(path, [Cue(a, b, shape) for (a, shape), (b, _) in pairs], rate)
    note = f"holds no rate: read at {DAT_FPS:g} frames a second"
    return curves if fps else replace(curves, notes=(note,))


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


# The 15 Oculus visemes over time as JSON, schema ``deitalk.visemes/1``.


SCHEMA = "deitalk.visemes/1"
DECIMALS = 4
MOST_OFF = 0.01
"""Largest distance of the sum of a row from 1: weights are rounded."""
FASTEST = 1000.0


def write(path: Path, curves: RigCurves) -> None:
    """Write one row of weights per frame; each row sums to 1."""
    head = {"schema": SCHEMA, "fps": curves.fps, "n_frames": len(curves), "names": names(OCULUS)}
    with path.open("wb") as stream:
        stream.write(json.dumps(head, indent=1)[:-2].encode() + b',\n "values": [\n')
        last = b""
        for text in rows([Block(weights(curves), DECIMALS)], before=b"  [", after=b"],\n"):
            stream.write(last + text[:-2])
            last = text[-2:]
        stream.write(b"\n ]\n}\n")


def read(path: Path, controls: ControlSet | None = None, fps: float | None = None) -> RigCurves:
    """Read weights and pose the mouth: each frame is the mean of the poses by their weights.

    Raises
    ------
    FormatError
        If the file is of another schema, names other visemes, or a row does not sum to 1.
    """
    data = read_object(path, SCHEMA)
    rate, values = data.get("fps"), data.get("values")
    if data.get("names") != list(names(OCULUS)):
        raise FormatError(f"{path} needs 'names' {', '.join(names(OCULUS))}")
    if not isinstance(rate, (int, float)) or not 0 < rate <= FASTEST:
        raise FormatError(f"{path}: 'fps' is {rate!r}; it must be above 0, at most {FASTEST:g}")
    try:
        with np.errstate(over="ignore"):  # a sum that is not 1
            shares = np.array(values, dtype=np.float32)
    except (TypeError, ValueError, OverflowError):
        shares = np.empty(0, np.float32)
    if shares.ndim != 2 or shares.shape[1] != len(names(OCULUS)):
        raise FormatError(f"{path}: 'values' must be rows of {len(names(OCULUS))} numbers")
    off = ~((np.abs(shares.sum(axis=1) - 1) <= MOST_OFF) & (shares >= 0).all(axis=1))
    if off.any():
        raise FormatError(f"{path}: data row {int(np.argmax(off)) + 1} does not sum to 1")
    return weights_to_curves(shares, fps or float(rate))
