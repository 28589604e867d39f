"""Fuzzed inputs of every reader: read, or refused in one line, within the time limit.

``python -m tests.fuzz --count 100000`` is the nightly size, in workers of bounded memory.
"""

import os
import time

import pytest

from tests.fuzz import run
from tests.fuzz.mutate import mutated
from tests.fuzz.readers import SLOW, Reader, Seed, readers
from tests.fuzz.run import attempt, in_process

COUNT = int(os.environ.get("FUZZ_COUNT", "100"))
READERS = readers()


@pytest.mark.parametrize("name", [name for name in READERS if name not in SLOW])
def test_fuzzed_input_is_read_or_refused_in_one_line(name, tmp_path):
    outcome = in_process(READERS[name], name, COUNT, 1, tmp_path)
    assert outcome.failures == []
    assert outcome.read + outcome.refused == COUNT
    assert outcome.slowest < 5


@pytest.mark.parametrize("name", [name for name in READERS if name not in SLOW])
def test_every_seed_is_read(name, tmp_path):
    seeds = READERS[name].seeds(tmp_path)
    for seed in seeds:
        (tmp_path / seed.name).write_bytes(seed.data)
        if seed.data != b"0\tX\n10\tA\n" and name != "datagram":
            assert attempt(READERS[name], tmp_path / seed.name) == "", seed.name


def test_failing_reader_is_reported(tmp_path):
    def read(path):
        return int(path.read_bytes())

    failing = Reader(lambda folder: [Seed("n.txt", b"12345", mutated)], read)
    outcome = in_process(failing, "n", 50, 0, tmp_path)
    assert outcome.failures and outcome.failures[0][1].startswith("ValueError")


def test_worker_that_hangs_or_exceeds_memory_is_ended(tmp_path, monkeypatch):
    pytest.importorskip("resource", reason="limits of memory need Unix")
    monkeypatch.setattr(run, "SECONDS", 0.3)
    monkeypatch.setattr(run, "PATIENCE", 2)
    parent = os.getpid()

    def read(path):
        if os.getpid() == parent:
            return None  # the seed, read before a worker is made
        if path.read_bytes().startswith(b"m"):
            return bytearray(3 * 2**30)
        time.sleep(60)
        return None

    for data, reason in ((b"m", "MemoryError"), (b"s", "longer than 0.3 s")):
        seed = Seed("n.txt", data, lambda rng, same, corpus: same)
        hungry = Reader(lambda folder, seed=seed: [seed], read)
        *_, outcome = run.in_workers(hungry, "n", 0, 2, 0, tmp_path / reason)
        assert [reply.startswith(reason) for _, reply in outcome.failures] == [True, True]
        assert reason in (tmp_path / reason / "failures.txt").read_text()
