"""The studio's pages: drawn once each, one at a time, outside the server's process."""

import asyncio
import threading
import time
from pathlib import Path

import httpx
import pytest

from api.app import problem_answer
from api.compute.pages import Pages
from api.compute.pool import Stage
from api.errors import Problem
from api.guard.metrics import Metrics
from api.guard.middleware import Guard, Traffic
from api.settings import Settings
from deitalk.workers import WorkerLost
from rig.errors import RigError
from rig.face.identity import IDENTITIES, ROLES
from tests.api.test_worker import limits


class Drawer:
    """Stands for the worker: draws the name of a head, and counts."""

    def __init__(self, failures: int = 0) -> None:
        self.drawn, self.failures, self.at_work = [], failures, 0
        self.may_end = threading.Event()
        self.may_end.set()

    def run(self, order, seconds):
        self.at_work += 1
        assert self.at_work == 1, "two pages are drawn at a time"
        time.sleep(0.01)
        self.may_end.wait()
        self.at_work -= 1
        head = order["options"]["head"]
        self.drawn.append(head)
        if len(self.drawn) <= self.failures:
            raise WorkerLost
        page = Path(order["folder"]) / "out/page"
        page.parent.mkdir(exist_ok=True)
        page.write_text(head)
        return {"file": "out/page"}

    def stop(self) -> None:
        pass


@pytest.fixture
def pages(tmp_path):
    stage = Stage(tmp_path)
    made = Pages(limits(), stage)
    made.worker = Drawer()
    yield made
    stage.close()


def test_each_head_is_drawn_once_however_often_and_by_whatever_name(pages):
    names = [identity.name for identity in IDENTITIES]
    numbers = [str(k) for k in range(len(IDENTITIES))]
    heads = [*names, *numbers, *map(str.upper, names), *ROLES] * 4

    async def ask():
        return await asyncio.gather(*map(pages.page, heads))

    answers = asyncio.run(ask())
    assert sorted(pages.worker.drawn) == sorted(names)
    assert answers[: len(names)] == answers[len(names) : 2 * len(names)]
    assert answers[: len(names)] == [name.encode() for name in names]


def test_page_that_failed_is_drawn_again_by_the_next_request(pages):
    pages.worker.failures = 1

    async def ask():
        with pytest.raises(Problem) as failed:
            await pages.page("0")
        return failed.value.status, await pages.page("0")

    assert asyncio.run(ask()) == (503, b"Ada")


def test_unknown_head_is_not_drawn(pages):
    with pytest.raises(RigError, match="nobody"):
        asyncio.run(pages.page("nobody"))
    assert pages.worker.drawn == []


def test_pages_without_a_key_are_counted_by_address_and_probes_are_not():
    async def app(scope, receive, send):
        await problem_answer(Problem(400, "seen"))(scope, receive, send)

    guard = Guard(app, Settings(requests_per_minute=60), Metrics(), Traffic(9))

    async def ask(path: str) -> list[int]:
        def client(address):
            transport = httpx.ASGITransport(guard, client=(address, 1))
            return httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1")

        async with client("10.0.0.1") as one, client("10.0.0.2") as other:
            statuses = [(await one.get(path)).status_code for _ in range(20)]
            return [*statuses, (await other.get(path)).status_code]

    for path in ("/", "/docs", "/openapi.json"):
        *statuses, other = asyncio.run(ask(path))
        assert statuses[0] == 400 or path != "/"
        assert statuses[-1] == 429 and other == 400, path
    assert set(asyncio.run(ask("/healthz"))) == {400}


def test_drawings_that_wait_end_with_the_server(pages):
    pages.worker.may_end.clear()

    async def ask():
        asked = [asyncio.create_task(pages.page(str(head))) for head in range(len(IDENTITIES))]
        try:
            async with asyncio.timeout(60):
                while not pages.worker.at_work or len(pages._drawn) < len(asked):
                    await asyncio.sleep(0.001)
            pages.stop()
        finally:  # the thread that draws waits for it
            pages.worker.may_end.set()
        return await asyncio.gather(*asked, return_exceptions=True)

    ended = asyncio.run(ask())
    assert all(isinstance(error, asyncio.CancelledError) for error in ended)
    assert len(pages.worker.drawn) == 1
