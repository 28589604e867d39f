"""A thousand fuzzed inputs of every reader: read, or refused in one line, and never slowly.

``python -m tests.fuzz --count 100000`` is the nightly size, in workers of bounded memory.
"""

import time

import pytest
from fuzz.readers import SLOW, readers
from fuzz.run import attempt, in_process

COUNT = 1000
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


def test_a_reader_that_fails_is_found(tmp_path):
    from fuzz.mutate import mutated
    from fuzz.readers import Reader, Seed

    def read(path):
        return int(path.read_bytes())

    failing = Reader(lambda folder: [Seed("n.txt", b"12345", mutated)], read)
    outcome = in_process(failing, "n", 50, 0, tmp_path)
    assert outcome.failures and outcome.failures[0][1].startswith("ValueError")


def test_a_worker_that_hangs_or_takes_memory_is_ended(tmp_path, monkeypatch):
    pytest.importorskip("resource", reason="limits of memory need Unix")
    from fuzz import run
    from fuzz.mutate import mutated
    from fuzz.readers import Reader, Seed

    calls = []

    def read(path):
        calls.append(path)
        if len(calls) == 2:  # the first call warms up, before the worker is made
            time.sleep(60)
        return bytearray(3 * 2**30)

    monkeypatch.setattr(run, "SECONDS", 0.5)
    hungry = Reader(lambda folder: [Seed("n.txt", b"x", mutated)], lambda path: read(path))
    monkeypatch.setattr(run, "attempt", lambda reader, path: run_attempt(reader, path, calls))
    *_, outcome = run.in_workers(hungry, "n", 0, 2, 0, tmp_path / "keep")
    reasons = [said for _, said in outcome.failures]
    assert len(reasons) == 2 and "longer than 0.5 s" in reasons[0]
    assert (tmp_path / "keep" / "failures.txt").exists()


def run_attempt(reader, path, calls):
    if not calls:
        calls.append(path)
        return ""
    return attempt(reader, path)
