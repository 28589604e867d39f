"""The studio's page with each head: drawn once, by a worker process that ends afterwards."""

import asyncio

from api.compute.order import Limits, Order
from api.compute.pool import Stage, checked, result_path
from api.compute.worker import OrderWorker, OutOfTime
from api.errors import RETRY, Problem
from deitalk.workers import WorkerLost

DRAW_SECONDS = 120.0
"""Longest time that drawing one page may take."""
DRAW_BYTES = 2**31
"""Memory that it may take, with the building of a head that is not in the cache."""


class Pages:
    """Pages by head. One is drawn at a time, however many are asked for.

    Parameters
    ----------
    limits : Limits
        Of the worker process, but for its memory.
    stage : Stage
        Where its folders are made.
    """

    def __init__(self, limits: Limits, stage: Stage) -> None:
        self.worker, self.stage = OrderWorker({**limits, "memory_bytes": DRAW_BYTES}), stage
        self._one = asyncio.Lock()
        self._drawn: dict[str, asyncio.Task[bytes]] = {}

    async def page(self, head: str) -> bytes:
        """Return the page with a head.

        Parameters
        ----------
        head : str
            Number, name or role of an identity; each is drawn once, whatever it is called.

        Raises
        ------
        RigError
            If there is no such head.
        Problem
            503 if it cannot be drawn; the next request tries again.
        """
        name = await asyncio.to_thread(_name_of, head)
        drawing = self._drawn.get(name)
        if drawing is None or (drawing.done() and drawing.exception() is not None):
            drawing = self._drawn[name] = asyncio.create_task(self._draw(name))
        return await asyncio.shield(drawing)

    async def _draw(self, name: str) -> bytes:
        async with self._one, self.stage.folder() as folder:
            order: Order = {"kind": "studio", "folder": str(folder), "options": {"head": name}}
            try:
                answer = checked(await asyncio.to_thread(self.worker.run, order, DRAW_SECONDS))
                return result_path(folder, answer).read_bytes()
            except (OutOfTime, WorkerLost):
                raise Problem(503, "the page was not drawn; try again", headers=RETRY) from None
            finally:
                self.worker.stop()  # its memory is that of the largest page

    def stop(self) -> None:
        """End the worker process, and what waits for it."""
        for drawing in self._drawn.values():
            drawing.cancel()
        self.worker.stop()


def _name_of(head: str) -> str:
    from rig.face.identity import resolve_identity  # takes as long to import as all else here

    return resolve_identity(head).name
