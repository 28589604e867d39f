"""Item k depends on the seed and on k alone: workers, processes and interruptions change nothing."""

from typing import NamedTuple

import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from deitalk.data.seeded_batches import SeededBatches, Share


class Numbered(NamedTuple):
    number: Tensor
    noise: Tensor


class Numbers(SeededBatches[Numbered]):
    def item(self, number: int) -> Numbered:
        noise = torch.from_numpy(self.rng(number).standard_normal(2))
        return Numbered(torch.tensor(number), noise)


def take(n: int, seed: int = 3, workers: int = 0, share: Share = Share()) -> list[Numbered]:
    loader = DataLoader(Numbers(seed, 4, share), batch_size=None, num_workers=workers)
    iterator = iter(loader)
    return [next(iterator) for _ in range(n)]


def test_batches_hold_successive_items():
    batches = take(3)
    assert [batch.number.tolist() for batch in batches] == [
        [0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]
    ]  # fmt: skip
    assert batches[0].noise.shape == (4, 2)


def test_items_differ_by_number_and_by_seed():
    drawn = torch.cat([batch.noise[:, 0] for seed in (3, 4) for batch in take(3, seed)])
    assert len(drawn.unique()) == 24


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_change_nothing(workers):
    for one, other in zip(take(5), take(5, workers=workers), strict=True):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("workers", [0, 2])
def test_processes_share_the_batch_of_one(workers):
    whole = take(3)
    parts = [take(3, workers=workers, share=Share(rank=rank, world=2)) for rank in range(2)]
    for batch, first, second in zip(whole, *parts, strict=True):
        for field, a, b in zip(batch, first, second, strict=True):
            assert torch.equal(field[0::2], a) and torch.equal(field[1::2], b)


@pytest.mark.parametrize("workers", [0, 2])
def test_interrupted_training_goes_on_with_the_next_batch(workers):
    whole, later = take(5), take(2, workers=workers, share=Share(skip=3))
    for one, other in zip(whole[3:], later, strict=True):
        assert torch.equal(one.noise, other.noise)
