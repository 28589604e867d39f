"""Worker processes that end: while they wait, start or work, once or twice; who is blamed for it."""

import asyncio
import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from api.compute import pool
from api.compute.order import TooLarge
from api.errors import Problem
from deitalk.workers import WorkerLost
from tests.api.conftest import wav
from tests.api.kill import kill
from tests.api.server import descendants, serving, wait_for
from tests.api.test_jobs import submit, wait
from tests.api.test_worker import CALLER, limits


class Stand:
    """Stands for a worker whose process ends in so many orders, and in so many starts."""

    ends_in_orders = ends_in_starts = 0

    def __init__(self, limits):
        self.is_ready = self.is_alive = False
        self.starts = 0

    def start(self):
        self.starts += 1
        if Stand.ends_in_starts:
            Stand.ends_in_starts -= 1
            raise WorkerLost
        self.is_ready = self.is_alive = True

    def run(self, order, seconds, stopped):
        if not self.is_alive:
            self.start()
        if Stand.ends_in_orders:
            Stand.ends_in_orders -= 1
            self.is_ready = self.is_alive = False
            raise WorkerLost
        return order.get("answer", {"facts": order})

    def stop(self):
        self.is_ready = self.is_alive = False


@pytest.fixture
def stands(monkeypatch):
    monkeypatch.setattr(pool, "OrderWorker", Stand)
    monkeypatch.setattr(pool, "CHECK_SECONDS", 0.01)
    monkeypatch.setattr(Stand, "ends_in_orders", 0)
    monkeypatch.setattr(Stand, "ends_in_starts", 0)


def answered(workers, order, orders=0, starts=0):
    """The answer of a pool whose processes end in some orders and starts."""

    async def ask():
        made = pool.Pool(limits(), workers, 60, 9)
        await made.start()
        Stand.ends_in_orders, Stand.ends_in_starts = orders, starts
        try:
            return await made.run(order, CALLER)
        finally:
            while not all(worker.is_alive for worker in made._all):
                await asyncio.sleep(0.01)  # without another order
            assert len(made.turns.idle) == workers and not made.places.taken
            made.stop()

    return asyncio.run(asyncio.wait_for(ask(), 60))


@pytest.mark.parametrize(
    ("workers", "orders", "starts"), [(1, 0, 0), (1, 1, 0), (2, 1, 0), (2, 1, 1), (4, 1, 3)]
)
def test_order_whose_process_ends_is_begun_again(stands, workers, orders, starts):
    assert answered(workers, {"number": 7}, orders, starts) == {"facts": {"number": 7}}


@pytest.mark.parametrize("workers", [1, 3])
def test_order_in_which_two_processes_end_is_to_be_sent_again_and_blames_nobody(stands, workers):
    with pytest.raises(Problem) as refused:
        answered(workers, {}, orders=2)
    assert (refused.value.status, refused.value.code) == (503, "worker_lost")
    assert int(refused.value.headers["Retry-After"]) > 0


def test_limit_of_memory_is_413_at_once(stands):
    error = {"error": [TooLarge.__name__], "message": "the request needs too much memory"}
    with pytest.raises(Problem) as refused:
        answered(1, {"answer": error})
    assert refused.value.status == 413


def test_processes_that_end_while_they_wait_are_replaced_without_an_order(stands):
    async def run():
        made = pool.Pool(limits(), 3, 60, 9)
        await made.start()
        for worker in made._all[:2]:
            worker.stop()
        Stand.ends_in_starts = 2
        while not all(worker.is_alive for worker in made._all) or len(made.turns.idle) < 3:
            await asyncio.sleep(0.01)
        made.stop()
        return sorted(worker.starts for worker in made._all)

    assert sum(asyncio.run(asyncio.wait_for(run(), 60))) == 7


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving(
        tmp_path_factory.mktemp("lost"), workers=2, job_workers=1, live_sessions=0,
        lease_seconds=1.0, requests_per_minute=10**6,
    ) as running:  # fmt: skip
        wait_for(lambda: len(workers_of(running)) == 2)
        yield running


def fork_server_of(server):
    return next(pid for pid in children(server.process.pid) if children(pid))


def children(pid):
    below = descendants(pid)
    return [child for child in below if not any(child in descendants(other) for other in below)]


def workers_of(server):
    """Processes that are forked from the fork server."""
    found = [pid for pid in children(server.process.pid) if children(pid)]
    return children(found[0]) if found else []


def is_restored(server, before):
    now = workers_of(server)
    return len(set(now) - set(before)) >= 2 and server_is_ready(server)


def server_is_ready(server):
    with server.client() as client:
        return client.get("/readyz").status_code == 200


def animate(server):
    with server.client() as client:
        return client.post("/v1/animations?format=csv", content=wav(0.3))


@contextmanager
def stopped(pids):
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            try:
                os.kill(pid, signal.SIGCONT)
            except ProcessLookupError:
                continue


@pytest.mark.parametrize("kind", ["workers", "both"])
def test_processes_that_are_killed_while_they_wait_are_there_again_without_load(server, kind):
    before = workers_of(server)
    if kind != "workers":
        kill(fork_server_of(server))
    if kind != "fork server":
        for pid in before:
            kill(pid)
    wait_for(lambda: is_restored(server, before))
    assert animate(server).status_code == 200


@pytest.mark.parametrize("kind", ["worker", "fork server and worker"])
def test_request_whose_process_is_killed_is_answered(server, kind):
    """One process is killed a round, so that the second one can answer, until it had the request.

    Which of the two has it cannot be seen from outside.
    """
    for _ in range(20):
        wait_for(lambda: server_is_ready(server) and len(workers_of(server)) == 2)
        lost, workers = server.metric("lost_workers"), workers_of(server)
        with ThreadPoolExecutor(1) as threads:
            with stopped(workers):
                asked = threads.submit(animate, server)
                wait_for(lambda: server.metric("busy_orders") == 1)
                time.sleep(0.2)
                kill(max(workers))
                if kind != "worker":
                    kill(fork_server_of(server))
            assert asked.result().status_code == 200, asked.result().text
        if server.metric("lost_workers") > lost:
            return
    pytest.fail("no process was killed that had the request")


def test_request_whose_processes_are_all_killed_is_to_be_sent_again(server):
    """By somebody who kills every process that starts; afterwards the server is as before."""
    wait_for(lambda: len(workers_of(server)) >= 2)
    over = threading.Event()

    def kill_all():
        while not over.wait(0.01):
            for pid in workers_of(server):
                kill(pid)

    killing = threading.Thread(target=kill_all)
    killing.start()
    try:
        answers = [animate(server) for _ in range(2)]
    finally:
        over.set()
        killing.join()
    for answer in answers:
        assert answer.status_code == 503, answer.text
        assert answer.json()["code"] == "worker_lost" and int(answer.headers["retry-after"]) > 0
    wait_for(lambda: server_is_ready(server) and len(workers_of(server)) >= 2)
    assert animate(server).status_code == 200


def test_job_whose_process_is_killed_is_done_by_another_at_once(server):
    with server.client() as client:
        wait(client, submit(client, wav(0.3)).json()["id"])  # a worker has been started
        workers = workers_of(server)
        with stopped(workers):
            job = submit(client, wav(1.0)).json()
            wait_for(lambda: client.get(f"/v1/jobs/{job['id']}").json()["status"] == "running")
            for pid in workers:
                kill(pid)
            assert wait(client, job["id"])["status"] == "done"
