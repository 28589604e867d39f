"""MediaPipe on pictures of the embedded head (where the extra `video` is installed)."""

import numpy as np
import pytest

from deitalk.research.tests.video.test_decode import encode
from deitalk.research.video.detector import track_face
from deitalk.research.video.landmarks import LIDS, MIDDLE
from rig import default_controls
from rig.face.head import build_head
from rig.face.render.shading import VIEWS
from rig.face.render.software import Renderer

pytestmark = pytest.mark.slow
CONTROLS = default_controls()


def test_open_mouth_shut_eyes_and_a_missing_face_are_seen(tmp_path, capfd):
    """And nothing of MediaPipe's own logs is printed."""
    pytest.importorskip("mediapipe", reason="needs deitalk[video]")
    head = build_head()
    rest = np.asarray(CONTROLS.rest, np.float64)
    opened, shut = rest.copy(), rest.copy()
    opened[CONTROLS.index("CTRL_C_jaw.ty")] = 0.6
    for side in "LR":
        shut[CONTROLS.index(f"CTRL_{side}_eye_blink.ty")] = 1
    renderer = Renderer(head.mesh, (360, 480), VIEWS["face"])
    poses = head.pose(np.stack([rest, opened, shut]))
    drawn = [renderer.render(pose, head.mesh.normals(pose)) for pose in poses]
    pictures = [p for p in (*drawn, np.zeros_like(drawn[0])) for _ in range(6)]
    track = track_face(encode(tmp_path / "a.mp4", pictures))
    gap = track.at(MIDDLE["lower"])[:, 1] - track.at(MIDDLE["upper"])[:, 1]
    lids = track.at(*LIDS["L"]["lower"])[:, 1] - track.at(*LIDS["L"]["upper"])[:, 1]
    assert gap[10] > gap[4] + 15 and lids[16] < 0.5 * lids[4]
    assert not np.isfinite(track.points[-1]).any()
    assert capfd.readouterr().err == ""
