"""What a hostile client sends: refused, and nothing of it on disk, in answers or in logs."""

import http.client
import io
import json
import re
import socket
import struct
import time
import zipfile
from contextlib import suppress
from pathlib import Path

import av
import httpx
import numpy as np
import pytest
from websockets.sync.client import connect

from tests.api.conftest import KEYS, bearer, wav
from tests.api.kill import frozen
from tests.api.test_jobs import submit, wait

SPEECH = wav(0.6)
TRAVERSALS = (
    "../../../../deitalk-attack",
    "/deitalk-attack",
    "..\\..\\deitalk-attack.glb",
    "a/../../deitalk-attack.csv",
    "%2e%2e%2fdeitalk-attack",
    "deitalk-attack\x00.csv",
)


def raw(server, request: bytes) -> bytes:
    """Everything that the server answers to bytes on a socket until it ends the connection."""
    with socket.create_connection(server.address, timeout=300) as connection:
        connection.sendall(request)
        answer = b""
        with suppress(ConnectionError):
            while block := connection.recv(65536):
                answer += block
        return answer


def status_of(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1])


@pytest.mark.parametrize("name", TRAVERSALS)
def test_names_of_a_request_never_become_paths(server, client, name, tmp_path):
    before = {path.name for path in server.log.parent.rglob("*")}
    files = {
        "recording": (name, SPEECH),
        "emotion": (name + ".csv", b"time,emotion,strength\n0,sad,1"),
    }
    assert client.post("/v1/animations", files=files).status_code == 200
    named = client.post("/v1/animations", files={"recording": SPEECH}, data={"name": name})
    model = client.post("/v1/animations", files={"recording": SPEECH}, data={"model": name})
    assert (named.status_code, model.status_code) == (422, 404)
    for path in ("/v1/jobs/", "/v1/control-sets/", "/v1/jobs/../../"):
        found = client.get(path + name.replace("\x00", "%00"))
        assert found.status_code in (400, 404, 422), (path, found.status_code)
    after = {path.name for path in server.log.parent.rglob("*")}
    assert not {left for left in after - before if "attack" in left}
    assert not list(Path("/").glob("deitalk-attack*"))


def test_emotion_of_a_file_on_the_server_is_not_read(client, tmp_path):
    track = tmp_path / "moods.csv"
    track.write_text("time,emotion,strength\n0,happy,1\n")
    for text in (str(track), f"{track}\n", f"file://{track}", f"happy=1.{track}"):
        answer = client.post("/v1/animations", files={"recording": SPEECH}, data={"emotion": text})
        assert answer.status_code == 422, text
        assert str(tmp_path) not in answer.text


def test_answers_and_log_hold_no_path_and_no_trace(server, client):
    bodies = [
        {"mesh": ("x.glb", b"glTF" + bytes(40)), "curves": ("c.csv", b"frame,time\n")},
        {"mesh": ("x.obj", b"v 0 0\nf 1 2 9\n"), "curves": ("c.json", b"{")},
        {"mesh": ("x.npz", b"PK\3\4"), "recording": SPEECH, "mapping": ("m.csv", b"a")},
    ]
    for files in bodies:
        answer = client.post("/v1/retargets", files=files)
        assert answer.status_code == 422, answer.text
        assert not re.search(r"/(tmp|home|root|work|usr|var)/", answer.text), answer.text
    log = server.log.read_text().split("starting")[-1]
    served = [line for line in log.splitlines() if " INFO " in line or " ERROR " in line]
    assert not [line for line in served if "/tmp/" in line or "/usr/" in line]
    assert "Traceback" not in log


def test_bodies_beyond_the_limit_are_refused(server, client):
    assert client.post("/v1/animations", content=bytes(4_100_000)).status_code == 413

    def blocks():
        for _ in range(50):
            yield bytes(100_000)

    assert client.post("/v1/animations", content=blocks()).status_code == 413
    lie = b"POST /v1/animations HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 99999999999\r\n\r\n"
    assert status_of(raw(server, lie)) == 413


def test_slow_bodies_and_slow_headers_are_cut_off(server):
    head = b"POST /v1/animations HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000\r\n\r\nslow"
    assert b"body_slow" in raw(server, head)
    assert raw(server, b"GET /healthz HTTP/1.1\r\nHost: 127.0") == b""


