"""The service with the backend onnx: the curves of torch, from workers that import none."""

from pathlib import Path

import numpy as np
import pytest

from deitalk import LiveAnimator, animate
from rig import read_curves
from tests.api.conftest import wav
from tests.api.server import serving
from tests.api.test_live import begin, frames_of, live, pcm

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytestmark = pytest.mark.slow  # three models are exported
SPEECH = wav(1.5)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("onnx"), backend="onnx") as running:
        yield running


def libraries(server) -> str:
    """Files that the processes below the server have mapped."""
    found, parents = "", {server.process.pid}
    for status in sorted(Path("/proc").glob("[0-9]*/stat"), key=lambda path: int(path.parts[2])):
        try:
            fields = status.read_text().rsplit(")", 1)[1].split()
            maps = (status.parent / "maps").read_text()
        except OSError:
            continue
        if int(fields[1]) in parents:
            parents.add(int(status.parts[2]))
            found += maps
    return found


def post(server, path, **options):
    with server.client() as client:
        return client.post(path, files={"recording": ("a.wav", SPEECH)}, params=options)


@pytest.mark.parametrize("model", ["default"])
def test_curves_are_those_of_torch(server, model, tmp_path):
    answer = post(server, "/v1/animations", emotion="happy", model=model, format="npz")
    assert answer.is_success, answer.text
    (tmp_path / "a.npz").write_bytes(answer.content)
    expected = animate(SPEECH, "happy", model=model).curves.values
    assert np.abs(read_curves(tmp_path / "a.npz").values - expected).max() <= 2e-4


def test_live_session_has_the_frames_of_live_animator(server):
    check_live(server)


def test_live_sessions_alone_have_onnx(tmp_path):
    with serving(tmp_path, live_backend="onnx") as server:
        check_live(server)
        assert post(server, "/v1/meshes", emotion="happy", format="npz").is_success
        loaded = libraries(server)
    assert "onnxruntime" in loaded and "libtorch" in loaded


def check_live(server):
    sound = pcm(1.0)
    with live(server) as session:
        begin(session, model="live", emotion="happy", life="off", seed=0)
        session.send(sound)
        session.send('{"type": "stop"}')
        found, end = frames_of(session)
    assert end == {"type": "end", "frames": 30}
    animator = LiveAnimator("live", emotion="happy", life="off", seed=0)
    expected = np.concatenate((animator.feed(sound), animator.finish()))
    assert np.abs(np.array([values for *_, values in found]) - expected).max() <= 2e-4


def test_workers_import_no_torch_and_refuse_meshes(server):
    answer = post(server, "/v1/meshes", emotion="happy", format="glb")
    assert answer.status_code == 422 and "meshes need torch" in answer.text
    loaded = libraries(server)
    assert "onnxruntime" in loaded and "libtorch" not in loaded
