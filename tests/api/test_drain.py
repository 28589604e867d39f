"""The end of a server: not ready, no new work, streams told, answers given; nothing of its paths."""

import json
import signal
import threading

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.api.conftest import wav
from tests.api.kill import frozen
from tests.api.server import start, stop, wait_for


@pytest.fixture
def server(tmp_path):
    running = []

    def make(**settings):
        running.append(start(tmp_path / "data", waiting=19, job_workers=0, **settings))
        return running[0]

    yield make
    for server in running:
        stop(server)


def is_ready(server):
    with server.client() as client:
        return client.get("/readyz").status_code == 200


class Requests:
    """Requests in threads of their own, and their answers."""

    def __init__(self, server, count):
        self.answers = []
        self.threads = [threading.Thread(target=self.send, args=(server,)) for _ in range(count)]
        for thread in self.threads:
            thread.start()
        wait_for(lambda: server.metric("busy_orders") == count)

    def send(self, server):
        with server.client() as client:
            self.answers.append(client.post("/v1/animations?format=npz", content=wav(1.0)))

    def wait(self):
        for thread in self.threads:
            thread.join()
        return self.answers


def test_requests_at_work_are_answered_new_ones_refused_and_streams_told(server):
    server = server()
    socket = connect(f"{server.url.replace('http', 'ws')}/v1/live", proxy=None)
    with server.client() as client, socket as live:
        job = client.post("/v1/jobs", content=wav(1.0), headers={"Content-Type": "audio/wav"})
        job_id, events = job.json()["id"], []

        def follow():
            with client.stream("GET", f"/v1/jobs/{job_id}/events") as stream:
                events.extend(stream.iter_lines())

        following = threading.Thread(target=follow)
        following.start()
        live.send(json.dumps({"type": "start"}))
        live.recv()
        with frozen(server), server.client() as late:
            requests = Requests(server, 3)
            server.process.send_signal(signal.SIGTERM)
            wait_for(lambda: not is_ready(server))
            assert late.get("/healthz").status_code == 200
            assert late.get("/readyz").json()["code"] == "draining"
            refused = late.get("/v1/models")
        assert refused.status_code == 503 and refused.headers["retry-after"] == "1"
        assert refused.headers["content-type"] == "application/problem+json"
        assert [answer.status_code for answer in requests.wait()] == [200] * 3
        following.join()
        assert "event: draining" in events
        assert json.loads(live.recv())["code"] == "draining"
        with pytest.raises(ConnectionClosed) as closed:
            live.recv()
        assert closed.value.rcvd.code == 1012
    server.process.wait(60)
    assert "Traceback" not in server.log.read_text()


def test_notice_serves_on_while_balancers_look_elsewhere_and_late_requests_get_a_problem(server):
    """Some seconds of notice, a tenth of grace, and more work than that."""
    server = server(drain_notice_seconds=5, drain_seconds=0.1, live_sessions=0)
    with frozen(server):
        requests = Requests(server, 8)
        server.process.send_signal(signal.SIGTERM)
        wait_for(lambda: not is_ready(server))
        assert (
            httpx.get(f"{server.url}/v1/emotions", timeout=300, trust_env=False).status_code == 200
        )
        answers = requests.wait()
    assert len(answers) == 8
    for answer in answers:
        assert answer.status_code == 503
        assert answer.json()["code"] == "draining" and answer.headers["retry-after"] == "1"
    server.process.wait(60)
    log = server.log.read_text()
    assert "Traceback" not in log and "/site-packages/" not in log and ".py" not in log