def test_bodies_that_come_slowly_and_steadily_are_read(server):
    """1.3 MB in five seconds, where a body has three and one more for each 64 KiB."""
    recording = b"no audio" * 160_000
    with socket.create_connection(server.address, timeout=300) as connection:
        head = f"POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {len(recording)}"
        connection.sendall(head.encode() + b"\r\nContent-Type: audio/wav\r\n\r\n")
        for start in range(0, len(recording), 1 << 17):
            connection.sendall(recording[start : start + (1 << 17)])
            time.sleep(0.5)
        assert status_of(connection.recv(65536)) == 202


def test_clients_that_do_not_read_their_answer_are_cut_off(server, client):
    """Thirty megabytes to a client that reads a kilobyte of them."""
    with socket.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.settimeout(300)
        connection.connect(server.address)
        head = f"POST /v1/meshes?format=ply HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {len(SPEECH)}"
        connection.sendall(head.encode() + b"\r\nContent-Type: audio/wav\r\n\r\n" + SPEECH)
        n_bytes = len(connection.recv(1024))
        assert client.get("/v1/emotions").status_code == 200
        time.sleep(6)  # the limit is 3 s
        with suppress(ConnectionError):
            while block := connection.recv(1 << 16):
                n_bytes += len(block)
    assert n_bytes < 10_000_000


def test_idle_connections_keep_nobody_out(server, client):
    """300 where 256 may be open: the idle ones make room, for probes and for requests."""
    idle = [socket.create_connection(server.address, timeout=300) for _ in range(300)]
    try:
        for path in ("/healthz", "/readyz", "/v1/emotions"):
            assert httpx.get(server.url + path, timeout=300, trust_env=False).status_code == 200
    finally:
        for connection in idle:
            connection.close()


@pytest.mark.parametrize(
    "head",
    ["nobody", "../../etc/passwd", "0' OR 1=1", "\x00", "9" * 40, "a" * 41, "-1", "1e400", "٣"],
)
def test_heads_that_are_not_there_are_refused_and_not_drawn(server, client, head):
    before = server.processor_seconds
    answer = client.get("/", params={"head": head})
    assert answer.status_code == 422, answer.text
    assert "/tmp" not in answer.text and server.processor_seconds - before < 2


def test_many_headers_are_refused(server):
    many = b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n" + b"X: 1\r\n" * 200 + b"\r\n"
    assert status_of(raw(server, many)) == 400


def test_pages_of_other_sites_are_refused(client, server):
    def status(headers, method="POST"):
        return client.request(method, "/v1/animations", content=SPEECH, headers=headers).status_code

    assert status({"Origin": "https://evil.example"}) == 403
    assert status({"Origin": "null"}) == 403
    assert status({"Sec-Fetch-Site": "cross-site"}) == 403
    assert status({"Host": "evil.example"}) == 403  # a name that was pointed at this machine
    assert status({"Origin": server.url}) == 200
    preflight = client.options("/v1/animations", headers={"Origin": "https://evil.example"})
    assert preflight.status_code == 403
    assert not [name for name in preflight.headers if name.startswith("access-control")]


def _wav_header(n_bytes: int, channels: int = 1, rate: int = 16000) -> bytes:
    each = (rate * 2 * channels) & 0xFFFFFFFF, (2 * channels) & 0xFFFF
    head = struct.pack(
        "<4sI4s4sIHHIIHH", b"RIFF", n_bytes & 0xFFFFFFFF, b"WAVE", b"fmt ", 16, 1, channels, rate,
        *each, 16,
    )  # fmt: skip
    return head + struct.pack("<4sI", b"data", n_bytes & 0xFFFFFFFF)


ENCODERS = {
    "mp4": ("aac", "f4", "fltp"),
    "mov": ("alac", "i2", "s16p"),
    "webm": ("libopus", "f4", "fltp"),
}
"""Containers that are read by FFmpeg's libraries; codec and samples that silence is written with."""


def _silence(seconds: float, kind: str) -> bytes:
    """Silence as a compressed recording of a few kilobytes."""
    import soundfile

    buffer = io.BytesIO()
    if kind in ENCODERS:
        return _encoded_silence(seconds, kind)
    with soundfile.SoundFile(buffer, "w", 8000, 1, format=kind) as file:
        for _ in range(int(seconds / 10)):
            file.write(np.zeros(80_000, np.float32))
    return buffer.getvalue()


