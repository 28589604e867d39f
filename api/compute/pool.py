"""Worker processes that requests share, and the folders they work in."""

import asyncio
import shutil
import tempfile
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from api.compute.order import OUT, Answer, Limits, Order, TooLarge
from api.compute.worker import OutOfTime, Worker, WorkerLost
from api.errors import InternalError, Problem, named_problem

SERVER_PREFIX = "deitalk-server-"
LOCK = ".deitalk.lock"


class Pool:
    """Worker processes for work that a client waits for.

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
        self.seconds, self.most = seconds, workers + waiting
        self._idle = [Worker(limits) for _ in range(workers)]
        self._all = tuple(self._idle)
        self._free = asyncio.Semaphore(workers)
        self._threads = ThreadPoolExecutor(workers, "worker")
        self.busy = 0
        self.lost = 0

    @property
    def is_ready(self) -> bool:
        """Whether a process waits for orders, or works on one."""
        return any(worker.is_ready for worker in self._all)

    async def start(self) -> None:
        """Start the processes, the first one first: it is ready soonest alone."""
        loop = asyncio.get_running_loop()
        for worker in self._all:
            with suppress(WorkerLost):
                await loop.run_in_executor(self._threads, worker.start)

    async def run(self, order: Order) -> Answer:
        """Wait for a free process and its answer.

        Raises
        ------
        Problem
            503 if too many orders wait, 413 if the work passed its limits,
            422 and others for errors of the content.
        """
        if self.busy >= self.most:
            raise Problem(
                503,
                "the service is busy; try again in a second",
                "busy",
                None,
                {"Retry-After": "1"},
            )
        self.busy += 1
        try:
            await self._free.acquire()
            worker = self._idle.pop()
            loop = asyncio.get_running_loop()
            work = loop.run_in_executor(self._threads, worker.run, order, self.seconds)
            work.add_done_callback(lambda done: self._give_back(worker))
            return checked(await asyncio.shield(work))
        except OutOfTime:
            raise Problem(
                413, f"the request took more than {self.seconds:g} s; send less, or make a job"
            ) from None
        except WorkerLost:
            self.lost += 1
            raise Problem(
                413, "the request needs more memory than a worker may take, or ended it"
            ) from None
        finally:
            self.busy -= 1

    def _give_back(self, worker: Worker) -> None:
        """Take the next order, also where the client of the last one has gone."""
        self._idle.append(worker)
        self._free.release()

    def stop(self) -> None:
        """End all processes."""
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
        """Return a new folder with a place for results."""
        self.own.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(dir=self.own))
        (folder / OUT).mkdir()
        return folder

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
