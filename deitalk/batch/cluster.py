"""Lines on the machines of a Ray cluster, by Ray Data: actors with one model each.

Ray Data gives blocks of a few lines to the actors, and gives those of a machine that ends to
others. A line may then be animated twice; the second result has the same files.
"""

import io
import os
import pickle
import secrets
import shutil
import tarfile
from collections.abc import Iterator, Sequence
from contextlib import chdir, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from deitalk.batch.orders import Order, Outcome
from deitalk.batch.processes import Make
from deitalk.errors import DeitalkError, MissingError
from deitalk.safe_path import safe_path
from rig.errors import UserError, one_line

LINES_PER_BLOCK = 16
"""Lines that one task animates; so many are animated again if its machine ends."""


class Cluster:
    """The machines of a Ray cluster; a context manager.

    Parameters
    ----------
    address : str
        As for ``ray.init``: ``host:6379``, ``auto``, ``ray://host:10001`` or ``local``.
    count : int or None
        Actors; one for each processor if None.
    make : callable
        As for `deitalk.batch.processes.Workers`; it stages files in a folder of its machine.
    stage : str
        Folder of this machine to which they are brought.

    Raises
    ------
    MissingError
        If Ray is not installed.
    DeitalkError
        If no cluster answers.
    """

    def __init__(self, address: str, count: int | None, make: Make, stage: str) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray
            import ray.data
        except ImportError as error:
            raise MissingError(
                f"a Ray cluster needs Ray ({error}); install it by `pip install 'deitalk[ray]'`"
            ) from None
        self._count, self._make, self._stage = count, pickle.dumps(make), Path(stage)
        self._is_ours = not ray.is_initialized()
        self._folder, self._empty = os.getcwd(), TemporaryDirectory(prefix="deitalk-ray-")
        if self._is_ours:
            try:
                # Ray puts the working folder where its workers look for modules: an empty one.
                with safe_path(), chdir(self._empty.name):
                    ray.init(address=address, log_to_driver=False, logging_level="ERROR")
            except (ConnectionError, RuntimeError, ValueError) as error:
                text = one_line(f"Ray at {address}: {error}")
                raise DeitalkError(f"{text}; check the address, or start a cluster") from None

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *error: object) -> None:
        if self._is_ours:
            import ray

            ray.shutdown()
        self._empty.cleanup()

    def run(self, orders: Sequence[Order]) -> Iterator[list[Outcome]]:
        """Yield results as blocks of them are finished, in any order.

        Raises
        ------
        UserError
            If the model cannot be loaded, or the cluster gives up.
        """
        import ray

        context = ray.data.DataContext.get_current()
        context.enable_progress_bars = False
        count = self._count or max(int(ray.cluster_resources().get("CPU", 1)), 1)
        data = ray.data.from_items(
            [{"order": pickle.dumps(order)} for order in orders],
            override_num_blocks=-(-len(orders) // LINES_PER_BLOCK),
        )
        results = data.map_batches(
            _Actor,
            fn_constructor_kwargs={"make": self._make, "folder": self._folder},
            batch_size=None,
            batch_format="numpy",
            compute=ray.data.ActorPoolStrategy(min_size=1, max_size=count),
            num_cpus=1,
            max_restarts=-1,
            max_task_retries=-1,
        )
        try:
            for batch in results.iter_batches(batch_size=None, batch_format="numpy"):
                outcomes = []
                for row in batch["outcome"]:
                    outcome, files = pickle.loads(row)
                    if isinstance(outcome, Exception):
                        raise outcome
                    if files:
                        outcome.stage = str(self._stage / secrets.token_hex(8))
                        with tarfile.open(fileobj=io.BytesIO(files)) as archive:
                            archive.extractall(outcome.stage, filter="data")
                    outcomes.append(outcome)
                yield outcomes
        except ray.exceptions.RayError as error:
            raise DeitalkError(one_line(f"Ray: {error}")) from None


class _Actor:
    """One actor with its model; a callable for `map_batches`.

    `folder` is what the paths of the lines are relative to, where the machine has it.
    """

    def __init__(self, make: bytes, folder: str) -> None:
        self._error: UserError | None = None
        with suppress(OSError):
            os.chdir(folder)
        try:
            self._perform = pickle.loads(make)()
        except UserError as error:
            self._error = type(error)(str(error))

    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        """Map a column of orders to one of results."""
        if self._error is not None:
            return {"outcome": [pickle.dumps((self._error, b""))] * len(batch["order"])}
        orders = [pickle.loads(order) for order in batch["order"]]
        outcomes = [outcome for found in self._perform(orders) for outcome in found]
        return {"outcome": [pickle.dumps((each, _taken(each.stage))) for each in outcomes]}


def _taken(stage: str) -> bytes:
    """The files of a stage as an archive; they are removed."""
    if not stage:
        return b""
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w") as archive:
        archive.add(stage, ".")
    shutil.rmtree(stage)
    return content.getvalue()
