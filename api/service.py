"""State that the routes share: settings, worker processes, jobs, counts."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

from api.compute.live import MODEL, LivePool
from api.compute.order import Limits
from api.compute.pages import Pages
from api.compute.pool import Pool, Stage
from api.errors import Problem, database_away, problem_for
from api.guard.keys import Caller, Places
from api.guard.metrics import Metrics
from api.guard.middleware import Traffic
from api.jobs.queue import Queue
from api.jobs.runner import Runner
from api.jobs.store import Store
from api.jobs.versions import open_database
from api.settings import Settings

Result = TypeVar("Result")
DATABASE_THREADS = 8
DATABASE_SECONDS = 10.0
"""Time after which a database that does not answer is away."""


class Service:
    """Objects made at the start of the application and closed at its end.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self.settings, self.metrics = settings, Metrics()
        self.traffic = Traffic(settings.connections)
        self.live = Places(settings.live_sessions)
        self.is_draining = False
        self.limits: Limits = {
            "memory_bytes": settings.memory_mb * 2**20,
            "max_channels": settings.max_channels,
            "max_pixels": settings.max_pixels,
            "models": {name: str(folder) for name, folder in settings.known_models.items()},
            "preload": list(settings.preload),
            "device": settings.device,
            "backend": settings.backend,
            "threads": 1,
        }
        self._threads = ThreadPoolExecutor(DATABASE_THREADS, "database")
        self._starting: asyncio.Task[None] | None = None
        self._warming: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Open the database and the store; start the workers in the background."""
        settings = self.settings
        settings.data.mkdir(parents=True, exist_ok=True, mode=0o700)
        self.stage = Stage(settings.data / "stage")
        live: Limits = {**self.limits, "backend": settings.backend_of_live, "preload": [MODEL]}
        if live["backend"] == "onnx":
            live["device"] = "cpu"
        workers = settings.live_workers if live["device"] == "cpu" else 1
        self.voices, self.pages = (
            LivePool(live, self.stage, workers),
            Pages(self.limits, self.stage),
        )
        self.pool = Pool(self.limits, settings.workers, settings.work_seconds, settings.waiting)
        engine = await asyncio.to_thread(open_database, settings.database_url)
        self.queue = Queue(
            engine,
            settings.lease_seconds,
            settings.job_attempts,
            settings.queued_jobs,
            {key.name: key.share for key in settings.keys},
        )
        self.store = await asyncio.to_thread(Store, settings.storage_url)
        self.runner = Runner(
            self.queue,
            self.store,
            self.stage,
            self.limits,
            settings,
            self.metrics,
            self.traffic.traces,
        )
        self._starting = asyncio.create_task(self._start_workers())

    async def _start_workers(self) -> None:
        settings, live = self.settings, self.settings.backend_of_live
        may_use = live == "auto" and settings.device == "cpu" and bool(settings.models)
        if may_use or "onnx" in (settings.backend, live):
            from api.compute.models import export_all

            only_live = settings.backend != "onnx"
            await asyncio.to_thread(export_all, self.limits, only_live=only_live)
        await self.pool.start()
        self.runner.start()
        if settings.live_sessions:
            self._warming = asyncio.create_task(self.voices.warm())

    def drain(self) -> None:
        """Be not ready any more, and begin no other job."""
        self.is_draining = True
        self.runner.drain()

    async def check_room(self, caller: Caller, *, is_job: bool) -> None:
        """Refuse a request, before its body is read, that would be refused after.

        Raises
        ------
        Problem
            429, 503.
        """
        await self.check_quota(caller)
        if is_job:
            await self.ask(self.queue.check_room, caller)
        else:
            self.pool.places.check(caller.holder)

    async def ask(self, function: Callable[..., Result], *given: Any) -> Result:
        """Return what a function of the database returns, in a thread of its own kind.

        Raises
        ------
        Problem
            503 if it does not answer in `DATABASE_SECONDS`, and what the function raises.
        """
        asked = asyncio.get_running_loop().run_in_executor(self._threads, partial(function, *given))
        try:
            return await asyncio.wait_for(asked, DATABASE_SECONDS)
        except TimeoutError:
            raise database_away() from None
        except Exception as error:
            raise problem_for(error) from None

    async def check_quota(self, caller: Caller) -> None:
        """Refuse a caller whose sound of this hour is used: Problem 429."""
        if caller.audio_seconds_per_hour:
            await self.ask(self.queue.check_quota, caller)

    async def count(self, caller: Caller, seconds: float) -> None:
        """Count sound to a key's quota; a database that is away loses the count, not the answer."""
        if caller.audio_seconds_per_hour:
            with suppress(Problem):
                await asyncio.shield(self.ask(self.queue.use, caller.name, seconds))

    async def count_live(self, caller: Caller, seconds: float) -> None:
        """Count the sound of a live session, to the key's quota too."""
        self.metrics.audio.labels("live").inc(seconds)
        await self.count(caller, seconds)

    async def stop(self) -> None:
        """Stop the workers; jobs that run are put back."""
        if self._starting is not None:
            self._starting.cancel()
        if self._warming is not None:
            self._warming.cancel()
        self.pool.stop()
        self.voices.stop()
        self.pages.stop()
        if self._starting is not None and self._starting.done():
            await asyncio.to_thread(self.runner.stop)
        self._threads.shutdown(wait=False, cancel_futures=True)
        self.queue.engine.dispose()
        self.stage.close()
        await asyncio.to_thread(self.traffic.traces.stop)
