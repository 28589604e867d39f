"""The gRPC stream, by the client of the package `nvidia-audio2face-3d` as it is published."""

import json
import threading
from contextlib import ExitStack

import numpy as np
import pytest

from api.guard.keys import digest_of, new_key
from deitalk import LiveAnimator
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import convert
from rig.curves import RigCurves
from tests.api.conftest import wav
from tests.api.server import free_port, serving, wait_for

NEEDS = "needs the extra audio2face"
grpc = pytest.importorskip("grpc", reason=NEEDS)
audio_pb2 = pytest.importorskip("nvidia_ace.audio_pb2", reason=NEEDS)
status_pb2 = pytest.importorskip("nvidia_ace.status_pb2", reason=NEEDS)
audio2face_pb2_grpc = pytest.importorskip("nvidia_audio2face_3d.audio2face_pb2_grpc", reason=NEEDS)
a2f = pytest.importorskip("nvidia_audio2face_3d.messages_pb2", reason=NEEDS)

GREEDY = "dk_greedy-key-of-the-tests"
RATE, SECONDS = 48_000, 2.5
SOUND = wav(SECONDS, RATE)[44:]


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    key, digest = new_key()
    port = free_port()
    keys = [{"name": "farm", "sha256": digest}]
    keys.append({"name": "greedy", "sha256": digest_of(GREEDY), "live": 99})
    with serving(
        tmp_path_factory.mktemp("a2f"), grpc_port=port, keys=json.dumps(keys), job_workers=0,
        live_sessions=6,
    ):  # fmt: skip
        yield f"127.0.0.1:{port}", key


def requests(sound, emotions=(), piece=9600, **header):
    audio = {"channel_count": 1, "samples_per_second": RATE, "bits_per_sample": 16}
    header["audio_header"] = audio_pb2.AudioHeader(**audio | header.pop("audio", {}))
    yield a2f.AudioWithEmotionStream(audio_stream_header=a2f.AudioWithEmotionStreamHeader(**header))
    for at in range(0, len(sound), piece):
        part = a2f.AudioWithEmotion(audio_buffer=sound[at : at + piece], emotions=emotions)
        yield a2f.AudioWithEmotionStream(audio_with_emotion=part)
    yield a2f.AudioWithEmotionStream(end_of_audio=a2f.AudioWithEmotionStream.EndOfAudio())


def answers(server, sent, key=None):
    address, known = server
    metadata = [("authorization", f"Bearer {key or known}")]
    with grpc.insecure_channel(address, options=[("grpc.enable_http_proxy", 0)]) as channel:
        stub = audio2face_pb2_grpc.A2FControllerServiceStub(channel)
        return list(stub.ProcessAudioStream(sent, metadata=metadata, timeout=120))


def frames(found):
    parts = [m.animation_data for m in found if m.WhichOneof("stream_part") == "animation_data"]
    rows = [w for part in parts for w in part.skel_animation.blend_shape_weights]
    values = np.array([row.values for row in rows], np.float32).reshape(len(rows), 52)
    sound = b"".join(part.audio.audio_buffer for part in parts)
    return [row.time_code for row in rows], values, sound


def test_a_published_client_gets_every_frame_and_its_sound(server):
    header, *found, event, status = answers(server, requests(SOUND))
    names = list(header.animation_data_stream_header.skel_animation_header.blend_shapes)
    assert len(names) == 52 and {"JawOpen", "EyeBlinkLeft", "TongueOut"} <= set(names)
    times, values, sound = frames(found)
    np.testing.assert_allclose(times, np.arange(round(30 * SECONDS)) / 30, atol=1e-9)
    assert sound == SOUND and values.min() >= 0 and values.max() <= 1
    assert event.event.event_type == a2f.END_OF_A2F_AUDIO_PROCESSING
    assert status.status.code == status_pb2.Status.SUCCESS

    animator = LiveAnimator(sample_rate=RATE, life="off")
    samples = np.frombuffer(SOUND, "<i2").astype(np.float32) / 32768
    own = np.concatenate([animator.feed(samples), animator.finish()])
    curves = convert(RigCurves(own, animator.names, fps=30), ARKIT_ID).values
    jaw = curves[:, arkit_controls().index("JawOpen")]
    np.testing.assert_allclose(values[:, names.index("JawOpen")], jaw, atol=2e-3)
    assert jaw.max() > 0.02


def test_parameters_of_shapes_and_emotions_are_kept(server):
    def smile(found):
        header, *rest = found
        names = list(header.animation_data_stream_header.skel_animation_header.blend_shapes)
        values = frames(rest)[1]
        return values[30:, names.index("MouthSmileLeft")].mean(), values[:, names.index("JawOpen")]

    shapes = a2f.BlendShapeParameters(
        bs_weight_multipliers={"JawOpen": 0.0}, bs_weight_offsets={"JawOpen": 1.5},
        enable_clamping_bs_weight=True,
    )  # fmt: skip
    joy = [a2f.EmotionWithTimeCode(emotion={"joy": 1.0})]
    sad = a2f.EmotionParameters(beginning_emotion={"grief": 1.0})
    happy, jaw = smile(answers(server, requests(SOUND, joy, blendshape_params=shapes)))
    assert (jaw == 1.0).all()
    assert happy > smile(answers(server, requests(SOUND, emotion_params=sad)))[0] + 0.02


def test_an_empty_stream_ends(server):
    *_, event, status = answers(server, requests(b""))
    assert event.WhichOneof("stream_part") == "event" and not status.status.code


@pytest.mark.parametrize(
    ("given", "key", "code", "words"),
    [
        ({}, "wrong", "UNAUTHENTICATED", "key is unknown"),
        ({"audio": {"bits_per_sample": 32}}, None, "INVALID_ARGUMENT", "16-bit"),
        ({"audio": {"samples_per_second": 1}}, None, "INVALID_ARGUMENT", "8000 to 192000"),
        ({"emotions": [{"emotion": {"boredom": 1.0}}]}, None, "INVALID_ARGUMENT", "boredom"),
    ],
)
def test_what_cannot_be_animated_is_refused(server, given, key, code, words):
    with pytest.raises(grpc.RpcError) as error:
        answers(server, requests(SOUND, **given), key)
    assert error.value.code() == grpc.StatusCode[code] and words in error.value.details()


def test_streams_that_a_key_leaves_open_keep_no_other_key_out(server):
    """Of six sessions it gets three, while it holds fewer than are free; they say nothing."""
    over = threading.Event()

    def silent():
        over.wait()
        yield from ()

    with ExitStack() as stack:
        stack.callback(over.set)
        options = [("grpc.enable_http_proxy", 0)]
        channel = stack.enter_context(grpc.insecure_channel(server[0], options=options))
        stub = audio2face_pb2_grpc.A2FControllerServiceStub(channel)
        metadata = [("authorization", f"Bearer {GREEDY}")]
        calls = [stub.ProcessAudioStream(silent(), metadata=metadata) for _ in range(9)]
        wait_for(lambda: sum(call.done() for call in calls) == 6)
        done = [call for call in calls if call.done()]
        assert {call.code() for call in done} == {grpc.StatusCode.RESOURCE_EXHAUSTED}
        assert "wait for one to end" in done[0].details()
        assert len(frames(answers(server, requests(SOUND)))[0]) == round(30 * SECONDS)
