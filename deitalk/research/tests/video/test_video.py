"""Filmed takes to a dataset folder: files of landmarks, videos, the detector and its absence."""

import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile

from deitalk.data.captures import imported
from deitalk.data.captures.segments import within_captured
from deitalk.data.captures.sources import find_sound, find_takes
from deitalk.data.captures.take import CapturedCurves, read_capture
from deitalk.data.clips import read_clips, read_known
from deitalk.errors import MissingError
from deitalk.research.tests.filmed_head import filmed_mesh, write_mesh
from deitalk.research.tests.video.test_decode import write_video
from deitalk.research.video.detector import _chosen
from deitalk.research.video.landmarks import USED
from rig import default_controls, read_curves, rest_curves
from rig.face.head import build_head
from tests.errors import one_line
from tests.takes import bursts, is_open

CONTROLS = default_controls()
JAW = "CTRL_C_jaw.ty"
ANNA = dict(actor="anna", emotion="happy")

import_captures = partial(imported.import_captures, split_by="none")
"""Of short takes, whose division `test_splits` tests."""


@pytest.fixture(scope="module")
def filmed_take(tmp_path_factory):
    """Eight seconds at 15 fps whose jaw opens with the sound, without a face from 3 to 4 s."""
    folder = tmp_path_factory.mktemp("takes")
    times = np.arange(8 * 15) / 15
    values = np.tile(np.asarray(CONTROLS.rest, np.float64), (len(times), 1))
    values[:, CONTROLS.index(JAW)] = 0.4 * np.convolve(is_open(times), [0.25, 0.5, 0.25], "same")
    head = np.zeros((len(times), 6))
    head[:, 0] = 8 * np.sin(times)
    mesh = filmed_mesh(build_head(1), values, head)
    mesh[(times >= 3) & (times < 4)] = np.nan
    write_mesh(folder / "talk.npz", mesh, 15)
    soundfile.write(folder / "talk.wav", bursts(8), 16_000)
    return folder


def test_landmarks_become_clips_without_the_part_that_has_no_face(filmed_take, tmp_path):
    result = import_captures([filmed_take], tmp_path / "data", **ANNA)
    (take,) = result.takes
    assert take.kind == "video" and "no face in 13% of the frames, left out" in take.notes
    clips = read_clips(tmp_path / "data")
    assert len(clips) >= 2
    for clip in clips:
        start, stop = clip.span
        assert stop <= 3.05 or start >= 3.9
        curves = read_curves(clip.curves)
        assert curves.head is not None
        at = curves.times + clip.offset_seconds + start
        assert not ((at > 3.05) & (at < 3.9)).any()
        opens = is_open(at)
        assert curves[JAW][opens].mean() > curves[JAW][~opens].mean() + 0.1
    known = read_known(clips[0].known, CONTROLS)
    assert known[CONTROLS.index(JAW)] and not known[CONTROLS.index("CTRL_C_tongue_inOut.ty")]


def test_parts_of_spans_are_those_with_every_frame():
    seen = np.ones(300, bool)
    seen[100:130] = seen[200] = False
    found = within_captured([(0.0, 4.0), (4.1, 9.0)], seen, 30)
    np.testing.assert_allclose(found, [(0, 100 / 30), (130 / 30, 200 / 30), (201 / 30, 9.0)])


def test_margin_ends_where_the_face_is_lost():
    seen = np.ones(90, bool)
    seen[[10, 70]] = False
    capture = CapturedCurves(rest_curves(90), CONTROLS.names, "video", seen=seen)
    assert capture.around(20, 60, 18) == slice(11, 70)
    assert capture.around(40, 50, 5) == slice(35, 55)


def test_videos_are_takes_where_no_curves_are(tmp_path):
    for name in ("talk.mp4", "sub/other.MOV", ".hidden/no.mp4"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    takes = find_takes([tmp_path])[0]
    assert [take.stem for take in takes] == ["other", "talk"]
    assert find_sound(takes[1], "", (), takes) == tmp_path / "talk.mp4"
    write_mesh(tmp_path / "talk.npz", np.zeros((4, 478, 3)), 30)
    (only,) = find_takes([tmp_path])[0]
    assert only.curves.name == "talk.npz"
    assert find_sound(only, "", (), [only]) == tmp_path / "talk.mp4"


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (None, "a video needs MediaPipe .*deitalk\\[video\\].* or import a file of its landmarks"),
        (SimpleNamespace(__version__="1.2.2"), "MediaPipe 1.2.2 brings no model .*<0.10.22"),
    ],
)
def test_missing_detector_is_one_line_with_the_way_out(monkeypatch, tmp_path, module, message):
    monkeypatch.setitem(sys.modules, "mediapipe", module)
    with one_line(MissingError, match=message):
        read_capture(write_video(tmp_path / "a.mp4"))


def face(x: float, size: float) -> np.ndarray:
    points = np.zeros((len(USED), 3), np.float32)
    points[:, 0] = np.linspace(x - size / 2, x + size / 2, len(USED))
    return points


def test_largest_face_is_followed():
    near, far = face(100, 50), face(400, 60)
    assert _chosen([near, far], None) is far
    assert _chosen([near, far], face(110, 50)) is near  # a little larger is no other person
    assert _chosen([near, face(400, 90)], face(110, 50))[0, 0] > 300
    assert _chosen([], near) is None
