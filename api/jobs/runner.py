"""Jobs carried out by threads with a worker process each; their files, retention."""

import logging
import secrets
import shutil
import threading
from collections.abc import Iterator
from datetime import datetime
from functools import partial
from pathlib import Path
from time import time
from typing import Any

import fsspec

from api.compute.order import Limits, Order
from api.compute.pool import Stage, checked, result_path
from api.compute.worker import OrderWorker, OutOfTime, Stopped
from api.errors import InternalError, Problem, problem_for
from api.guard.metrics import Metrics
from api.guard.traces import Traces
from api.jobs.queue import LOST, Queue
from api.jobs.table import Job
from api.settings import Settings
from deitalk.workers import WorkerLost

# Files of jobs: a folder, or whatever fsspec reaches, such as an S3 bucket.
#
# ::
#
#     deitalk-inputs/<id>/<name>              what a request sent
#     deitalk-results/<id>/<holder>-<name>    what a worker made; the table names the one that
#     counts deitalk-check-<random>                  empty, for a moment, when a server starts
#
# Other folders of the place are never listed, and never removed.


INPUTS, RESULTS = "deitalk-inputs", "deitalk-results"
BLOCK_BYTES = 1 << 20
UNKNOWN_SECONDS = 86_400.0


class Store:
    """Files under an fsspec URL or a folder.

    Parameters
    ----------
    url : str
        ``/var/lib/…``, ``s3://bucket/prefix``, ``memory://…``.
    """

    def __init__(self, url: str) -> None:
        # Listings are not kept: other servers add and remove files.
        self.files, self.root = fsspec.core.url_to_fs(url, use_listings_cache=False)
        self.files.makedirs(self.root, exist_ok=True)

    def check(self) -> None:
        """Write an empty file and remove it; raises what the file system raises."""
        path = self._at(f"deitalk-check-{secrets.token_hex(8)}")
        self.files.pipe_file(path, b"")
        self.files.rm_file(path)

    def put_folder(self, folder: Path, job_id: str) -> None:
        """Copy the files of a folder to be a job's inputs."""
        self._make(f"{INPUTS}/{job_id}")
        for path in sorted(path for path in folder.iterdir() if path.is_file()):
            self.files.put_file(str(path), self._at(f"{INPUTS}/{job_id}/{path.name}"))

    def get_folder(self, job_id: str, folder: Path) -> None:
        """Copy a job's inputs into a folder."""
        for name in self.files.ls(self._at(f"{INPUTS}/{job_id}"), detail=False):
            self.files.get_file(name, str(folder / name.rpartition("/")[2]))

    def put_result(self, path: Path, job_id: str, holder: str) -> str:
        """Copy a result; return its name."""
        name = f"{RESULTS}/{job_id}/{holder}-{path.name}"
        self._make(f"{RESULTS}/{job_id}")
        self.files.put_file(str(path), self._at(name))
        return name

    def read(self, name: str, begin: int, end: int, size: int) -> Iterator[bytes]:
        """Open a file of `size` bytes; return those from `begin` to before `end`, in blocks.

        Raises
        ------
        Problem
            410 if it is not there any more, or not whole.
        """
        try:
            file = self.files.open(self._at(name), "rb")
        except FileNotFoundError:
            raise Problem(410, "the file of the result is gone; send the job again") from None
        if file.size is not None and file.size < size:
            file.close()
            raise Problem(410, "the file of the result is not whole; send the job again")
        return _blocks(file, begin, end)

    def remove(self, job_id: str) -> None:
        """Remove all files of a job."""
        for kind in (INPUTS, RESULTS):
            self._remove(self._at(f"{kind}/{job_id}"))

    def remove_inputs(self, job_id: str) -> None:
        """Remove what a job's request sent."""
        self._remove(self._at(f"{INPUTS}/{job_id}"))

    def jobs(self) -> set[str]:
        """Ids of all jobs that have files."""
        found: set[str] = set()
        for kind in (INPUTS, RESULTS):
            if self.files.exists(self._at(kind)):
                listed = self.files.ls(self._at(kind), detail=False, refresh=True)
                found |= {name.rstrip("/").rpartition("/")[2] for name in listed}
        return found

    def age(self, job_id: str) -> float:
        """Seconds since the newest file of a job was written; a day where that is unknown.

        A folder without files counts itself: its first file may be on its way.
        """
        newest = 0.0
        for kind in (INPUTS, RESULTS):
            folder = self._at(f"{kind}/{job_id}")
            if self.files.exists(folder):
                found = self.files.find(folder, detail=True) or {folder: self.files.info(folder)}
                newest = max(newest, *(_written(about) for about in found.values()))
        return time() - newest if newest else UNKNOWN_SECONDS

    def _at(self, name: str) -> str:
        return f"{self.root.rstrip('/')}/{name}"

    def _make(self, name: str) -> None:
        self.files.makedirs(self._at(name), exist_ok=True)

    def _remove(self, path: str) -> None:
        try:
            self.files.rm(path, recursive=True)
        except FileNotFoundError:
            return
        invalidate: Any = getattr(self.files, "invalidate_cache", lambda: None)
        invalidate()


