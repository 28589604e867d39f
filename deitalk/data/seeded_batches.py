"""Endless batches of numbered items: item k depends on the seed and on k alone.

Hence batch b is the same for any number of loading workers and of processes that share it, and an
interrupted training continues with the batch that would have come next.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from itertools import count
from typing import Any, Generic, NamedTuple, TypeVar, cast

import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from rig.errors import UserError

Item = TypeVar("Item", bound=tuple[Any, ...])
"""A NamedTuple of tensors; a batch is the same with a leading axis."""


class Share(NamedTuple):
    """Position at which to begin, and this process's part of every batch."""

    skip: int = 0
    """Number of the first batch, for a training that is resumed."""
    rank: int = 0
    """Number of this process; it makes the items rank, rank + world, ... of every batch."""
    world: int = 1
    """Processes that share a batch."""


class SeededBatches(ABC, IterableDataset[Item], Generic[Item]):
    """Base of the data sets that training draws from.

    Parameters
    ----------
    seed : int
        Seed of all items.
    batch_size : int
        Items of a batch, over all processes.
    share : Share
        Where to begin, and this process's part; may be set until the iteration begins.
    """

    def __init__(self, seed: int, batch_size: int, share: Share) -> None:
        self.seed, self.batch_size, self.share = seed, batch_size, share

    def __iter__(self) -> Iterator[Item]:
        """Yield this process's part of the batches of this worker, stacked; in the end its error.

        An error that a worker raised would have the worker's traceback in its message.
        """
        worker = get_worker_info()
        n_workers, lane = (worker.num_workers, worker.id) if worker else (1, 0)
        for batch in count(self.share.skip + lane, n_workers):
            first = batch * self.batch_size
            numbers = range(first + self.share.rank, first + self.batch_size, self.share.world)
            try:
                items = [self.item(number) for number in numbers]
            except UserError as error:
                yield cast("Item", error)
                return
            yield type(items[0])(*(torch.stack(field) for field in zip(*items, strict=True)))

    def rng(self, number: int) -> np.random.Generator:
        """Generator of random numbers for the item of a number."""
        return np.random.default_rng((self.seed, number))

    @abstractmethod
    def item(self, number: int) -> Item:
        """Make the item of a number."""
