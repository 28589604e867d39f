"""The page of curves of a rig that has no head here."""

import base64
import json
import re

import numpy as np
import pytest

from deitalk.preview import page as page_module
from deitalk.preview.page import render_page
from deitalk.preview.source import PreviewError, PreviewSource
from deitalk.preview.speech_warnings import find_warnings
from deitalk.preview.video import render_video
from rig import RigCurves, write_curves
from tests.command import ran

NAMES = ("still", "small</script>", "large")


def source(title: str = "own", names=NAMES) -> PreviewSource:
    wave = np.sin(np.arange(60) / 5)
    values = np.stack([0 * wave, 0.1 * wave, wave], axis=1).astype(np.float32)
    curves = RigCurves(values, names, fps=30, control_set="mine@1")
    sound = (0.1 * np.sin(np.arange(32_000))).astype(np.float32)
    return PreviewSource(title, curves, sound, 16_000)


def facts(text: str) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    assert found is not None
    return json.loads(found[1])


def test_page_has_every_curve_under_its_name_the_widest_first(tmp_path, monkeypatch):
    """It needs no built player, and a name cannot end the script."""
    monkeypatch.setattr(page_module, "BUNDLE", tmp_path / "none.html")
    takes = [source("before"), source("after")]
    found = facts(render_page(takes, tmp_path / "p.html").read_text())
    assert found["names"] == list(reversed(NAMES)) and found["moving"] == [True, True, False]
    assert [take["title"] for take in found["takes"]] == ["before", "after"]
    values = np.frombuffer(base64.b64decode(found["takes"][1]["values"]), "<f4").reshape(60, 3)
    np.testing.assert_array_equal(values, takes[1].curves.values[:, ::-1])
    assert found["ranges"][0] == pytest.approx([-1, 1], abs=0.01) and found["audio"]


def test_takes_of_two_rigs_are_refused(tmp_path):
    other = source("other", ("a", "b", "c"))
    with pytest.raises(PreviewError, match="compare takes of one rig"):
        render_page([source(), other], tmp_path / "p.html")


def test_video_of_another_rig_is_refused_and_there_are_no_warnings(tmp_path):
    with pytest.raises(PreviewError, match=r"mine@1, which has no head here"):
        render_video(source(), tmp_path / "p.mp4")
    assert find_warnings(source()) == []


def test_command_writes_the_page_beside_curves(tmp_path):
    write_curves(tmp_path / "x.npz", source(names=("a", "b", "c")).curves)
    ran("preview", tmp_path / "x.npz")
    assert facts((tmp_path / "x.html").read_text())["names"] == ["c", "b", "a"]
    assert not (tmp_path / "x.mp4").exists()
