"""Jobs carried out by threads with a worker process each; their files, retention."""

import logging
import shutil
import threading
from time import time

from api.compute.order import Limits, Order
from api.compute.pool import Stage, checked, result_path
from api.compute.worker import OrderWorker, OutOfTime, Stopped
from api.errors import InternalError, Problem, problem_for
from api.guard.metrics import Metrics
from api.guard.traces import Traces
from api.jobs.queue import LOST, Queue
from api.jobs.store import Store
from api.jobs.table import Job
from api.settings import Settings
from deitalk.workers import WorkerLost

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
                answer = checked(
                    worker.run(
                        order,
                        seconds,
                        lease.note,
                        stopped=lambda: lease.is_lost or self._ending.is_set(),
                    )
                )
                path = result_path(folder, answer)
                name = self.store.put_result(path, job.id, job.holder)
            if lease.is_lost:
                raise Stopped
            about = {"notes": answer.get("notes", []), "facts": answer.get("facts", {})}
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
