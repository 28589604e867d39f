"""What breaks a protocol or a form: a problem that names it, and no line of ERROR in the log."""

import base64
import json
import os
import socket
import struct
import time
from contextlib import suppress

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.api.conftest import wav
from tests.api.test_attacks import raw
from tests.api.test_jobs import submit, wait

HOST = b"Host: 127.0.0.1\r\n"
CLIP = wav(0.3)


@pytest.fixture(autouse=True)
def no_error_in_the_log(server):
    size = server.log.stat().st_size
    yield
    log = server.log.read_text()[size:]
    assert "ERROR" not in log and "Traceback" not in log


def upgrade(path: str = "/v1/live", method: str = "GET", **headers: str) -> bytes:
    given = {
        "Host": "127.0.0.1", "Upgrade": "websocket", "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": base64.b64encode(os.urandom(16)).decode(),
    } | {name.replace("_", "-"): value for name, value in headers.items()}  # fmt: skip
    lines = "".join(f"{name}: {value}\r\n" for name, value in given.items() if value)
    return f"{method} {path} HTTP/1.1\r\n{lines}\r\n".encode()


def split(answer: bytes) -> tuple[int, dict[str, str], bytes]:
    head, _, body = answer.partition(b"\r\n\r\n")
    first, *lines = head.decode("latin-1").split("\r\n")
    pairs = [line.partition(": ") for line in lines]
    headers = {name.lower(): value for name, _, value in pairs}
    return int(first.split()[1]), headers, body[: int(headers["content-length"])]