def _encoded_silence(seconds: float, kind: str) -> bytes:
    """One encoded packet of silence, over and over."""
    (codec, number_type, samples), rate, buffer = ENCODERS[kind], 48_000, io.BytesIO()
    with av.open(buffer, "w", format=kind) as container:
        stream = container.add_stream(codec, rate=rate, layout="mono")
        stream.format = samples
        frame = av.AudioFrame.from_ndarray(np.zeros((1, rate), number_type), samples, "mono")
        frame.sample_rate = rate
        silent = stream.encode(frame)[-1]
        for number in range(int(seconds * rate / silent.duration)):
            packet = av.Packet(bytes(silent))
            packet.stream, packet.time_base = stream, silent.time_base
            packet.pts = packet.dts = number * silent.duration
            packet.duration = silent.duration
            container.mux(packet)
    return buffer.getvalue()


@pytest.mark.parametrize("kind", ["FLAC", "OGG", "MP3", *ENCODERS])
def test_compressed_minutes_are_refused_by_their_length(server, client, kind):
    bomb = _silence(400, kind)
    assert len(bomb) < 4_000_000
    before = server.processor_seconds
    answer = client.post("/v1/animations", content=bomb)
    assert answer.status_code in (413, 422), answer.text
    assert server.processor_seconds - before < 10


def test_false_headers_of_recordings_are_refused(client):
    for body in (
        _wav_header(0xFFFFFF00) + SPEECH[44:],
        _wav_header(1000, channels=65535) + bytes(1000),
        _wav_header(1000, rate=2**31) + bytes(1000),
        b"RIFF\xff\xff\xff\xffWAVE",
        b"fLaC" + b"\xff" * 400,
        b"OggS" + bytes(400),
        b"\x00\x00\x00\x18ftypM4A " + b"\xff" * 400,
        b"\x1aE\xdf\xa3" + b"\xff" * 400,
        b"#EXTM3U\nfile:///etc/passwd\n",
    ):
        answer = client.post("/v1/animations", content=body)
        assert answer.status_code in (200, 413, 422), (body[:20], answer.text)
        assert "root:" not in answer.text


def test_more_channels_than_the_limit_are_refused(client):
    answer = client.post("/v1/animations", content=wav(0.5, channels=17))
    assert (answer.status_code, answer.json()["code"]) == (413, "too_large")
    assert client.post("/v1/animations", content=wav(0.5, channels=16)).status_code == 200


