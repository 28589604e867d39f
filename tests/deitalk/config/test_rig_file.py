"""Public rigs by name: their sizes, sides and parts, and takes of their columns."""

import csv

import numpy as np
import pytest

from deitalk.config.rig_file import RIGS, parse_controls, read_controls, rig_text
from deitalk.data.captures.take import read_capture

PUBLIC = {
    "arkit": (61, ("MouthSmileLeft", "MouthSmileRight")),
    "metahuman-raw": (251, ("CTRL_expressions_eyeLookLeftL", "CTRL_expressions_eyeLookRightR")),
    "cc4": (140, ("Eye_L_Look_L", "Eye_R_Look_R")),
    "daz8": (22, ("eCTRLBrowUpLeft", "eCTRLBrowUpRight")),
    "daz9": (64, ("facs_bs_JawClenchLeft", "facs_bs_JawClenchRight")),
    "facegood": (116, ("mouth_funnel_dl", "mouth_funnel_dr")),
}
"""Controls, and a pair whose sides are told by the names."""
SHUT = {"arkit": "JawOpen", "cc4": "V_Explosive", "daz8": "eCTRLvM", "facegood": "mouth_stretch_c"}


@pytest.mark.parametrize(("name", "expected"), PUBLIC.items())
def test_a_public_rig_needs_no_file(name, expected, tmp_path):
    assert RIGS.keys() == PUBLIC.keys()
    controls = read_controls(name)
    size, (left, right) = expected
    assert len(controls) == size
    assert controls[left].mirror == right and controls[right].mirror == left
    assert name not in SHUT or "lip" in controls[SHUT[name]].sets
    assert "lip" not in controls["HeadYaw"].sets if name == "arkit" else True
    rows = np.linspace(0, 0.2, 4)[:, None] * controls.maximum  # of the head 37 degrees
    with (tmp_path / "take.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("frame", *controls.names), *((0, *row) for row in rows)])
    take = read_capture(tmp_path / "take.csv", rig=controls, fps=30)
    assert take.known == controls.names
    np.testing.assert_allclose(take.curves.values, rows, atol=1e-6)
    again = parse_controls(rig_text(controls), tmp_path)
    assert again.names == controls.names
    assert [c.mirror for c in again.controls] == [c.mirror for c in controls.controls]


def test_a_side_within_a_name_is_no_side():
    controls = read_controls("cc4")
    assert {controls[name].mirror for name in ("Tongue_Roll", "Mouth_Close", "V_Open")} == {""}


def test_names_of_facegood_are_those_of_its_files(shared):
    header = (shared / "data/curves/facegood/2_01.csv").read_text().split("\n", 1)[0].strip()
    assert tuple(header.split(",")[1:]) == read_controls("facegood").names
