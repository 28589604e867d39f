"""A batch of short recordings with a small random network, animated in this process."""

from pathlib import Path
from typing import ClassVar

import pytest
import soundfile

from deitalk.batch.run import animate_batch
from deitalk.research.evaluation.benchmark_curves import speechlike


class InProcess:
    """Worker of a batch without a process; counts its orders."""

    orders: ClassVar[list] = []

    def __init__(self, count, make):
        self._perform, self._make = None, make

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def run(self, orders):
        self.orders.extend(orders)
        self._perform = self._perform or self._make()
        yield from self._perform(orders)


@pytest.fixture
def orders(monkeypatch):
    """Orders of the batches of a test, which run in this process."""
    monkeypatch.setattr("deitalk.batch.run.Workers", InProcess)
    InProcess.orders.clear()
    return InProcess.orders


@pytest.fixture(scope="session")
def sounds(tmp_path_factory):
    """Three recordings in two folders."""
    folder = tmp_path_factory.mktemp("sounds")
    for name, seconds in (("anna/a.wav", 0.6), ("anna/b.wav", 0.7), ("c.flac", 0.5)):
        (folder / name).parent.mkdir(exist_ok=True)
        soundfile.write(folder / name, speechlike(seconds), 16_000)
    return folder


@pytest.fixture
def lines(sounds, tmp_path):
    """A copy of the recordings that a test may change."""
    import shutil

    return Path(shutil.copytree(sounds, tmp_path / "lines"))


@pytest.fixture
def run(orders, model, lines, tmp_path):
    """Run a batch of the recordings into a folder of the test."""

    def run_batch(source=lines, out=tmp_path / "out", **options):
        return animate_batch(source, out, **({"model": model} | options))

    run_batch.out = tmp_path / "out"
    return run_batch