def _zip_bomb() -> bytes:
    """An NPZ whose array of 8 GB takes some kilobytes."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f4", "fortran_order": False, "shape": (2**31,)}
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("neutral.npy", head.getvalue() + bytes(200_000_000))
    return buffer.getvalue()


def test_zip_bombs_are_refused(server, client):
    bomb = _zip_bomb()
    files = {"mesh": ("m.npz", bomb), "recording": SPEECH}
    before = server.processor_seconds
    mesh = client.post("/v1/retargets", files=files)
    curves = client.post("/v1/validate", files={"curves": ("c.npz", bomb)})
    assert mesh.status_code in (413, 422), mesh.text
    assert curves.status_code == 200 and not curves.json()["ok"]
    assert server.processor_seconds - before < 10


def test_videos_of_more_pixels_than_the_limit_are_refused(client):
    answer = client.post("/v1/animations?format=mp4&fps=60", content=SPEECH)
    assert answer.status_code == 413


def test_nested_keys_are_refused(client):
    deep = "[" * 100_000
    answer = client.post("/v1/animations", files={"recording": SPEECH}, data={"emotion": deep})
    assert answer.status_code == 422
    many = {f"f{k}": "1" for k in range(70)}
    assert client.post("/v1/animations", files={"recording": SPEECH}, data=many).status_code == 400


@pytest.mark.parametrize("charset", ["undefined", "punycode", "utf-16", "hex", "a/../b"])
def test_charsets_of_a_form_are_no_fault_of_ours(client, charset):
    form = b'--x\r\nContent-Disposition: form-data; name="emotion"\r\n\r\nh\xc3\xa4ppy\r\n--x--\r\n'
    kind = f"multipart/form-data; boundary=x; charset={charset}"
    answer = client.post("/v1/animations", content=form, headers={"Content-Type": kind})
    assert answer.status_code in (400, 422), answer.text


@pytest.mark.parametrize(
    "parts",
    [
        [("emotion", (None, "happy")), ("emotion", (None, "sad"))],
        [("emotion", (None, "happy")), ("emotion", ("a.csv", b"time,emotion,strength\n0,sad,1"))],
        [("words", ("a.txt", b"hello")), ("words", ("b.txt", b"bye"))],
        [("format", (None, "csv"))],
    ],
)
def test_options_that_are_given_twice_are_refused(client, parts):
    files = [("recording", ("a.wav", SPEECH)), *parts]
    answer = client.post("/v1/animations?format=csv", files=files)
    assert (answer.status_code, answer.json()["code"]) == (422, "option_invalid")
    raw = client.post("/v1/animations?fps=30&fps=60", content=SPEECH)
    assert (raw.status_code, raw.json()["code"]) == (422, "option_invalid")


def test_keys_scopes_and_their_absence(keyed_server):
    with keyed_server.client() as client:
        assert client.get("/healthz").status_code == 200
        assert client.get("/v1/models").status_code == 401
        wrong = client.get("/v1/models", headers={"Authorization": "Bearer dk_wrong"})
        assert (wrong.status_code, wrong.json()["code"]) == (401, "key_unknown")
        assert client.get(f"/v1/models?key={KEYS['farm']}").status_code == 401
        assert client.get("/v1/models", headers=bearer("viewer")).status_code == 200
        assert client.get("/v1/jobs", headers=bearer("viewer")).status_code == 403
        assert client.get("/metrics", headers=bearer("viewer")).status_code == 403
        metrics = client.get("/metrics", headers=bearer("farm")).text
    log = keyed_server.log.read_text()
    for key in KEYS.values():
        assert key not in log and key not in metrics


def test_requests_beyond_a_keys_rate_are_refused(keyed_server):
    with keyed_server.client(headers=bearer("slow")) as client:
        answers = [client.get("/v1/emotions") for _ in range(8)]
        assert answers[0].status_code == 200
        assert answers[-1].status_code == 429 and int(answers[-1].headers["retry-after"]) >= 1
    with keyed_server.client(headers=bearer("viewer")) as client:
        assert client.get("/v1/emotions").status_code == 200


def test_jobs_beyond_a_keys_limit_are_refused(keyed_server):
    with keyed_server.client(headers=bearer("farm")) as client:
        wait(client, submit(client, SPEECH).json()["id"])  # a worker has been started
        with frozen(keyed_server):
            job, *refused = [submit(client, SPEECH) for _ in range(3)]
            assert job.status_code == 202
            assert [answer.status_code for answer in refused] == [429, 429]
        wait(client, job.json()["id"])


def test_server_is_well_after_all_this(server, client):
    malformed = raw(server, b"\x16\x03\x01\x02\x00\x01\x00 TLS\r\n\r\n")
    assert malformed == b"" or status_of(malformed) == 400
    assert client.post("/v1/animations", content=SPEECH).status_code == 200
    connection = http.client.HTTPConnection(*server.address, timeout=300)
    connection.request("GET", "/healthz")
    answer = connection.getresponse()
    assert answer.status == 200 and json.loads(answer.read())["status"] == "ok"
    connection.close()
    for header, value in {"X-Content-Type-Options": "nosniff", "Cache-Control": "no-store"}.items():
        assert answer.getheader(header) == value
    assert answer.getheader("Server") is None


def test_live_session_outlasts_the_time_for_headers(server):
    with connect(f"{server.url.replace('http', 'ws')}/v1/live", proxy=None) as live:
        live.send(json.dumps({"type": "start", "frames": "json"}))
        live.recv()
        for _ in range(12):  # 2.4 s; headers have 2 s here
            live.send(bytes(6400))
            time.sleep(0.2)
        live.send(json.dumps({"type": "stop"}))
        last = {}
        while last.get("type") != "end":
            last = json.loads(live.recv())
    assert last["frames"] == 72
