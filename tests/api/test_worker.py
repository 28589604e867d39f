"""The worker process: limits of time and memory, and a new process after each."""

import asyncio
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from api.compute import pool
from api.compute.order import TooLarge
from api.compute.worker import OrderWorker, OutOfTime, Stopped
from api.guard.keys import Caller
from api.settings import SCOPES
from deitalk.workers import WorkerLost
from tests.api.conftest import wav
from tests.api.kill import kill

CALLER = Caller("farm", SCOPES, 10, 600)
OPTIONS = {"format": "json", "suffix": ".json"}


def limits(**given):
    return {
        "memory_bytes": 2**30,
        "max_channels": 2,
        "max_pixels": 1e9,
        "models": {"default": "default"},
        "preload": ["default"],
        "device": "cpu",
        "backend": "torch",
        "threads": 1,
    } | given


@pytest.fixture(scope="module")
def worker():
    made = OrderWorker(limits())
    yield made
    made.stop()


def order(folder, recording, **options):
    (folder / "recording").write_bytes(recording)
    (folder / "acting.json").write_text('{"emotion": "happy"}')
    return {
        "kind": "animation",
        "folder": str(folder),
        "options": OPTIONS | options,
        "at_once_seconds": 60.0,
        "most_seconds": 100.0,
    }


def test_answer_names_a_file_of_the_folder(worker, tmp_path):
    shares = []
    answer = worker.run(order(tmp_path, wav(1.0), name="line 7"), 600, shares.append)
    assert answer["file"] == "out/line 7.json" and (tmp_path / answer["file"]).stat().st_size
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert answer["facts"]["frames"] == 30


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="faults are those of Linux")
def test_memory_of_an_order_serves_the_next(worker, tmp_path):
    """Pages that are given back and taken again were 4,000 faults an order, a seventh of its time."""

    def faults():
        fields = Path(f"/proc/{worker.pid}/stat").read_text().rpartition(")")[2].split()
        return int(fields[7])

    asked = order(tmp_path, wav(6.0))
    counts = []
    for _ in range(4):
        worker.run(asked, 600)
        counts.append(faults())
    assert min(np.diff(counts)) < 400  # a busy machine takes some pages from a process


class Starting:
    """Stands for a worker whose process takes a while to start."""

    def __init__(self, limits):
        self.is_ready, self.starting = False, 0

    @property
    def is_alive(self):
        return self.is_ready

    def start(self):
        self.starting += 1
        assert self.starting == 1, "it is started by two threads"
        time.sleep(0 if self.is_ready else 0.1)
        self.is_ready = True
        self.starting -= 1

    def run(self, order, seconds, stopped):
        self.start()
        return {"facts": order}


def test_orders_that_come_while_workers_start_wait_for_one(monkeypatch):
    monkeypatch.setattr(pool, "OrderWorker", Starting)

    async def answers():
        made = pool.Pool(limits(), 3, 60, 9)
        asked = [made.run({"number": k}, CALLER) for k in range(6)]
        *found, _ = await asyncio.gather(*asked, made.start())
        return [answer["facts"]["number"] for answer in found]

    assert asyncio.run(answers()) == [*range(6)]


class Ending(Starting):
    """Stands for a worker whose process takes a while to end."""

    def start(self):
        self.is_ready = True

    def run(self, order, seconds, stopped):
        while not stopped():
            time.sleep(0.01)
        time.sleep(0.2)
        order["ended"] = True
        raise Stopped


def test_order_of_a_client_who_goes_is_over_once_its_worker_has_ended(monkeypatch):
    """Its folder is removed then; a worker that still wrote left files there."""
    monkeypatch.setattr(pool, "OrderWorker", Ending)

    async def ended():
        made, order = pool.Pool(limits(), 1, 60, 9), {}
        await made.start()
        asked = asyncio.create_task(made.run(order, CALLER))
        while not made.turns.work:
            await asyncio.sleep(0.01)
        asked.cancel()
        await asyncio.wait([asked])
        assert asked.cancelled() and made.places.taken == 0
        return order

    assert asyncio.run(ended()) == {"ended": True}


def test_worker_that_comes_as_a_client_goes_is_the_next_ones():
    async def taken():
        turns = pool.Turns()
        gone, left = (asyncio.create_task(turns.take(CALLER)) for _ in "ab")
        await asyncio.sleep(0)
        gone.cancel()
        turns.give("worker")  # before `gone` has seen that it is cancelled
        await asyncio.wait([gone, left])
        assert gone.cancelled() and not turns.waiting
        return left.result()

    assert asyncio.run(taken()) == "worker"


def test_recording_that_is_not_for_now_is_answered_by_its_length(worker, tmp_path):
    asked = order(tmp_path, wav(2.0)) | {"at_once_seconds": 1.0}
    assert worker.run(asked, 600) == {"long": 2.0}
    beyond = worker.run(asked | {"most_seconds": 1.5}, 600)
    assert beyond["error"][0] == TooLarge.__name__


@pytest.mark.parametrize(
    ("seconds", "stopped", "error"),
    [
        (0.05, lambda worker: False, OutOfTime),
        (60, lambda worker: True, Stopped),
        (60, lambda worker: kill(worker.pid), WorkerLost),
    ],
)
def test_order_that_ends_early_ends_its_process_and_the_next_has_another(
    worker, tmp_path, seconds, stopped, error
):
    worker.start()
    before = worker.pid
    with pytest.raises(error):
        worker.run(order(tmp_path, wav(20.0)), seconds, stopped=lambda: stopped(worker))
    assert worker.pid is None
    assert worker.run(order(tmp_path, wav(0.5)), 600)["facts"]["frames"] == 15
    assert worker.pid != before


def test_order_beyond_the_memory_is_refused(tmp_path):
    small = OrderWorker(limits(memory_bytes=2**26))
    try:
        answer = small.run(order(tmp_path, wav(60.0, 192_000, 2)), 60)
        assert answer["error"] == [TooLarge.__name__] and "memory" in answer["message"]
    except (WorkerLost, OutOfTime):
        pass  # a library ended the process, or waits for memory until it is stopped
    finally:
        small.stop()


def test_error_of_ours_has_no_text_of_the_request(worker, tmp_path):
    asked = order(tmp_path, wav(0.5)) | {"kind": "unknown /etc/passwd"}
    answer = worker.run(asked, 600)
    assert answer["error"] == ["Internal"]
    assert "passwd" not in answer["message"]
    assert answer["message"].startswith("KeyError in api.compute.process._answer:")
