"""Threads that carry out jobs, each with a worker process; and one that clears up."""

import logging
import shutil
import threading
from time import monotonic, time

from api.compute.order import Answer, Limits, Order
from api.compute.pool import Stage, checked, result_path
from api.compute.worker import OutOfTime, Stopped, Worker, WorkerLost
from api.errors import InternalError, Problem
from api.jobs.queue import Queue
from api.jobs.store import Store
from api.jobs.table import Job
from api.jobs.webhooks import Webhooks
from api.settings import Settings

IDLE_SECONDS = 0.5
"""Time between two looks for work, unless `Runner.wake` is called."""
CLEAR_SECONDS = 60.0
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
    """

    def __init__(
        self, queue: Queue, store: Store, stage: Stage, limits: Limits, settings: Settings
    ) -> None:
        self.queue, self.store, self.stage = queue, store, stage
        self.settings = settings
        self.webhooks = Webhooks(queue, settings.webhook_hosts)
        self.workers = [Worker(limits) for _ in range(settings.job_workers)]
        self._ending, self._wake = threading.Event(), threading.Event()
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

    def stop(self) -> None:
        """Stop; jobs that run are put back into the queue."""
        self._ending.set()
        self._wake.set()
        for thread in self._threads:
            thread.join(timeout=10)

    def _work(self, worker: Worker) -> None:
        while not self._ending.is_set():
            try:
                job = self.queue.claim()
                if job is not None:
                    self._carry_out(job, worker)
                    continue
            except Exception as error:  # a database or store that is away for a while
                log.warning("jobs wait: %s", type(error).__name__)
                self._ending.wait(1.0)
            self._wake.wait(IDLE_SECONDS)
            self._wake.clear()
        worker.stop()

    def _carry_out(self, job: Job, worker: Worker) -> None:
        folder = self.stage.make()
        try:
            self.store.get_folder(job.id, folder)
            order: Order = job.work["order"] | {"folder": str(folder)}
            answer = checked(self._run(job, worker, order))
            path = result_path(folder, answer)
            name = self.store.put_result(path, job.id, job.holder)
            about = {"notes": answer.get("notes", []), "facts": answer.get("facts", {})}
            if self.queue.finish(job, name, path.stat().st_size, about):
                self.store.remove_inputs(job.id)
        except Problem as problem:
            self.queue.fail(job, problem)
        except InternalError as error:
            log.error("internal error in a job: %s", error)
            self.queue.fail(job, Problem(500, "internal error; see the service's log", "internal"))
        except OutOfTime:
            seconds = self.settings.job_work_seconds
            self.queue.fail(job, Problem(413, f"the job took more than {seconds:g} s"))
        except WorkerLost:
            log.warning("a job's worker ended; the job is begun again")
        except Stopped:
            if not self.queue.confirm_cancelled(job):
                self.queue.release(job)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _run(self, job: Job, worker: Worker, order: Order) -> Answer:
        """Wait for the worker and renew the lease."""
        done, renewed = 0.0, monotonic()

        def note(share: float) -> None:
            nonlocal done
            done = share

        def must_stop() -> bool:
            nonlocal renewed
            if self._ending.is_set():
                return True
            if monotonic() - renewed < self.queue.lease_seconds / 4:
                return False
            renewed = monotonic()
            return not self.queue.renew(job, done)

        return worker.run(order, self.settings.job_work_seconds, note, must_stop)

    def _clear_up(self) -> None:
        cleared = 0.0
        while not self._ending.wait(IDLE_SECONDS):
            try:
                self.webhooks.deliver()
                if monotonic() - cleared > CLEAR_SECONDS:
                    cleared = monotonic()
                    remove_old(self.queue, self.store, self.settings)
            except Exception as error:
                log.warning("clearing up waits: %s", type(error).__name__)


def remove_old(queue: Queue, store: Store, settings: Settings) -> int:
    """Remove ended jobs beyond the age and size that are kept, and files without a job.

    Returns
    -------
    int
        Jobs removed.
    """
    oldest, room = time() - settings.keep_days * 86_400, settings.keep_mb * 2**20
    removed = 0
    for job in reversed(queue.ended()):  # the newest first
        room -= job.result_bytes
        if (job.finished or 0.0) < oldest or room < 0:
            removed += queue.remove(job)
            store.remove(job.id)
    for job_id in store.jobs():
        if not queue.exists(job_id) and store.age(job_id) > CLEAR_SECONDS:
            store.remove(job_id)
    return removed
