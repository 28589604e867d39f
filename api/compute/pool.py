"""OrderWorker processes that requests share, and the folders they work in."""

import asyncio
import logging
import shutil
import tempfile
import threading
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from functools import partial
from math import inf
from pathlib import Path
from time import monotonic

import anyio
from filelock import FileLock, Timeout

from api.compute.order import OUT, Answer, Limits, Order, TooLarge
from api.compute.worker import OrderWorker, OutOfTime
from api.errors import InternalError, Problem, named_problem
from api.guard.keys import Caller, Places
from deitalk.workers import WorkerLost

SERVER_PREFIX = "deitalk-server-"
LOCK = ".deitalk.lock"
log = logging.getLogger("deitalk.service")


CHECK_SECONDS = 0.5
"""Time between two looks for processes that have ended."""
FAIR_SECONDS = 60.0
"""Time in which work counts: of two callers that wait, the one with less for its share is next."""


class Turns:
    """Workers that are free, none at first, and the callers who wait for one."""

    def __init__(self) -> None:
        self.idle: list[OrderWorker] = []
        self.waiting: list[tuple[Caller, asyncio.Future[OrderWorker]]] = []
        self.work: dict[str, list[list[float]]] = {}
        """Begin and end of the work for each caller in the last `FAIR_SECONDS`."""

    async def take(self, caller: Caller) -> OrderWorker:
        """Wait for a worker; a caller who is cancelled meanwhile takes none."""
        turn: asyncio.Future[OrderWorker] = asyncio.get_running_loop().create_future()
        self.waiting.append((caller, turn))
        self._next()
        try:
            return await turn
        except BaseException:
            if turn.done() and not turn.cancelled():
                self.idle.append(turn.result())
            elif (caller, turn) in self.waiting:  # else `_next` has dropped it
                self.waiting.remove((caller, turn))
            self._next()
            raise

    def give(self, worker: OrderWorker) -> None:
        """Take a worker, for the first time or back."""
        self.idle.append(worker)
        self._next()

    def begin(self, caller: Caller) -> list[float]:
        """Note work; its end is infinite until it is set."""
        span = [monotonic(), inf]
        self.work.setdefault(caller.holder, []).append(span)
        return span

    def _next(self) -> None:
        while self.idle and self.waiting:
            now = monotonic()
            least = min(self.waiting, key=lambda wait: self._worked(wait[0], now))
            self.waiting.remove(least)
            if not least[1].done():
                least[1].set_result(self.idle.pop())

    def _worked(self, caller: Caller, now: float) -> float:
        """Recent work for a caller, seconds, divided by its share."""
        begin = now - FAIR_SECONDS
        spans = [span for span in self.work.get(caller.holder, ()) if span[1] > begin]
        self.work[caller.holder] = spans
        return sum(min(end, now) - max(start, begin) for start, end in spans) / caller.share