def _blocks(file: Any, begin: int, end: int) -> Iterator[bytes]:
    with file:
        file.seek(begin)
        while begin < end and (block := file.read(min(BLOCK_BYTES, end - begin))):
            begin += len(block)
            yield block


def _written(about: dict[str, Any]) -> float:
    """Time at which a file was written, as file systems name it; now if they do not."""
    found = about.get("mtime", about.get("LastModified", about.get("created")))
    if isinstance(found, datetime):
        return found.timestamp()
    return float(found) if isinstance(found, int | float) else time()


IDLE_SECONDS = 0.5
"""Time between two looks for work, unless `Runner.wake` is called."""
CLEAR_SECONDS = 60.0
"""Time between two removals of jobs that are no longer kept, by one of all servers."""
LOST_SECONDS = 3600.0
"""Time between two looks for files without a job."""
log = logging.getLogger("deitalk.service")


class Runner:
    """Carries out the jobs of a queue.

    Parameters
    ----------
    queue, store, stage
        Where jobs, their files and working folders are.
    limits : Limits
        Of the worker processes.
    settings : Settings
        Number of workers, times, retention.
    metrics : Metrics
        Of the server.
    traces : Traces
        Of the server.
    """

    def __init__(
        self,
        queue: Queue,
        store: Store,
        stage: Stage,
        limits: Limits,
        settings: Settings,
        metrics: Metrics,
        traces: Traces,
    ) -> None:
        self.queue, self.store, self.stage = queue, store, stage
        self.settings, self.metrics, self.traces = settings, metrics, traces
        self.at_work = 0
        self.workers = [OrderWorker(limits) for _ in range(settings.job_workers)]
        self._ending, self._wake = threading.Event(), threading.Event()
        self._draining = False
        self._threads = [
            threading.Thread(target=self._work, args=(worker,), daemon=True)
            for worker in self.workers
        ]
        self._threads.append(threading.Thread(target=self._clear_up, daemon=True))

    def start(self) -> None:
        """Start the threads."""
        for thread in self._threads:
            thread.start()

    def wake(self) -> None:
        """Look for work now."""
        self._wake.set()

    def drain(self) -> None:
        """Begin no other job; `at_work` counts those left."""
        self._draining = True

    def stop(self) -> None:
        """Stop; jobs that run are put back into the queue."""
        self._ending.set()
        self._wake.set()
        for thread in self._threads:
            thread.join(timeout=10)

    def _work(self, worker: OrderWorker) -> None:
        while not self._ending.is_set():
            try:
                job = None if self._draining else self.queue.claim()
                if job is not None:
                    self._work_on(job, worker)
                    continue
            except Exception as error:  # a database or store that is away for a while
                log.warning("jobs wait: %s", type(error).__name__)
                self._ending.wait(1.0)
            self._wake.wait(IDLE_SECONDS)
            self._wake.clear()
        worker.stop()

    def _work_on(self, job: Job, worker: OrderWorker) -> None:
        began = time()
        if job.attempts == 1:
            self.metrics.waited.observe(began - job.created)
        self.at_work += 1
        try:
            with self.traces.span("job", job.work.get("trace", "")) as facts:
                facts |= {"deitalk.format": job.work["format"], "deitalk.key": job.owner}
                self._carry_out(job, worker)
        finally:
            self.at_work -= 1
            self.metrics.job_seconds.labels(job.work["format"]).observe(time() - began)

    def _carry_out(self, job: Job, worker: OrderWorker) -> None:
        """Do a job and end it, or leave it to the next."""
        folder = self.stage.make()
        seconds = self.settings.job_work_seconds
        try:
            with _Lease(self.queue, job) as lease:
                self.store.get_folder(job.id, folder)
                order: Order = job.work["order"] | {"folder": str(folder)}
                stopped = partial(self._must_stop, lease)
                answer = checked(worker.run(order, seconds, lease.note, stopped))
                path = result_path(folder, answer)
                name = self.store.put_result(path, job.id, job.holder)
            if lease.is_lost:
                raise Stopped
            facts = answer.get("facts", {})
            about = {"notes": answer.get("notes", []), "facts": facts}
            if self.queue.finish(job, name, path.stat().st_size, about):
                self.store.remove_inputs(job.id)
                self.queue.use(job.owner, self.metrics.read(answer, "job"))
        except InternalError as error:
            log.error("internal error in a job: %s", error)
            self.queue.fail(job, Problem(500, "internal error; see the service's log", "internal"))
        except OutOfTime:
            self.queue.fail(job, Problem(413, f"the job took more than {seconds:g} s"))
        except WorkerLost:
            log.warning("a job's worker ended; the job is begun again")
            self.queue.retry(job, LOST, waits=False)
        except Stopped:
            if not self.queue.confirm_cancelled(job):
                self.queue.release(job)
        except Exception as error:  # of the content; or the disk is full, the store is away
            problem = problem_for(error)
            is_content = isinstance(error, Problem) and problem.status != 507
            (self.queue.fail if is_content else self.queue.retry)(job, problem)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _must_stop(self, lease: "_Lease") -> bool:
        return lease.is_lost or self._ending.is_set()

    def _clear_up(self) -> None:
        while not self._ending.wait(IDLE_SECONDS):
            try:
                if self.queue.take_duty("retention", CLEAR_SECONDS):
                    remove_old(self.queue, self.store, self.settings)
                if self.queue.take_duty("lost files", LOST_SECONDS):
                    remove_lost(self.queue, self.store)
                    self.queue.forget_usage()
            except Exception as error:
                log.warning("clearing up waits: %s", type(error).__name__)
            self._ending.wait(CLEAR_SECONDS / 4)


