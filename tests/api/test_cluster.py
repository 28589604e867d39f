"""The service on a Ray cluster of two machines, both of them this one."""

import os
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from api.settings import Settings
from deitalk.errors import ConfigError, DeitalkError, MissingError
from tests.api.conftest import wav
from tests.api.server import ROOT, Server, free_port, wait_until
from tests.api.soak import AUDIO, Load

SCALE_SECONDS = 120


def test_missing_ray_is_one_line(monkeypatch, tmp_path):
    from api import cluster

    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingError, match=r"pip install 'deitalk\[ray\]'"):
        cluster.run(Settings(data=tmp_path))


def test_cluster_with_ray_serve_on_it_is_refused():
    from api.cluster import _check_free

    _check_free(SimpleNamespace(applications={}, proxies={}))
    with pytest.raises(DeitalkError, match=r"\(shop\); end it by `serve shutdown`"):
        _check_free(SimpleNamespace(applications={"shop": None}, proxies={"machine": "HEALTHY"}))


def test_machines_of_a_cluster_need_a_table_and_a_store_in_common(tmp_path):
    from api.cluster import _check_shared

    alone = Settings(data=tmp_path)
    _check_shared(alone, 1)
    with pytest.raises(ConfigError, match="set `database` and `storage`"):
        _check_shared(alone, 2)
    _check_shared(Settings(database="postgresql+psycopg://farm/jobs", storage="s3://jobs"), 2)


@pytest.fixture
def cluster(monkeypatch):
    """Two machines of one GPU each; Ray counts GPUs, and none is needed to take a share of one."""
    ray = pytest.importorskip("ray", reason="needs Ray (extra ray)")
    pytest.importorskip("ray.serve", reason="needs Ray Serve (extra ray)")
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "num_gpus": 1})
    made.other = made.add_node(num_cpus=2, num_gpus=1)
    ray.init(address=made.address, log_to_driver=False)
    yield made
    ray.shutdown()
    made.shutdown()


@pytest.fixture
def served(cluster, tmp_path):
    given = {
        "data": tmp_path, "port": free_port(), "ray_address": cluster.address, "workers": 1,
        "database": f"sqlite:///{tmp_path / 'jobs.sqlite'}", "storage": tmp_path / "files",
        "replica_cpus": 0.5, "replica_gpus": 0.5, "most_replicas": 3, "scale_up_seconds": 1,
        "lease_seconds": 2,
    }  # fmt: skip
    environment = dict(os.environ) | {
        f"DEITALK_{name.upper()}": str(v) for name, v in given.items()
    }
    log = tmp_path / "server.log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "deitalk", "serve", "--ray"], env=environment, stderr=out
        )
    server = Server(f"http://127.0.0.1:{given['port']}", process, log)
    try:
        wait_until(server, "/readyz")
        yield server
    finally:
        process.terminate()
        assert process.wait(60) == 0, log.read_text()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Ray, about its own parts
def test_replicas_come_under_load_share_gpus_and_survive_a_machine(cluster, served, tmp_path):
    import ray

    load = Load(served, tmp_path / "jobs.sqlite")
    load.ask("json", 1)
    load.live("binary")
    load.job(1)
    assert ray.available_resources()["GPU"] == 1.5
    ending = threading.Event()

    def work():
        with served.client() as client:
            while not ending.is_set():
                client.post("/v1/animations", content=wav(2), headers=AUDIO)

    threads = [threading.Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    end = time.monotonic() + SCALE_SECONDS
    # Three replicas of half a GPU: one machine has room for two of them, so both machines serve.
    while ray.available_resources()["GPU"] > 0.5:
        assert time.monotonic() < end, ray.available_resources()
        time.sleep(0.5)
    ending.set()
    for thread in threads:
        thread.join()
    jobs = [load.send(2, f"before-{number}") for number in range(6)]
    cluster.remove_node(cluster.other, allow_graceful=False)
    for job_id in jobs:
        while (job := answer(load, f"/v1/jobs/{job_id}", end + 60))["status"] != "done":
            assert job["status"] in ("queued", "running"), job
            time.sleep(0.2)
        assert answer(load, job["result"], end + 60)["n_frames"] == 60
    assert [load.ends(job_id) for job_id in jobs] == [1] * 6
    load.client.close()


def answer(load, path, end):
    """Send a request again while Ray still passes some to the machine that has ended."""
    while (answer := load.client.get(path)).status_code >= 500:
        assert time.monotonic() < end, answer.text
        time.sleep(0.2)
    return answer.json()