class Pool:
    """OrderWorker processes for work that a client waits for.

    Parameters
    ----------
    limits : Limits
        Of each process.
    workers : int
        Processes.
    seconds : float
        Longest work on one order.
    waiting : int
        Most orders that wait for a process; more are refused.
    """

    def __init__(self, limits: Limits, workers: int, seconds: float, waiting: int) -> None:
        self.seconds, self.places = seconds, Places(workers + waiting)
        self._all = [OrderWorker(limits) for _ in range(workers)]
        self.turns = Turns()
        self._threads = ThreadPoolExecutor(workers, "worker")
        self.lost = self.left = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._is_ending = False

    @property
    def is_ready(self) -> bool:
        """Whether a process waits for orders, or works on one."""
        return any(worker.is_ready for worker in self._all)

    async def start(self) -> None:
        """Start the processes, one after the other: the first is ready soonest so."""
        for worker in self._all:
            await self._start(worker)
        self._tasks.add(asyncio.create_task(self._keep()))

    async def _start(self, worker: OrderWorker) -> None:
        """Start a process; where that fails, `_keep` or an order tries again after a while."""
        try:
            await asyncio.get_running_loop().run_in_executor(self._threads, worker.start)
        except WorkerLost:
            await asyncio.sleep(4 * CHECK_SECONDS)
        self.turns.give(worker)

    async def _keep(self) -> None:
        """Replace processes that end while they wait."""
        while True:
            await asyncio.sleep(CHECK_SECONDS)
            for worker in [worker for worker in self.turns.idle if not worker.is_alive]:
                log.warning("a worker process ended; another one starts")
                self.turns.idle.remove(worker)
                self._give(worker)

    def _give(self, worker: OrderWorker) -> None:
        """Take a worker back, after another process has started if its own has ended."""
        if worker.is_alive or self._is_ending:
            self.turns.give(worker)
            return
        task = asyncio.create_task(self._start(worker))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def run(self, order: Order, caller: Caller) -> Answer:
        """Wait for a process and its answer; if the client goes, the work ends.

        Raises
        ------
        Problem
            503, 429 as `Places.check`; 413 if the work passed its limits, 503 if two processes
            ended in it, 422 and others for errors of the content.
        """
        try:
            with self.places.hold(caller.holder):
                try:
                    answer = await self._try(order, caller)
                except WorkerLost:
                    log.warning("a worker process ended in a request, which another begins again")
                    answer = await self._try(order, caller)
                return checked(answer)
        except asyncio.CancelledError:
            self.left += 1
            raise
        except OutOfTime:
            raise Problem(
                413, f"the request took more than {self.seconds:g} s; send less, or make a job"
            ) from None
        except WorkerLost:
            raise Problem(
                503, "two worker processes ended during the request; try it again later",
                "worker_lost", headers={"Retry-After": "5"},
            ) from None  # fmt: skip

    async def _try(self, order: Order, caller: Caller) -> Answer:
        worker = await self.turns.take(caller)
        span, gone = self.turns.begin(caller), threading.Event()

        def over(done: "asyncio.Future[Answer]") -> None:
            span[1] = monotonic()
            if not done.cancelled() and isinstance(done.exception(), WorkerLost):
                self.lost += 1
            self._give(worker)

        run = partial(worker.run, order, self.seconds, stopped=gone.is_set)
        work = asyncio.get_running_loop().run_in_executor(self._threads, run)
        work.add_done_callback(over)
        try:
            return await asyncio.shield(work)
        except asyncio.CancelledError:
            gone.set()
            with anyio.CancelScope(shield=True):
                await asyncio.wait([work])  # else it writes into a folder that is being removed
            raise

    def stop(self) -> None:
        """End all processes."""
        self._is_ending = True
        for task in self._tasks:
            task.cancel()
        for worker in self._all:
            worker.stop()
        self._threads.shutdown(wait=False, cancel_futures=True)


def checked(answer: Answer) -> Answer:
    """Return an answer; raise the Problem that an error stands for."""
    if "error" not in answer:
        return answer
    classes, message = answer["error"], answer["message"]
    if classes[0] == TooLarge.__name__:
        raise Problem(413, message)
    if classes[0] == "Internal":
        raise InternalError(message)
    raise named_problem(classes, message)


class Stage:
    """Folders of orders of one server, with random names, below a folder that servers share.

    Each server has a folder of its own there, whose lock it holds until it ends, however it ends.
    Folders whose lock is free were left behind by a killed server and are removed; nothing else is.

    Parameters
    ----------
    root : Path
        Made if it is missing.
    """

    def __init__(self, root: Path) -> None:
        root.mkdir(parents=True, exist_ok=True, mode=0o700)
        with FileLock(root / LOCK):  # a folder that another server makes has its lock already
            for left in root.glob(f"{SERVER_PREFIX}*"):
                if left.is_dir() and not left.is_symlink() and not _is_held(left):
                    shutil.rmtree(left, ignore_errors=True)
            self.own = Path(tempfile.mkdtemp(dir=root, prefix=SERVER_PREFIX))
            self._lock = FileLock(self.own / LOCK, thread_local=False)
            self._lock.acquire()

    def make(self) -> Path:
        """Return a new folder."""
        self.own.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(dir=self.own))

    def close(self) -> None:
        """Remove the server's folder."""
        self._lock.release()
        shutil.rmtree(self.own, ignore_errors=True)

    @asynccontextmanager
    async def folder(self) -> AsyncIterator[Path]:
        """Yield a folder that is removed afterwards."""
        folder = self.make()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _is_held(folder: Path) -> bool:
    """Whether the server that made a folder still runs."""
    try:
        with FileLock(folder / LOCK, timeout=0):
            return False
    except Timeout:
        return True


def result_path(folder: Path, answer: Answer) -> Path:
    """Return the file of an answer; it lies in the folder's ``out/``."""
    path = (folder / answer["file"]).resolve()
    if path.parent != (folder / OUT).resolve() or not path.is_file():
        raise InternalError("a worker named a file outside its folder")
    return path
