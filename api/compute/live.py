"""The voices of all sessions with a causal model, in worker processes with one order at a time.

A voice stays in the worker with the fewest when it begins. While a worker reads what has come, its
next order gathers; so the more voices, the more of them are read in one call.
"""

import asyncio
import itertools
import logging
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from api.compute.order import MOST_VOICES, SAMPLES, Limits, Order
from api.compute.pool import CHECK_SECONDS, Stage, checked, result_path
from api.compute.worker import OrderWorker, OutOfTime
from api.errors import Problem, describe, named_problem, problem_for
from deitalk.acting import Acting
from deitalk.workers import WorkerLost
from rig.arrays import Float32

MODEL = "live"
ORDER_SECONDS = 20.0
"""Time after which the worker is stopped."""
OPEN_SECONDS = 30.0
"""Time in which a voice is opened, the start of the worker included."""
RESTART_SECONDS = 1.0
"""Time between a failure and the next start of the worker."""
log = logging.getLogger("deitalk.service")
_numbers = itertools.count(1)
"""Numbers of voices, each once."""


class Interrupted(NamedTuple):
    """Between the frames of a voice before and after its interruption."""

    next_frame: int
    """Number of the frame at which the sound begins that comes next."""


class Voice:
    """One voice.

    Parameters
    ----------
    voices : Voices
    number : int
    """

    def __init__(self, voices: "Voices", number: int) -> None:
        self.voices, self.number = voices, number
        self.frames: asyncio.Queue[Float32 | Interrupted | Exception] = asyncio.Queue()
        self.opened: asyncio.Future[float] = asyncio.get_running_loop().create_future()

    def feed(self, samples: Float32) -> None:
        """Take samples at 16 kHz."""
        if len(samples):
            self.voices.add({"voice": self.number, "do": "feed", "count": len(samples)}, samples)

    def change(self, fields: dict[str, Any]) -> None:
        """Change fields of the acting; as `LiveAnimator.set`."""
        self.voices.add({"voice": self.number, "do": "set", "fields": fields})

    def interrupt(self, shown: Float32 | None) -> None:
        """Stop speaking, from a frame and its head (C + 6,); as `LiveAnimator.interrupt`."""
        frame = None if shown is None else shown.tolist()
        self.voices.add({"voice": self.number, "do": "interrupt", "shown": frame})

    def finish(self) -> None:
        """Take the end of the sound."""
        self.voices.add({"voice": self.number, "do": "finish"})

    def close(self) -> None:
        """End the voice."""
        self.voices.known.pop(self.number, None)
        self.voices.add({"voice": self.number, "do": "close"})

    def fail(self, problem: Problem) -> None:
        """Have whoever waits for the voice get a problem."""
        if not self.opened.done():
            self.opened.set_exception(problem)
        self.frames.put_nowait(problem)

    async def next_frames(self) -> Float32 | Interrupted:
        """Wait for frames and their track of the head [shape=(n, C + 6)], or an interruption.

        Raises
        ------
        Problem
            If the worker cannot give them.
        """
        frames = await self.frames.get()
        if isinstance(frames, Exception):
            raise frames
        return frames


