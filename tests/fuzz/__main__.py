"""Fuzz the readers: ``python -m tests.fuzz --count 100000 --reader mesh.glb``."""

import argparse
import multiprocessing
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from .readers import readers
from .run import fuzz_reader


def main() -> int:
    """Fuzz, print one line for each reader; the exit code is 1 if an input failed."""
    known = readers()
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="inputs for each reader")
    parser.add_argument("--reader", action="append", choices=[*known], help="default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", type=int, default=0, help="first input")
    parser.add_argument("--jobs", type=int, default=1, help="readers at once")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"), help="failing inputs")
    given = parser.parse_args()
    tasks = [
        (name, given.start, given.count, given.seed, given.keep) for name in given.reader or known
    ]
    if given.jobs == 1:
        return int(sum(map(fuzz_reader, tasks)) > 0)
    context = multiprocessing.get_context("spawn")
    with context.Pool(given.jobs, maxtasksperchild=1) as pool:
        return int(sum(pool.imap_unordered(fuzz_reader, tasks)) > 0)


if __name__ == "__main__":
    sys.exit(main())
