"""Pictures of the articulation and emotion tables."""

import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.research.corpus.figures import (
    SENTENCE,
    draw_faces,
    evenly_timed,
    phone_pose,
    plot_channels,
)
from rig import default_controls

CONTROLS = default_controls()


def test_evenly_timed_phones_are_contiguous():
    phones = evenly_timed(["SIL", "M", "AA"])
    assert [(p.start, p.name) for p in phones] == [
        (0, "SIL"), (pytest.approx(0.35), "M"), (pytest.approx(0.46), "AA")
    ]  # fmt: skip
    assert phones[0].end == phones[1].start


@pytest.mark.parametrize(("names", "message"), [(["M", "QQ"], "'QQ' is no phone"), ([], "empty")])
def test_a_name_that_is_no_phone_is_refused(names, message):
    with pytest.raises(DataError, match=message):
        evenly_timed(names)


def test_held_phone_reaches_its_gesture():
    pose = phone_pose("M", "angry", 0.8)
    assert pose[CONTROLS.index("CTRL_L_mouth_lipsTogetherU.ty")] == 1
    assert phone_pose("AA", "neutral", 0.5)[CONTROLS.index("CTRL_C_jaw.ty")] > 0.3
    at_rest = phone_pose("SIL", "neutral", 0.0)
    np.testing.assert_allclose(at_rest, CONTROLS.rest, atol=0.05)  # the schwas are 0.16 s away


def test_channels_are_drawn(tmp_path):
    pytest.importorskip("matplotlib", reason="plots need matplotlib")
    assert "OY" in SENTENCE.split()
    plot_channels(evenly_timed(["SIL", "M", "OY"]), tmp_path / "a.svg")
    drawn = (tmp_path / "a.svg").read_text()
    assert drawn.count("<!-- M -->") == drawn.count("<!-- OY -->") == 1


def test_faces_are_drawn_and_differ(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        "deitalk.research.contact_sheet.write_png", lambda path, picture: drawn.append(picture)
    )
    draw_faces(tmp_path / "a.png", phones=("AA", "M"), emotions=("happy",), tile=64)
    assert drawn[0].shape == (128, 72, 3)
    assert np.abs(drawn[0][:64].astype(int) - drawn[0][64:]).max() > 50