class Voices:
    """The voices of one worker.

    Parameters
    ----------
    limits : Limits
        Of the worker process.
    stage : Stage
        Where its folder is made.

    Attributes
    ----------
    is_ready : bool
        False from a failure on until the worker has started again. It starts first with the
        first voice.
    """

    def __init__(self, limits: Limits, stage: Stage) -> None:
        self.worker, self.stage = OrderWorker(limits), stage
        self.known: dict[int, Voice] = {}
        self.actions: list[dict[str, Any]] = []
        self.samples: list[Float32] = []
        self.news = asyncio.Event()
        self.task: asyncio.Task[None] | None = None
        self.is_ready = True

    async def open(self, model: str, acting: Acting) -> tuple[Voice, float]:
        """Begin a voice; return it and the look-ahead of its model, seconds.

        Where `acting` gives no seed, each voice has another.

        Raises
        ------
        Problem
            503 if there are too many voices, or the worker ended or does not answer in
            `OPEN_SECONDS`.
        """
        if len(self.known) >= MOST_VOICES:
            raise Problem(503, "all live sessions are taken; try again later", "busy")
        if self.task is None or self.task.done():
            self.task = asyncio.create_task(self._run())
        number = next(_numbers)
        voice = self.known[number] = Voice(self, number)
        fields = {"seed": number} if "seed" not in acting.model_fields_set else {}
        fields = acting.settings | fields
        self.add({"voice": voice.number, "do": "open", "model": model, "fields": fields})
        try:
            return voice, await asyncio.wait_for(voice.opened, OPEN_SECONDS)
        except TimeoutError:
            voice.close()
            raise _ended() from None
        except BaseException:
            voice.close()
            raise

    async def warm(self) -> None:
        """Start the worker and have it read the model `MODEL`, so that the first voice need not.

        A failure is logged.
        """
        try:
            voice, _ = await self.open(MODEL, Acting())
            voice.feed(np.zeros(16_000, np.float32))
            await voice.next_frames()
            voice.close()
        except Problem as problem:
            log.warning("live voices are not ready: %s", problem.message)

    def add(self, action: dict[str, Any], samples: Float32 | None = None) -> None:
        """Add an action to the next order."""
        self.actions.append(action)
        if samples is not None:
            self.samples.append(samples)
        self.news.set()

    def stop(self) -> None:
        """End the worker process."""
        if self.task is not None:
            self.task.cancel()
        self.worker.stop()

    async def _run(self) -> None:
        """Carry out orders; begin again with a new worker and folder after any failure."""
        while True:
            try:
                async with self.stage.folder() as folder:
                    await asyncio.to_thread(self.worker.start)
                    self.is_ready = True
                    while True:
                        with suppress(TimeoutError):
                            await asyncio.wait_for(self.news.wait(), CHECK_SECONDS)
                        if not self.worker.is_alive:
                            raise WorkerLost
                        if self.news.is_set():
                            await self._order(folder)
            except Exception as error:
                self._fail(error)
                await asyncio.sleep(RESTART_SECONDS)

    async def _order(self, folder: Path) -> None:
        """Send what has come to the worker, and its frames to the voices."""
        self.news.clear()
        actions, samples = self.actions, self.samples
        self.actions, self.samples = [], []
        joined = np.concatenate([np.zeros(0, np.float32), *samples])
        (folder / SAMPLES).write_bytes(joined.astype("<f4").tobytes())
        order: Order = {"kind": "voices", "folder": str(folder), "options": {"actions": actions}}
        process = self.worker.pid
        answer = checked(await asyncio.to_thread(self.worker.run, order, ORDER_SECONDS))
        if self.worker.pid != process:  # the new one has none of the voices
            raise WorkerLost
        values = np.fromfile(result_path(folder, answer), "<f4")
        for number, seconds in answer["facts"]["opened"]:
            if (voice := self.known.get(number)) and not voice.opened.done():
                voice.opened.set_result(seconds)
        counts = answer["facts"]["frames"]
        for number, classes, message in answer["facts"]["failed"]:
            if voice := self.known.pop(number, None):
                voice.fail(named_problem(classes, message))
        for number, next_frame in answer["facts"]["interrupted"]:
            if voice := self.known.get(number):
                voice.frames.put_nowait(Interrupted(next_frame))
        rows = values.reshape(sum(count for _, count in counts), -1) if counts else values
        for number, count in counts:
            frames, rows = rows[:count], rows[count:]
            if voice := self.known.get(number):
                voice.frames.put_nowait(frames.astype(np.float32))

    def _fail(self, error: Exception) -> None:
        """End all voices: their state is lost, or may be that of the failing one."""
        self.is_ready = False
        is_ended = isinstance(error, OutOfTime | WorkerLost)
        problem = _ended() if is_ended else problem_for(error)
        log.error("%d live voices ended: %s", len(self.known), describe(error))
        self.worker.stop()
        self.actions, self.samples = [], []
        lost, self.known = self.known, {}
        for voice in lost.values():
            voice.fail(problem)


class LivePool:
    """Workers of voices.

    Parameters
    ----------
    limits : Limits
        Of each worker process.
    stage : Stage
        Where their folders are made.
    workers : int
        Processes: on a processor one a core, as each computes with one thread; on another device
        one, which reads all voices in one call.
    """

    def __init__(self, limits: Limits, stage: Stage, workers: int) -> None:
        self.workers = [Voices(limits, stage) for _ in range(workers)]

    @property
    def is_ready(self) -> bool:
        """Whether no worker has to start again."""
        return all(voices.is_ready for voices in self.workers)

    async def open(self, model: str, acting: Acting) -> tuple[Voice, float]:
        """Begin a voice in the worker with the fewest; as `Voices.open`."""
        least = min(self.workers, key=lambda voices: (not voices.is_ready, len(voices.known)))
        return await least.open(model, acting)

    async def warm(self) -> None:
        """Start the workers one after the other, and have each read the model `MODEL`."""
        for voices in self.workers:
            await voices.warm()
        log.info("live voices are ready")

    def stop(self) -> None:
        """End the processes."""
        for voices in self.workers:
            voices.stop()


def _ended() -> Problem:
    return Problem(
        503, "the live worker ended or does not answer; connect again", "busy",
        headers={"Retry-After": "5"},
    )  # fmt: skip