@pytest.mark.parametrize(
    ("request_", "statuses"),
    [
        (b"nonsense\r\n\r\n", {400}),
        (b"GET /healthz\r\n\r\n", {400}),
        (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", {400, 403}),
        (b"GET /healthz HTTP/1.1\r\n\r\n", {400}),
        (b"GET /healthz HTTP/1.1\r\n" + HOST + HOST + b"\r\n", {400}),
        (b"GET /h\xe4 HTTP/1.1\r\n" + HOST + b"\r\n", {400}),
        (b"GET /healthz HTTP/1.1\r\n" + HOST + b"a b: c\r\n\r\n", {400}),
        (b"GET /healthz HTTP/1.1\r\n" + HOST + b"X: " + b"a" * 70_000 + b"\r\n\r\n", {400, 431}),
        (b"POST /v1/animations HTTP/1.1\r\n" + HOST + b"Content-Length: x\r\n\r\n", {400}),
        (b"POST /v1/animations HTTP/1.1\r\n" + HOST + b"Content-Length: -1\r\n\r\n", {400}),
        (b"POST /v1/animations HTTP/1.1\r\n" + HOST
         + b"Content-Length: 1\r\nContent-Length: 2\r\n\r\na", {400}),
        (b"POST /v1/animations HTTP/1.1\r\n" + HOST
         + b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", {400}),
        (b"GET /healthz HTTP/1.1\r\n" + HOST
         + b"Transfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\n0\r\n\r\n", {400}),
        (b"POST /v1/animations HTTP/1.1\r\n" + HOST + b"Transfer-Encoding: gzip\r\n\r\n", {400, 501}),
        (b"POST /v1/animations HTTP/1.1\r\n" + HOST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n", {400}),
        (b"GET /none HTTP/1.1\r\n" + HOST + b"\r\n", {404}),
        (b"GET /v1 HTTP/1.1\r\n" + HOST + b"\r\n", {404}),
        (b"GET /v1/models/ HTTP/1.1\r\n" + HOST + b"\r\n", {404}),
        (b"GET /v1/../../etc/passwd HTTP/1.1\r\n" + HOST + b"\r\n", {404}),
        (b"GET /v1/jobs/%ff%fe HTTP/1.1\r\n" + HOST + b"\r\n", {404, 422}),
        (b"OPTIONS * HTTP/1.1\r\n" + HOST + b"\r\n", {404}),
        (b"CONNECT a:1 HTTP/1.1\r\n" + HOST + b"\r\n", {404}),
        (b"TRACE /v1/models HTTP/1.1\r\n" + HOST + b"\r\n", {405}),
        (b"BREW /v1/models HTTP/1.1\r\n" + HOST + b"\r\n", {405}),
        (b"DELETE /v1/animations HTTP/1.1\r\n" + HOST + b"\r\n", {405}),
        (b"GET /v1/animations HTTP/1.1\r\n" + HOST + b"\r\n", {405}),
        (b"GET /v1/live HTTP/1.1\r\n" + HOST + b"\r\n", {404}),
        (b"GET /healthz HTTP/1.1\r\n" + HOST + b"Upgrade: h2c\r\nConnection: Upgrade\r\n\r\n", {200}),
        (upgrade("/v1/none"), {404}),
        (upgrade("/v1/models"), {404}),
        (upgrade(method="POST"), {400, 405}),
        (upgrade(**{f"X_{k}": "1" for k in range(150)}), {400}),
        (upgrade(X="a" * 9000), {400}),
        (upgrade(Sec_WebSocket_Version="12"), {426, 400}),
        (upgrade(Sec_WebSocket_Version=""), {426, 400}),
        (upgrade(Sec_WebSocket_Key="short"), {400}),
        (upgrade(Sec_WebSocket_Key=""), {400}),
        (upgrade(Origin="https://evil.example"), {403}),
        (upgrade(Host="evil.example"), {403}),
    ],
)  # fmt: skip
def test_what_is_no_request_is_answered_by_a_problem(server, request_, statuses):
    status, headers, body = split(raw(server, request_))
    assert status in statuses, body
    if status != 200:
        assert headers["content-type"] == "application/problem+json"
        content = json.loads(body)
        assert content["code"] and content["message"] and "detail" in content


FORM = "multipart/form-data; boundary=x"


def part(
    name: str = "recording", extra: str = '; filename="a.wav"', content: bytes = CLIP
) -> bytes:
    head = f'--x\r\nContent-Disposition: form-data; name="{name}"{extra}\r\n\r\n'
    return head.encode() + content + b"\r\n"


@pytest.mark.parametrize(
    ("kind", "body", "status", "named"),
    [
        ("multipart/form-data", part() + b"--x--\r\n", 400, "boundary"),
        ("multipart/form-data; boundary=", part() + b"--x--\r\n", 400, "boundary"),
        ("multipart/form-data; boundary=y", part() + b"--x--\r\n", 400, "boundary"),
        (FORM, b"", 400, "last boundary"),
        (FORM, b"nonsense", 400, "boundary"),
        (FORM, part(), 400, "last boundary"),
        (FORM, part()[:200], 400, "last boundary"),
        (FORM, b"--x\r\n", 400, "last boundary"),
        (FORM, b"--x\r\n\r\nvalue\r\n--x--\r\n", 400, "Content-Disposition"),
        (FORM, b"--x\r\nContent-Disposition: form-data\r\n\r\nv\r\n--x--\r\n", 400, "name"),
        (FORM, b"--x\r\nContent Disposition: a\r\n\r\nv\r\n--x--\r\n", 400, "header"),
        (FORM, part("emotion", "", b"x" * 9_000_000)[:3_900_000] + b"\r\n--x--\r\n", 400, "size"),
        (FORM, part("f1") * 30 + b"--x--\r\n", 400, "files"),
        (FORM, part("f", "", b"1") * 70 + b"--x--\r\n", 400, "fields"),
        (FORM, part("recording", "", b"RIFF") + b"--x--\r\n", 422, "recording=@FILE"),
        (FORM, part("mesh") + b"--x--\r\n", 422, "mesh"),
        (FORM, part() + part("fps", "", b"many") + b"--x--\r\n", 422, "fps"),
        (FORM, part() + part("fps", "", b"\xff\xfe") + b"--x--\r\n", 422, "fps"),
        (FORM, part() + part("emotion", "", b'{"happy": ') + b"--x--\r\n", 422, "emotion"),
        (FORM, part() + part("emotion", '; filename="a.exe"', b"x") + b"--x--\r\n", 415, ".csv"),
        (FORM, part() + part("nothing", "", b"1") + b"--x--\r\n", 422, "nothing"),
        (FORM, part("transcript", '; filename="a.txt"', b"hi") + b"--x--\r\n", 422, "recording"),
        ("application/json", b"{}", 415, "multipart/form-data"),
        ("application/x-www-form-urlencoded", b"emotion=happy", 415, "multipart/form-data"),
        ("text/plain", CLIP, 415, "multipart/form-data"),
        ("", CLIP, 415, "multipart/form-data"),
        ("nonsense", CLIP, 415, "multipart/form-data"),
        ("audio/wav", b"", 422, "recording"),
    ],
)
def test_what_is_malformed_in_a_form_is_named(client, kind, body, status, named):
    answer = client.post("/v1/animations", content=body, headers={"Content-Type": kind})
    content = answer.json()
    assert answer.status_code == status, content
    assert answer.headers["content-type"] == "application/problem+json"
    assert named in content["message"], content


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"fps": "29,97"}, "fps '29,97': Input should be a valid number"),
        ({"rest": "2"}, "rest '2' must be a number, 0 to 1"),
        ({"name": "a/b"}, "name 'a/b': must be 1 to 64 of A to Z"),
        ({"emotoin": "sad"}, "emotoin 'sad': unknown key; known are emotion"),
        ({}, "job_id 'x': must be the id of a job"),
    ],
)
def test_an_option_is_named_once_with_its_value_and_rule(client, fields, said):
    answer = (
        client.post("/v1/animations", data=fields, files={"recording": ("a.wav", CLIP)})
        if fields
        else client.get("/v1/jobs/x")
    )
    assert answer.status_code == 422 and answer.json()["message"].startswith(said), answer.text


