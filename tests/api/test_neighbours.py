"""What one client may take from another: time of workers, places, connections; and who leaves."""

import json
import re
import socket
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from api.guard.keys import digest_of
from tests.api.conftest import KEYS, bearer, wav
from tests.api.kill import frozen
from tests.api.server import wait_for, wait_until

CLIP = wav(1.0)


@pytest.fixture(scope="module")
def crowded(keyed_server):
    return keyed_server


def send(server, name, recording=CLIP):
    return httpx.post(
        f"{server.url}/v1/animations?format=npz", content=recording, timeout=120,
        headers=bearer(name) | {"Content-Type": "audio/wav"}, trust_env=False,
    )  # fmt: skip


def wait_for_orders(server, count):
    wait_for(lambda: server.metric("busy_orders", bearer("anna")) == count)


def test_first_session_gets_its_header_as_soon_as_the_second(crowded):
    """The model was read when the server started, which takes ten times as long."""
    wait_for(lambda: "live voices are ready" in crowded.log.read_text())
    url, seconds = f"{crowded.url.replace('http', 'ws')}/v1/live", []
    for _ in range(2):
        with connect(url, additional_headers=bearer("anna"), proxy=None) as live:
            before = crowded.processor_seconds
            live.send(json.dumps({"type": "start"}))
            assert json.loads(live.recv())["type"] == "header"
            seconds.append(crowded.processor_seconds - before)
    assert seconds[0] < 5 * max(seconds[1], 0.03)


def request_of(server, name, recording=CLIP, length=None):
    """A connection that has sent a request."""
    connection = socket.create_connection(server.address, timeout=300)
    head = f"POST /v1/animations HTTP/1.1\r\nHost: {server.url[7:]}\r\nAuthorization: "
    head += f"Bearer {KEYS[name]}\r\nContent-Type: audio/wav\r\n"
    head += f"Content-Length: {length or len(recording)}\r\n\r\n"
    connection.sendall(head.encode() + recording)
    return connection


def test_work_of_clients_that_left_is_dropped(crowded):
    """Of abandoned requests one is at work and the others wait; none keeps anybody waiting."""
    left = crowded.metric("left_orders", bearer("anna"))
    for _ in range(3):
        wait_until(crowded, "/readyz")  # the worker was ended with its order
        with frozen(crowded):
            gone = [request_of(crowded, "anna") for _ in range(4)]
            wait_for_orders(crowded, 4)
            for connection in gone:
                connection.close()
            wait_for_orders(crowded, 0)
    assert crowded.metric("left_orders", bearer("anna")) == left + 12
    assert send(crowded, "bert").status_code == 200
    assert httpx.get(f"{crowded.url}/readyz", timeout=300, trust_env=False).status_code == 200


def test_full_house_refuses_before_the_upload_is_read(crowded):
    """Of eight places a key takes at most as many as it leaves: 4, 2 of the rest, 1, 1."""
    names = ["anna"] * 4 + ["bert"] * 2 + ["carl", "viewer"]
    with ThreadPoolExecutor(len(names)) as threads:
        with frozen(crowded):
            busy = []
            for count, name in enumerate(names, 1):
                busy.append(threads.submit(send, crowded, name))
                wait_for_orders(crowded, count)
            with request_of(crowded, "farm", b"RIFF", length=9_000_000) as connection:
                answer = connection.recv(65536).decode()
        assert answer.startswith("HTTP/1.1 503") and "retry-after: 1" in answer.lower()
        assert [request.result().status_code for request in busy] == [200] * len(names)


def test_key_may_have_so_many_requests_at_work(crowded):
    with ThreadPoolExecutor(2) as threads:
        with frozen(crowded):
            busy = [threads.submit(send, crowded, "bert") for _ in range(2)]
            wait_for_orders(crowded, 2)
            refused = send(crowded, "bert")
        assert [request.result().status_code for request in busy] == [200] * 2
    assert (refused.status_code, refused.headers["retry-after"]) == (429, "1")


def test_key_with_one_request_waits_for_one_of_another_s_only(crowded):
    """Dora has three requests in line when Emil's comes; his is the second to be done."""
    with ThreadPoolExecutor(4) as threads:
        with frozen(crowded):
            asked = [threads.submit(send, crowded, "dora") for _ in range(3)]
            wait_for_orders(crowded, 3)
            asked.append(threads.submit(send, crowded, "emil"))
            wait_for_orders(crowded, 4)
        assert [request.result().status_code for request in asked] == [200] * 4
    wait_for(lambda: len(answered_to(crowded, "dora", "emil")) == 4)
    assert answered_to(crowded, "dora", "emil") == ["dora", "emil", "dora", "dora"]


def answered_to(server, *names):
    """Keys of the answers in their order, those of some keys."""
    keys = re.findall(r'"key": "(\w+)"', server.log.read_text())
    return [key for key in keys if key in names]


def test_live_sessions_of_a_key_are_limited_and_say_when_to_come_again(crowded):
    url = f"{crowded.url.replace('http', 'ws')}/v1/live"
    wait_for(lambda: crowded.metric("live_sessions", bearer("anna")) == 0)
    with connect(url, additional_headers=bearer("carl"), proxy=None):
        with pytest.raises(InvalidStatus) as refused:
            connect(url, additional_headers=bearer("carl"), proxy=None)
        assert refused.value.response.status_code == 429
        assert refused.value.response.headers["retry-after"] == "1"
        with connect(url, additional_headers=bearer("anna"), proxy=None):
            pass


def test_sound_beyond_a_key_s_quota_is_refused(crowded):
    assert send(crowded, "finn", wav(6.0)).status_code == 200
    answer = send(crowded, "finn", wav(1.0))
    assert (answer.status_code, answer.json()["code"]) == (429, "quota_used")
    assert 1 <= int(answer.headers["retry-after"]) <= 3600


def test_log_names_request_key_and_status_as_json(crowded):
    given = {"X-Request-ID": "shot-7.take_2"}
    with crowded.client(headers=bearer("bert") | given) as client:
        answer = client.get("/v1/emotions")
        assert answer.headers["x-request-id"] == "shot-7.take_2"
        unfit = client.get("/v1/emotions", headers={"X-Request-ID": "a b" * 99})
        assert len(unfit.headers["x-request-id"]) == 16
    with connect(
        f"{crowded.url.replace('http', 'ws')}/v1/live",
        additional_headers=bearer("anna") | {"X-Request-ID": "talk"},
        proxy=None,
    ):
        pass
    wait_for(lambda: '"talk"' in crowded.log.read_text())
    lines = [json.loads(x) for x in crowded.log.read_text().splitlines() if x.startswith("{")]
    (line,) = [line for line in lines if line.get("request") == "shot-7.take_2"]
    assert (line["route"], line["status"], line["key"]) == ("/v1/emotions", 200, "bert")
    assert line["key_id"] == digest_of(KEYS["bert"])[:8]
    (line,) = [line for line in lines if line.get("request") == "talk"]
    assert (line["method"], line["route"], line["status"]) == ("WS", "/v1/live", 101)
