"""What the routes share: settings, worker processes, jobs, counts."""

import asyncio

from api.compute.exports import export_all
from api.compute.live import Voices
from api.compute.order import Limits
from api.compute.pages import Pages
from api.compute.pool import Pool, Stage
from api.jobs.queue import Queue
from api.jobs.runner import Runner
from api.jobs.store import Store
from api.jobs.table import open_database
from api.metrics import Metrics
from api.settings import Settings


class Service:
    """Objects made at the start of the application and closed at its end.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self.settings, self.metrics = settings, Metrics()
        self.live_sessions = 0
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
        self._starting: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Open the database and the store; start the workers in the background."""
        settings = self.settings
        settings.data.mkdir(parents=True, exist_ok=True, mode=0o700)
        self.stage = Stage(settings.data / "stage")
        self.voices, self.pages = Voices(self.limits, self.stage), Pages(self.limits, self.stage)
        self.pool = Pool(self.limits, settings.workers, settings.work_seconds, settings.waiting)
        engine = await asyncio.to_thread(open_database, settings.database_url)
        self.queue = Queue(
            engine, settings.lease_seconds, settings.job_attempts, settings.queued_jobs
        )
        self.store = await asyncio.to_thread(Store, settings.storage_url)
        self.runner = Runner(self.queue, self.store, self.stage, self.limits, settings)
        self._starting = asyncio.create_task(self._start_workers())

    async def _start_workers(self) -> None:
        if self.settings.backend == "onnx":
            await asyncio.to_thread(export_all, self.limits)
        await self.pool.start()
        self.runner.start()

    async def stop(self) -> None:
        """Stop the workers; jobs that run are put back."""
        if self._starting is not None:
            self._starting.cancel()
        self.pool.stop()
        self.voices.stop()
        self.pages.stop()
        if self._starting is not None and self._starting.done():
            await asyncio.to_thread(self.runner.stop)
        self.queue.engine.dispose()
        self.stage.close()