@pytest.mark.parametrize(
    "path", ["/v1/conversions", "/v1/validate", "/v1/retargets", "/v1/jobs", "/v1/diffs"]
)
def test_every_route_with_a_form_names_what_is_malformed(client, path):
    for kind, body, status in (
        ("application/json", b"{}", 415), (FORM, part(), 400), (FORM, b"--x--\r\n", 422),
        ("multipart/form-data", b"", 400),
    ):  # fmt: skip
        answer = client.post(path, content=body, headers={"Content-Type": kind})
        assert answer.status_code == status, answer.text
        assert answer.headers["content-type"] == "application/problem+json"


def frame(opcode: int, content: bytes, *, is_final: bool = True, is_masked: bool = True) -> bytes:
    """A frame of a client of RFC 6455, of less than 64 KiB."""
    first = (0x80 if is_final else 0) | opcode
    size = bytes([0x80 * is_masked | min(len(content), 126)])
    if len(content) > 125:
        size += struct.pack(">H", len(content))
    return bytes([first]) + size + (bytes(4) if is_masked else b"") + content


TEXT, BINARY, CLOSE, PING = 1, 2, 8, 9


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        (frame(TEXT, b"\xff\xfe"), 1007),
        (frame(TEXT, b"{}", is_masked=False), 1002),
        (frame(3, b"{}"), 1002),
        (frame(TEXT | 0x40, b"{}"), 1002),
        (frame(0, b"{}"), 1002),
        (frame(PING, bytes(126)), 1002),
        (frame(PING, b"", is_final=False), 1002),
        (frame(CLOSE, b"\x03"), 1002),
        (frame(CLOSE, struct.pack(">H", 1006)), 1002),
        (b"\x82\xff" + struct.pack(">Q", 2**40), 1009),
        (frame(TEXT, b"not json"), 1007),
        (frame(TEXT, b"[]"), 1007),
        (frame(TEXT, b'{"type": "stop"}'), 1007),
        (frame(TEXT, b'{"sample_rate": 1}'), 1007),
        (frame(TEXT, b'{"model": "none"}'), 1008),
        (frame(TEXT, b"[" * 4000), 1007),
        (frame(TEXT, b"{" + b" " * 5000), 1009),
        (frame(BINARY, bytes(99)), 1007),
    ],
)
def test_messages_that_break_a_rule_close_the_socket_and_are_no_errors_of_ours(server, sent, code):
    with socket.create_connection(server.address, timeout=300) as connection:
        connection.sendall(upgrade())
        answer = b""
        while b"\r\n\r\n" not in answer:
            answer += connection.recv(4096)
        assert b" 101 " in answer
        connection.sendall(sent)
        received = answer.partition(b"\r\n\r\n")[2]
        with suppress(ConnectionError):
            while block := connection.recv(4096):
                received += block
                if struct.pack(">H", code) in block:  # else the server waits for it
                    connection.sendall(frame(CLOSE, struct.pack(">H", code)))
    assert b"\x88" in received and struct.pack(">H", code) in received, received


@pytest.mark.parametrize("wait_seconds", [0.0, 0.002, 0.05])
def test_clients_that_leave_in_the_handshake_are_no_errors(server, wait_seconds):
    for _ in range(30):
        connection = socket.create_connection(server.address, timeout=300)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.sendall(upgrade())
        time.sleep(wait_seconds)
        connection.close()  # by a reset
    with connect(f"{server.url.replace('http', 'ws')}/v1/live", proxy=None) as live:
        live.send("[]")
        assert json.loads(live.recv())["code"] == "message_unknown"
        with pytest.raises(ConnectionClosed):
            live.recv()


def test_head_has_no_part_and_ends_at_once(server, client):
    job = wait(client, submit(client, recording=CLIP, format="csv").json()["id"])
    head = client.head(job["result"], headers={"Range": "bytes=0-9"})
    assert head.status_code == 200 and head.headers["content-length"] == str(job["result_bytes"])
    other = submit(client, recording=wav(60.0), format="csv").json()
    began = time.monotonic()
    head = client.head(f"/v1/jobs/{other['id']}/events")
    assert head.status_code == 200 and head.headers["content-type"].startswith("text/event-stream")
    assert client.get(f"/v1/jobs/{other['id']}").json()["status"] in ("queued", "running")
    client.post(f"/v1/jobs/{other['id']}/cancel")
    assert time.monotonic() - began < 30


@pytest.mark.parametrize("is_gone", [True, False])
def test_result_whose_file_is_not_there_or_not_whole_is_gone(server, client, is_gone):
    job = wait(client, submit(client, recording=CLIP, format="csv").json()["id"])
    (file,) = server.log.parent.rglob(f"deitalk-results/{job['id']}/*")
    if is_gone:
        file.unlink()
    else:
        os.truncate(file, 10)
    for headers in ({}, {"Range": "bytes=0-5"}):
        answer = client.get(job["result"], headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (410, "gone")
        assert answer.headers["content-type"] == "application/problem+json"
