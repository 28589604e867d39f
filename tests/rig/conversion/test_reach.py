"""Which channels of the board a source can move."""

import numpy as np
import pytest

from rig import RigCurves, default_controls
from rig.controls import DEFAULT_ID
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import convert, reached_controls
from rig.conversion.raw import RAW_ID, raw_controls
from rig.errors import ControlError

BOARD = default_controls()


def test_all_shapes_of_a_phone_reach_73_of_185():
    reached = reached_controls(arkit_controls().names, ARKIT_ID)
    assert len(reached) == 73
    assert not [n for n in reached if "lipBite" in n or "teeth" in n]


def test_nothing_beyond_the_reach_moves(rng):
    shapes = arkit_controls()
    values = rng.uniform(0, 1, (50, len(shapes))).astype(np.float32)
    board = convert(RigCurves(values, shapes.names, control_set=ARKIT_ID), DEFAULT_ID)
    moved = {n for n in BOARD.names if np.ptp(board[n]) > 0}
    assert moved <= set(reached_controls(shapes.names, ARKIT_ID))


def test_lips_together_needs_jaw_and_mouth_close():
    lips = "CTRL_L_mouth_lipsTogetherU.ty"
    assert lips in reached_controls(["jawOpen", "mouthClose"], ARKIT_ID)
    assert lips not in reached_controls(["mouthClose"], ARKIT_ID)


def test_raw_curves_reach_all_but_switches_and_board_channels_themselves():
    missing = set(BOARD.names) - set(reached_controls(raw_controls().names, RAW_ID))
    assert len(missing) == 11 and "CTRL_lookAtSwitch.ty" in missing
    assert reached_controls(["CTRL_C_jaw.ty"], DEFAULT_ID) == ("CTRL_C_jaw.ty",)


def test_unknown_names_and_sets_are_refused():
    with pytest.raises(ControlError, match="jawOpenn"):
        reached_controls(["jawOpenn"], ARKIT_ID)
    with pytest.raises(ControlError, match="'puppet' is unknown"):
        reached_controls(["x"], "puppet")