class _Lease:
    """The lease of a job, renewed during a block: copying its files takes time as its work does.

    Attributes
    ----------
    is_lost : bool
        Whether the job was cancelled or is another's by now.
    """

    def __init__(self, queue: Queue, job: Job) -> None:
        self.queue, self.job = queue, job
        self.is_lost, self._done = False, 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._renew, daemon=True)

    def __enter__(self) -> "_Lease":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def note(self, share: float) -> None:
        """Note the share of the work that is done, 0 to 1."""
        self._done = share

    def _renew(self) -> None:
        while not (self.is_lost or self._over.wait(self.queue.lease_seconds / 4)):
            try:
                self.is_lost = not self.queue.renew(self.job, self._done)
            except Exception as error:  # a database that is away for a while
                log.warning("a lease waits: %s", type(error).__name__)


def remove_old(queue: Queue, store: Store, settings: Settings) -> int:
    """Remove ended jobs beyond the age and size that are kept of each key; return their number."""
    oldest, removed = time() - settings.keep_days * 86_400, 0
    rooms = {key.name: key.keep_mb * 2**20 for key in settings.keys if key.keep_mb is not None}
    while ids := queue.expired(oldest, settings.keep_mb * 2**20, rooms):
        removed += queue.remove_ended(ids)
        for job_id in ids:
            store.remove(job_id)
    return removed


def remove_lost(queue: Queue, store: Store) -> None:
    """Remove files without a job, which a server leaves that is killed while it takes one."""
    there = store.jobs()
    for job_id in there - queue.known_of(sorted(there)):
        if store.age(job_id) > CLEAR_SECONDS:
            store.remove(job_id)
