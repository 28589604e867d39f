"""Known phones on the curves: contacts and rounding are met, the rest stays."""

import numpy as np
import pytest

from deitalk.postprocess.known_phones import (
    ROUNDED_SHARE,
    KnownPhone,
    phone_frames,
)
from rig import default_controls
from tests.deitalk.postprocess.stages import Stages

CONTROLS = default_controls()
RULES = Stages(CONTROLS)


def spoken(n_frames=30):
    """An open mouth."""
    curves = np.zeros((n_frames, len(CONTROLS.names)), np.float32)
    curves[:, RULES.lively] = 0.5
    return curves


def column(curves, name):
    return curves[:, CONTROLS.index(name)]


def test_no_phones_change_nothing():
    curves = spoken()
    curves[:, RULES.seals] = -0.1
    curves[:, CONTROLS.index("CTRL_L_mouth_purseU.ty")] = -0.1
    before = curves.copy()
    RULES.meet_phones(curves, ())
    RULES.meet_phones(curves, [KnownPhone(0.2, 0.4, "AA"), KnownPhone(0.4, 0.6, "SIL")])
    np.testing.assert_array_equal(curves, before)


def test_contacts_last_two_frames_at_least():
    """0.2 to 0.3 s are frames 6 to 8; 10 ms around 0.5 s are frames 15 and a neighbour."""
    phones = [KnownPhone(0.2, 0.3, "M"), KnownPhone(0.495, 0.505, "B")]
    frames = np.flatnonzero(phone_frames(phones, frozenset("PBM"), 30)).tolist()
    assert frames[:3] == [6, 7, 8] and len(frames) == 5 and 15 in frames[3:]
    edge = [KnownPhone(0.0, 0.01, "M"), KnownPhone(0.99, 1.0, "M")]
    assert phone_frames(edge, frozenset("M"), 30)[[0, 29]].all()


def test_lips_meet_within_a_bilabial_and_what_parts_them_is_lowered():
    curves = spoken()
    RULES.meet_phones(curves, [KnownPhone(0.2, 0.3, "P")])
    lips = column(curves, "CTRL_L_mouth_lipsTogetherD.ty")
    assert (lips[6:9] == 1).all() and not lips[:6].any() and not lips[9:].any()
    assert column(curves, "CTRL_C_jaw.ty")[7] == pytest.approx(0.1)
    assert column(curves, "CTRL_C_jaw.ty")[12] == 0.5
    assert not column(curves, "CTRL_L_mouth_lipBiteD.ty").any()


def test_what_the_network_closed_stays_as_it_is():
    curves = spoken()
    curves[5:10, RULES.together] = 1
    before = curves.copy()
    RULES.meet_phones(curves, [KnownPhone(0.2, 0.3, "P")])
    np.testing.assert_array_equal(curves, before)


def test_lip_meets_the_teeth_within_f_and_not_within_a_bilabial():
    curves = spoken()
    RULES.meet_phones(curves, [KnownPhone(0.2, 0.3, "M"), KnownPhone(0.3, 0.4, "F")])
    bite = column(curves, "CTRL_R_mouth_lipBiteD.ty")
    assert np.flatnonzero(bite).tolist() == [9, 10, 11]


def test_rounding_is_raised_to_a_share_and_slopes():
    curves = spoken()
    RULES.meet_phones(curves, [KnownPhone(0.4, 0.5, "W")])
    purse = column(curves, "CTRL_L_mouth_purseU.ty")
    assert purse[13] == pytest.approx(ROUNDED_SHARE * 0.79)
    assert purse[11] == pytest.approx(0.8 * purse[12]) and purse[8] == pytest.approx(
        0.2 * purse[12]
    )
    assert not purse[:8].any()
    curves[:, CONTROLS.index("CTRL_L_mouth_purseU.ty")] = 0.9
    RULES.meet_phones(curves, [KnownPhone(0.4, 0.5, "W")])
    assert (purse == np.float32(0.9)).all()
