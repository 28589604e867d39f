"""Rows of the check from surveys made by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deitalk.data.captures.channels import ChannelFaults
from deitalk.data.captures.survey import ClipSurvey, Survey
from deitalk.data.captures.verdicts import capture_rows
from deitalk.data.clips import Clip
from deitalk.data.offset import LAGS, ClipLags
from rig import default_controls

CONTROLS = default_controls()
ALL = np.ones(len(CONTROLS), bool)
FAULTS = ChannelFaults((), (), 0.0, ALL, float("nan"), float("nan"), np.zeros(3))


def clip(name: str, take: str, emotion: str = "neutral", **changes) -> ClipSurvey:
    path = Path(name)
    own = Clip(name, path, path, emotion, "anna", "train", emotion, "recording", 0.0, None, None,
               take=take, span=(0.0, 10.0))  # fmt: skip
    lags = ClipLags(0.5 * np.exp(-((LAGS / 0.05) ** 2)), 1, 5.0, 10.0)
    base = ClipSurvey(own, 10.0, 6.0, FAULTS, lags, ALL, np.zeros(4), np.zeros(3), np.full(60, 5.0))
    return replace(base, **changes)


def rows(*clips: ClipSurvey) -> dict[str, tuple[str, str]]:
    return {n: (level, text) for n, level, text in capture_rows(Survey(CONTROLS, list(clips)))}


def test_clean_captures_have_only_the_warning_of_little_material():
    found = rows(clip("a", "t1", "happy"), clip("b", "t2", "sad"))
    assert {name for name, (level, _) in found.items() if level != "ok"} == {"usable"}
    assert found["usable"][1].startswith("0.3 min (anna happy 0.2, anna sad 0.2)")


def test_take_that_does_not_follow_its_sound_is_named_and_not_usable():
    noise = ClipLags(np.full(len(LAGS), 0.01), 1, 5.0, 10.0)
    found = rows(clip("a", "t1", lags=noise), clip("b", "t2"))
    assert found["sound"][0] == "warning" and "t1 (r 0.10)" in found["sound"][1]
    assert "anna neutral 0.2" in found["usable"][1]


def test_smile_under_the_label_sad_is_named():
    smile, frown = np.array([0.5, 0, 0, 0]), np.array([0, 0.4, 0, 0])
    clips = [
        clip("a", "t1", "happy", scores=smile),
        clip("b", "t2", "sad", scores=smile),
        clip("c", "t3", "sad", scores=frown),
        clip("d", "t4", "neutral"),
    ]
    level, text = rows(*clips)["expressions"]
    assert level == "warning" and "1 takes" in text and "t2 (sad, face happy)" in text


def test_swapped_sides_two_voices_and_dead_channels_are_named():
    still = ALL.copy()
    still[0] = False
    faults = replace(FAULTS, gaze=-0.9, moving=still)
    clips = [
        clip("a", "t1", faults=faults),
        clip("b", "t2", faults=replace(faults, gaze=0.9), voiced=np.full(60, 15.0)),
    ]
    found = rows(*clips)
    assert found["sides"][1].endswith(": t1")
    assert found["voices"][1].endswith("anna (t1, t2)")
    assert found["dead"][1].endswith(CONTROLS.names[0])


@pytest.mark.parametrize("fault", ["clipped", "jittering"])
def test_faulty_channels_are_counted_in_clips(fault):
    faults = replace(FAULTS, **{fault: ("CTRL_C_jaw.ty",)})
    assert "CTRL_C_jaw.ty (2 clips)" in rows(
        clip("a", "t1", faults=faults), clip("b", "t1", faults=faults), clip("c", "t1")
    )[fault][1]  # fmt: skip
