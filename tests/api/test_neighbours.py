"""What one client may take from another: time of workers, places, connections; and who leaves."""

import json
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from api.guard.keys import digest_of
from tests.api.conftest import KEYS, bearer, wav

CLIP = wav(30.0)
"""More than half a second of work."""


@pytest.fixture(scope="module")
def crowded(keyed_server):
    return keyed_server


def send(server, name, recording=CLIP, timeout=60.0):
    return httpx.post(
        f"{server.url}/v1/animations?format=npz", content=recording, timeout=timeout,
        headers=bearer(name) | {"Content-Type": "audio/wav"}, trust_env=False,
    )  # fmt: skip


def gauge(server, name):
    text = httpx.get(f"{server.url}/metrics", headers=bearer("anna"), trust_env=False).text
    return float(next(line for line in text.splitlines() if line.startswith(name)).split()[1])


def wait_for(check, seconds=20.0):
    end = time.monotonic() + seconds
    while not check():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_first_session_gets_its_header_at_once(crowded):
    """The model was read when the server started: reading it takes seconds."""
    wait_for(lambda: "live voices are ready" in crowded.log.read_text(), 120)
    url = f"{crowded.url.replace('http', 'ws')}/v1/live"
    with connect(url, additional_headers=bearer("anna"), proxy=None) as live:
        began = time.perf_counter()
        live.send(json.dumps({"type": "start"}))
        assert json.loads(live.recv())["type"] == "header"
        assert time.perf_counter() - began < 0.5


def test_work_of_clients_that_left_is_dropped(crowded):
    """Ten abandoned requests, some at work and some waiting, keep nobody waiting."""
    began = time.perf_counter()
    assert send(crowded, "anna").status_code == 200
    alone = time.perf_counter() - began
    left = gauge(crowded, "deitalk_left_orders")
    with ThreadPoolExecutor(4) as threads:
        for _ in range(3):
            for gone in [threads.submit(send, crowded, "anna", timeout=0.2) for _ in range(4)]:
                with pytest.raises(httpx.TimeoutException):
                    gone.result()
    wait_for(lambda: gauge(crowded, "deitalk_busy_orders") == 0, 2.0)
    assert gauge(crowded, "deitalk_left_orders") >= left + 4
    began = time.perf_counter()
    assert send(crowded, "bert").status_code == 200
    assert time.perf_counter() - began < 2 * alone + 2
    assert httpx.get(f"{crowded.url}/readyz", trust_env=False).status_code == 200


def test_full_house_refuses_before_the_upload_is_read(crowded):
    with ThreadPoolExecutor(4) as threads:
        busy = [threads.submit(send, crowded, "anna") for _ in range(4)]
        wait_for(lambda: gauge(crowded, "deitalk_busy_orders") == 4)
        with socket.create_connection(crowded.address, timeout=5) as connection:
            head = f"POST /v1/animations HTTP/1.1\r\nHost: {crowded.url[7:]}\r\nAuthorization: "
            head += f"Bearer {KEYS['bert']}\r\nContent-Type: audio/wav\r\nContent-Length: 9000000"
            connection.sendall(head.encode() + b"\r\n\r\nRIFF")
            answer = connection.recv(65536).decode()
        assert answer.startswith("HTTP/1.1 503") and "retry-after: 1" in answer.lower()
        assert [request.result().status_code for request in busy] == [200] * 4


def test_key_may_have_so_many_requests_at_work(crowded):
    with ThreadPoolExecutor(3) as threads:
        answers = list(threads.map(lambda _: send(crowded, "bert"), range(3)))
        statuses = sorted(answer.status_code for answer in answers)
    assert statuses == [200, 200, 429]
    assert max(answers, key=lambda a: a.status_code).headers["retry-after"] == "1"


def test_key_with_one_request_waits_for_one_of_another_s_only(crowded):
    """Anna has three requests in line when Bert's comes; his is the second to be done."""
    ends = []

    def timed(name):
        assert send(crowded, name).status_code == 200
        ends.append(name)

    threads = [threading.Thread(target=timed, args=("anna",)) for _ in range(3)]
    for thread in threads:
        thread.start()
    wait_for(lambda: gauge(crowded, "deitalk_busy_orders") == 3)
    threads.append(threading.Thread(target=timed, args=("bert",)))
    threads[-1].start()
    for thread in threads:
        thread.join()
    assert ends == ["anna", "bert", "anna", "anna"]


def test_live_sessions_of_a_key_are_limited_and_say_when_to_come_again(crowded):
    url = f"{crowded.url.replace('http', 'ws')}/v1/live"
    with connect(url, additional_headers=bearer("carl"), proxy=None):
        with pytest.raises(InvalidStatus) as refused:
            connect(url, additional_headers=bearer("carl"), proxy=None)
        assert refused.value.response.status_code == 503
        assert refused.value.response.headers["retry-after"] == "10"
        with connect(url, additional_headers=bearer("anna"), proxy=None):
            pass


def test_sound_beyond_a_key_s_quota_is_refused(crowded):
    assert send(crowded, "carl", wav(6.0)).status_code == 200
    answer = send(crowded, "carl", wav(1.0))
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
