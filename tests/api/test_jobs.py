"""Jobs: results, progress, cancelling, idempotency, restarts."""

import json

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.api.conftest import bearer, wav
from tests.api.kill import frozen, run, wait
from tests.api.server import wait_for

LONG = wav(6.0)


def submit(client, recording=LONG, headers=None, **data):
    files = {"recording": ("speech.wav", recording)}
    return client.post("/v1/jobs", files=files, data=data, headers=headers or {})


def test_long_recording_becomes_a_job_with_the_same_result(client):
    answer = client.post("/v1/animations?format=csv", content=LONG)
    assert answer.status_code == 202 and answer.json()["status"] in ("queued", "running")
    job = wait(client, answer.headers["location"].rpartition("/")[2])
    assert job["status"] == "done" and job["progress"] == 1 and job["facts"]["frames"] == 180
    result = client.get(job["result"])
    assert result.headers["content-disposition"].endswith('"recording.csv"')
    assert len(result.content) == job["result_bytes"]
    assert len(result.text.splitlines()) == 181
    listed = client.get("/v1/jobs", params={"status": "done"}).json()["jobs"]
    assert job["id"] in {other["id"] for other in listed}
    assert client.delete(f"/v1/jobs/{job['id']}").status_code == 204
    assert client.get(f"/v1/jobs/{job['id']}").status_code == 404


def test_job_is_counted_with_its_wait_work_and_sound(client):
    def counts():
        families = text_string_to_metric_families(client.get("/metrics").text)
        samples = [sample for family in families for sample in family.samples]
        return {(s.name.removeprefix("deitalk_"), *s.labels.values()): s.value for s in samples}

    names = [
        ("job_wait_seconds_count",), ("job_seconds_count", "csv"), ("audio_seconds_total", "job")
    ]  # fmt: skip
    for status in ("queued", "running"):  # of other tests
        for job in client.get("/v1/jobs", params={"status": status}).json()["jobs"]:
            wait(client, job["id"])
    before = counts()
    wait(client, client.post("/v1/jobs?format=csv", content=LONG).json()["id"])
    wait_for(lambda: counts().get(names[1], 0) > before.get(names[1], 0))  # the last to be counted
    after = counts()
    grown = [after[name] - before.get(name, 0.0) for name in names]
    assert grown == pytest.approx([1, 1, 6.0])
    assert after["jobs", "done"] >= 1 and after["job_seconds_sum", "csv"] > 0


def test_events_end_with_the_job(client):
    job = submit(client, format="json").json()
    seen = []
    with client.stream("GET", f"/v1/jobs/{job['id']}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        for line in stream.iter_lines():
            if line.startswith("data: "):
                seen.append(json.loads(line.removeprefix("data: ")))
    assert seen[-1]["status"] == "done"
    assert np.all(np.diff([view["progress"] for view in seen]) >= 0)


def test_idempotency_key_makes_one_job(client):
    headers = {"Idempotency-Key": "line-7"}
    first, again = submit(client, headers=headers), submit(client, headers=headers)
    other = submit(client, recording=wav(5.0), headers=headers)
    assert first.json()["id"] == again.json()["id"]
    assert (other.status_code, other.json()["code"]) == (409, "idempotency_conflict")


def test_failed_job_names_its_error(client):
    job = wait(client, submit(client, recording=b"no audio" * 99).json()["id"])
    assert job["status"] == "failed" and job["error"]["code"] == "audio_unusable"
    assert client.get(f"/v1/jobs/{job['id']}/result").status_code == 409


def test_cancelled_job_ends_and_the_next_is_carried_out(server, client):
    wait(client, submit(client, wav(0.5)).json()["id"])  # a worker has been started
    with frozen(server):
        jobs = [submit(client, wav(0.5)).json() for _ in "ab"]
        wait_for(lambda: client.get(f"/v1/jobs/{jobs[0]['id']}").json()["status"] == "running")
        for job in jobs:
            assert client.delete(f"/v1/jobs/{job['id']}").status_code == 409
            assert client.post(f"/v1/jobs/{job['id']}/cancel").status_code == 200
        assert {wait(client, job["id"])["status"] for job in jobs} == {"cancelled"}
    assert wait(client, submit(client, wav(0.5)).json()["id"])["status"] == "done"


def test_jobs_belong_to_their_key(keyed_server):
    with keyed_server.client(headers=bearer("farm")) as farm:
        job = submit(farm).json()
        assert farm.get(f"/v1/jobs/{job['id']}").status_code == 200
        other = keyed_server.client(headers=bearer("viewer"))
        with other as viewer:
            assert viewer.get(f"/v1/jobs/{job['id']}").status_code == 403
        assert wait(farm, job["id"])["status"] == "done"


def test_jobs_survive_kills_of_worker_and_server(tmp_path):
    assert run(2, 0, tmp_path / "data") == {"server": 1, "worker": 1, "jobs": 6}


@pytest.mark.slow
def test_jobs_survive_fifty_kills(tmp_path):
    counts = run(50, 1, tmp_path / "data")
    assert counts["server"] == 25 and counts["jobs"] == 150
