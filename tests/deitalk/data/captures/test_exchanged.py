"""Columns of captures that are exchanged are named; those of takes as they are never."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deitalk.audio.load import load_audio
from deitalk.data.captures.exchanged import JAW, Exchanged
from deitalk.data.captures.take import read_capture
from deitalk.data.clips import Clip
from deitalk.data.offset import predicted_curves
from rig import RigCurves, default_controls
from rig.conversion.convert import convert
from tests.conftest import SHARED
from tests.deitalk.data.captures.test_sync import curves_of, recording

CONTROLS = default_controls()
BROW, LID, CORNER = (
    f"CTRL_{{}}_{part}.ty" for part in ("brow_raiseIn", "eye_blink", "mouth_cornerPull")
)
REAL = sorted((SHARED / "data/curves").glob("[lm]*/*.csv"))


def clip(take: str) -> Clip:
    path = Path(take)
    return Clip(take, path, path, "happy", "anna", "train", "happy", "recording", 0.0, None, None,
                take=take)  # fmt: skip


def exchanged(curves: RigCurves, one: str, other: str) -> RigCurves:
    names = list(curves.names)
    i, j = names.index(one), names.index(other)
    names[i], names[j] = other, one
    return RigCurves(curves.values, names, curves.fps).reorder(CONTROLS)


def found(*captured: RigCurves, predicted: RigCurves | None) -> list[str]:
    evidence = Exchanged(CONTROLS)
    for curves in captured:
        evidence.add(clip("t"), predicted, curves, np.ones(len(CONTROLS), bool))
    return evidence.found()


@pytest.mark.parametrize("emotion", ["neutral", "happy", "angry", "sad", "surprised"])
@pytest.mark.parametrize("name", ["amiable", "promise"])
def test_takes_as_they_are_have_none(emotion, name):
    captured = curves_of("live", emotion, name)
    assert found(captured, predicted=predicted_curves(recording(name))) == []


@pytest.mark.parametrize(
    ("one", "other", "named"),
    [
        (JAW, BROW.format("L"), BROW.format("L")),
        (JAW, "CTRL_R_brow_down.ty", "CTRL_R_brow_down.ty"),
        (JAW, LID.format("L"), LID.format("L")),
        (JAW, CORNER.format("L"), JAW),
        (BROW.format("L"), LID.format("L"), f"{BROW.format('L')} moves as {LID.format('R')}"),
        (BROW.format("R"), LID.format("R"), f"{BROW.format('R')}"),
    ],
)
def test_exchanged_columns_are_named(one, other, named):
    captured = exchanged(curves_of("live", "happy", "promise"), one, other)
    (line, *_) = found(captured, predicted=predicted_curves(recording("promise")))
    assert line.startswith("t (") and named in line


def test_short_takes_are_not_judged():
    captured = exchanged(curves_of("live", "happy", "promise"), JAW, BROW.format("L"))
    short = captured.slice_seconds(0, 4)
    assert found(short, predicted=predicted_curves(recording("promise"))) == []


@pytest.mark.parametrize("speaker", ["s01", "s05"])
def test_jaws_and_brows_of_people_are_told_apart(shared, speaker):
    """GRID: the clips of a speaker are one take."""
    lips = shared / "data/lips"
    columns = json.loads((lips / "columns.json").read_text())["columns"]
    table = pd.read_csv(lips / "clips.csv")
    evidence = {swapped: Exchanged(CONTROLS) for swapped in (False, True)}
    for name in table[table.speaker == speaker]["clip"][:4]:
        measures = np.load(lips / f"grid/{name}.npz")["meas"].astype(np.float32) / 1e4
        values = np.zeros((len(measures), len(CONTROLS)), np.float32)
        for control, measure in ((JAW, "jaw"), (BROW.format("L"), "brow_y")):
            column = pd.Series(measures[:, columns.index(measure)])
            values[:, CONTROLS.index(control)] = 8 * column.where(column > -3).interpolate(
                limit_direction="both"
            )
        curves = RigCurves(values, CONTROLS.names, 25)
        predicted = predicted_curves(load_audio(lips / f"grid/{name}.opus"))
        for swapped, own in evidence.items():
            shown = exchanged(curves, JAW, BROW.format("L")) if swapped else curves
            own.add(clip(speaker), predicted, shown, np.ones(len(CONTROLS), bool))
    assert evidence[False].found() == []
    (line,) = evidence[True].found()
    assert BROW.format("L") in line


@pytest.mark.parametrize(
    "path",
    REAL or [pytest.param(None, marks=pytest.mark.skip(reason="no captures here"))],
    ids=lambda path: path and path.stem,
)
def test_sides_of_captured_faces_agree(path):
    curves = read_capture(path).curves
    board = convert(curves, CONTROLS.id).reorder(CONTROLS)
    assert found(board, predicted=None) == []
