"""Audio2Face JSON and Unity clips: rules of their programs, and the way back."""

import json

import numpy as np
import pytest
import yaml

from rig import RigCurves, default_controls, read_curves, write_curves
from rig.conversion.arkit import ARKIT_ID
from rig.conversion.avatars import avatar_controls
from rig.conversion.convert import convert
from rig.errors import FormatError
from tests.errors import one_line
from tests.rig.formats.test_other_tools import NVIDIA
from tests.splines import hermite

BOARD = default_controls()


@pytest.fixture
def take():
    """Smooth curves of 60 frames at 30 fps: a sine each, of a height of its own."""
    height = np.linspace(0.2, 1, 185) * (BOARD.maximum - BOARD.rest)
    share = 0.5 - 0.5 * np.cos(np.arange(60) / 7)
    return RigCurves((BOARD.rest + np.outer(share, height)).astype(np.float32), BOARD.names)


def test_audio2face_json_has_nvidias_names_and_reads_back(tmp_path, take):
    report = write_curves(tmp_path / "a.a2f.json", take, sound="s.wav")
    assert "ARKit is a lossy preview" in report.note
    data = json.loads((tmp_path / "a.a2f.json").read_text())
    assert [name[0].upper() + name[1:] for name in data["facsNames"]] == list(NVIDIA)
    assert (data["numPoses"], data["numFrames"], data["exportFps"]) == (52, 60, 30)
    assert data["trackPath"].endswith("s.wav") and np.shape(data["weightMat"]) == (60, 52)
    back = read_curves(tmp_path / "a.a2f.json", control_set=None)
    expected = convert(take, ARKIT_ID)
    np.testing.assert_allclose(back.values[:, :52], expected.values[:, :52], atol=1e-6)


@pytest.mark.parametrize("avatar", ["cc4", "vrm1"])
def test_audio2face_json_of_an_avatar_is_recognised_by_its_names(tmp_path, take, avatar):
    write_curves(tmp_path / "a.a2f.json", convert(take, avatar))
    (tmp_path / "a.a2f.json").rename(tmp_path / "b.json")
    back = read_curves(tmp_path / "b.json", control_set=None)
    assert back.control_set == avatar and back.names == avatar_controls(avatar).names
    np.testing.assert_allclose(back.values, convert(take, avatar).values, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"facsNames": ["a", 1]}, "no object of names"),
        ({"facsNames": ["qq", "q"]}, "are no shapes of ARKit or an avatar"),
        ({"exportFps": None}, "no rate"),
        ({"weightMat": [[1]]}, "must be frames x 2 names"),
    ],
)
def test_damaged_audio2face_json_is_one_line(tmp_path, change, message):
    data = {"exportFps": 30, "facsNames": ["jawOpen", "mouthSmileLeft"], "weightMat": [[0, 1]]}
    (tmp_path / "a.a2f.json").write_text(json.dumps(data | change))
    with one_line(FormatError, match=message):
        read_curves(tmp_path / "a.a2f.json")


@pytest.mark.parametrize("avatar", [ARKIT_ID, "cc4"])
def test_unitys_curves_are_the_weights_in_percent(tmp_path, take, avatar):
    """As Unity evaluates a clip: Hermite with the slopes of both ends, per second."""
    shapes = convert(take, avatar)
    write_curves(tmp_path / "talk.anim", shapes)
    text = (tmp_path / "talk.anim").read_text()
    clip = yaml.safe_load("\n".join(line for line in text.splitlines() if line[:1] not in "%-"))
    clip = clip["AnimationClip"]
    assert clip["m_Name"] == "take" and clip["m_SampleRate"] == 30
    names = {name.lower(): name for name in shapes.names}
    n_keys = 0
    for curve in clip["m_FloatCurves"]:
        assert curve["classID"] == 137 and curve["attribute"].startswith("blendShape.")
        keys = curve["curve"]["m_Curve"]
        n_keys += len(keys)
        rows = [[key[part] for key in keys] for part in ("time", "value", "inSlope", "outSlope")]
        found = hermite(*rows, np.arange(60) / 30) / 100
        name = names[curve["attribute"].removeprefix("blendShape.").lower()]
        assert np.abs(found - shapes[name]).max() < 6e-4, name
    assert len(clip["m_FloatCurves"]) == (52 if avatar == ARKIT_ID else len(shapes.names))
    assert n_keys < 0.3 * 60 * len(clip["m_FloatCurves"])
