"""Limits: one module, one page, accepted values at each limit and refused ones above it."""

import re
from pathlib import Path

import numpy as np
import pytest

from rig import RigCurves, limits, rest_curves
from rig.curves import check_clip
from rig.errors import CurveError, RigError, one_line, shorten

ROOT = Path(__file__).resolve().parents[1]
UNITS = {"GiB": 2**30, "MiB": 2**20, "KiB": 2**10, "": 1}
NAMES = {n for n in vars(limits) if n.isupper() and n not in ("KIB", "MIB", "GIB")}


def documented():
    """Values of the limits on the page."""
    rows = re.findall(
        r"^\| `(\w+)` \| ([\d,.e+]+) ?(\w*) \| (?:.+) \|$",
        (ROOT / "docs" / "limits.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    return {name: float(n.replace(",", "")) * UNITS[unit] for name, n, unit in rows}


def test_limits_of_the_page_have_the_values_of_the_code():
    stated = documented()
    assert len(stated) >= 15 and set(stated) <= NAMES
    assert stated == {name: pytest.approx(getattr(limits, name)) for name in stated}


def test_shorten_keeps_both_ends():
    assert shorten("abcdefghi", 9) == "abcdefghi"
    assert shorten("abcdefghij", 9) == "abcde…hij"
    assert len(shorten("x" * 5_000_058, 200)) == 200


def test_messages_are_one_bounded_line():
    assert one_line("fine: é, 'a b'") == "fine: é, 'a b'"
    assert one_line("a\nb\x1b[31m\udcff") == "a\\nb\\x1b[31m\\xff"
    message = str(RigError("value " + "9" * 5_000_000 + "; lower it"))
    assert len(message) == limits.MESSAGE_CHARACTERS
    assert message.startswith("value 999") and message.endswith("; lower it")
    for text in ("\0" * 1000, "a\n" * 300, "\udc80" * 400):  # escapes are longer
        message = str(RigError(f"name {text} end"))
        assert len(message) <= limits.MESSAGE_CHARACTERS and message.isprintable()
        assert message.startswith("name ") and message.endswith(" end")


def one_curve(n_frames):
    return RigCurves(np.zeros((n_frames, 1), np.float32), ("jaw",), 120, control_set="own")


def test_clip_of_most_frames_is_accepted_and_a_longer_one_is_not():
    assert len(one_curve(limits.FRAMES)) == 1_296_000
    with pytest.raises(CurveError, match="1296001 frames; at most 1296000"):
        one_curve(limits.FRAMES + 1)


def test_most_values_bound_frames_times_curves():
    check_clip(2**16, 2**12)
    with pytest.raises(CurveError, match="65537 frames of 4096 curves are more than 268435456"):
        check_clip(2**16 + 1, 2**12)


def test_frames_are_counted_before_memory_is_taken():
    with pytest.raises(CurveError, match="at most 1296000"):
        rest_curves(10**12)
    with pytest.raises(CurveError, match="at most 1296000"):
        rest_curves(5000, fps=1).resample(300)


@pytest.mark.parametrize("fps", [limits.FPS_LOWEST, limits.FPS_HIGHEST])
def test_rates_at_the_limits_are_accepted(fps):
    assert one_curve(1).resample(fps).fps == fps


@pytest.mark.parametrize("fps", [0.99, 300.1, 1e-300, 1e308])
def test_rates_beyond_the_limits_are_refused(fps):
    with pytest.raises(CurveError, match=r"must be from 1 to 300"):
        one_curve(1).resample(fps)
