"""The voices of all live sessions: what fails ends them with a problem, and new ones go on."""

import asyncio
import json
import logging
import shutil
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from api.compute import live
from api.compute.pool import Stage
from api.compute.voices import Voices as VoicesInWorker
from api.errors import InternalError, Problem
from api.routes.health import ready
from deitalk.acting import Acting
from deitalk.workers import WorkerLost
from tests.api.test_worker import limits

STILL = Acting.of(life="off", seed=1)


class Stand:
    """Stands for the worker process: opens voices, or fails as it is told."""

    def __init__(self) -> None:
        self.failure: Exception | None = None
        self.starts, self.hangs, self.pid, self.is_alive = 0, None, 1, True

    def start(self) -> None:
        self.starts += 1

    def stop(self) -> None:
        pass

    def run(self, order, seconds):
        if self.hangs is not None:
            self.hangs.wait()
        if self.failure is not None:
            raise self.failure
        opened = [[a["voice"], 0.2] for a in order["options"]["actions"] if a["do"] == "open"]
        out = Path(order["folder"], "out")
        out.mkdir(exist_ok=True)
        np.zeros(0, "<f4").tofile(out / "frames")
        return {
            "file": "out/frames",
            "facts": {"opened": opened, "failed": [], "frames": [], "interrupted": []},
        }


@pytest.fixture
def voices(tmp_path, monkeypatch):
    monkeypatch.setattr(live, "RESTART_SECONDS", 0.01)
    stage = Stage(tmp_path)
    made = live.Voices(limits(), stage)
    made.worker = Stand()
    yield made
    stage.close()


async def until(condition) -> None:
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.005)


async def fail(voices, failure, wait=lambda: None):
    """Fail the next order of an open voice; return the problem it ends with."""
    voice, _ = await voices.open("live", STILL)
    voices.worker.failure = failure
    wait()
    voice.feed(np.ones(10, np.float32))
    with pytest.raises(Problem) as ended:
        await asyncio.wait_for(voice.next_frames(), 60)
    return ended.value


@pytest.mark.parametrize(
    ("failure", "status"),
    [
        (OSError("disk full"), 500),
        (InternalError("KeyError in api"), 500),
        (ValueError("a fault of ours"), 500),
        (WorkerLost(), 503),
    ],
)
def test_any_failure_ends_the_voices_is_logged_and_told_and_new_voices_go_on(
    voices, caplog, failure, status
):
    service = SimpleNamespace(pool=SimpleNamespace(is_ready=True), voices=voices, is_draining=False)

    async def run():
        caplog.set_level(logging.INFO, "deitalk.service")
        assert (await ready(service)).status == "ready"
        problem = await fail(voices, failure)
        assert problem.status == status and "disk" not in problem.message
        with pytest.raises(Problem) as starting:
            await ready(service)
        assert starting.value.status == 503
        voices.worker.failure = None
        await until(lambda: voices.is_ready)
        assert (await ready(service)).status == "ready"
        assert (await voices.open("live", STILL))[1] == 0.2
        voices.stop()

    asyncio.run(run())
    assert voices.worker.starts == 2
    assert [r for r in caplog.records if "1 live voices ended" in r.getMessage()]


def test_folder_that_is_removed_does_not_end_live(voices):
    def remove():
        shutil.rmtree(voices.stage.own)

    async def run():
        assert (await fail(voices, None, remove)).status == 500
        assert (await voices.open("live", STILL))[1] == 0.2
        voices.stop()

    asyncio.run(run())


def test_opening_ends_when_the_worker_does_not_answer(voices, monkeypatch):
    monkeypatch.setattr(live, "OPEN_SECONDS", 0.05)

    async def run():
        voices.worker.hangs = threading.Event()
        try:
            with pytest.raises(Problem) as refused:
                await asyncio.wait_for(voices.open("live", STILL), 60)
            assert refused.value.status == 503 and voices.known == {}
        finally:
            voices.worker.hangs.set()
            voices.stop()

    asyncio.run(run())


def test_task_that_was_ended_is_begun_again(voices):
    async def run():
        await voices.open("live", STILL)
        voices.task.cancel()
        await until(voices.task.done)
        assert (await asyncio.wait_for(voices.open("live", STILL), 60))[1] == 0.2
        voices.stop()

    asyncio.run(run())


@pytest.mark.parametrize("when", ["while nobody speaks", "before an order"])
def test_worker_that_ends_between_two_orders_ends_the_voices(voices, when):
    """Another process knew none of them: their sessions waited for frames for ever."""

    async def run():
        voice, _ = await voices.open("live", STILL)
        if when == "before an order":
            voices.worker.pid = None  # seen by `_order`, after which there is a new one
            started = voices.worker.run

            def run_by_another(order, seconds):
                voices.worker.pid = 2
                return started(order, seconds)

            voices.worker.run = run_by_another
            voice.feed(np.ones(10, np.float32))
        else:
            voices.worker.is_alive = False
        with pytest.raises(Problem) as ended:
            await asyncio.wait_for(voice.next_frames(), 60)
        assert ended.value.status == 503 and int(ended.value.headers["Retry-After"]) > 0
        voices.worker.is_alive = True
        assert (await asyncio.wait_for(voices.open("live", STILL), 60))[1] == 0.2
        voices.stop()

    asyncio.run(run())


def test_a_voice_begins_in_the_worker_with_the_fewest_that_is_ready(voices, tmp_path):
    pool = live.LivePool(limits(), voices.stage, 3)
    for one in pool.workers:
        one.worker = Stand()

    async def begun():
        voice, _ = await pool.open("live", STILL)
        return pool.workers.index(voice.voices), voice

    async def run():
        opened = [await begun() for _ in range(6)]
        assert [place for place, _ in opened] == [0, 1, 2, 0, 1, 2]
        assert len({voice.number for _, voice in opened}) == 6
        opened[1][1].close()
        assert (await begun())[0] == 1
        opened[2][1].close()
        pool.workers[2].is_ready = False
        assert not pool.is_ready and (await begun())[0] == 0
        pool.stop()

    asyncio.run(run())


def test_sound_of_an_unknown_voice_is_not_given_to_the_next():
    taken = {}
    animator = SimpleNamespace(
        take=lambda samples, stream: taken.update({stream: samples.tolist()}),
        read=lambda: np.zeros((2, 0, 3), np.float32),
        heads=np.zeros((2, 0, 6), np.float32),
    )
    voices = VoicesInWorker()
    voices.animators["live"], voices.places[2] = animator, ("live", 1)
    actions = [
        {"voice": 1, "do": "feed", "count": 3},  # it has ended
        {"voice": 1, "do": "set", "options": {}},
        {"voice": 2, "do": "feed", "count": 2},
    ]
    voices.perform(json.loads(json.dumps(actions)), np.arange(5, dtype=np.float32), limits())
    assert taken == {1: [3.0, 4.0]}
