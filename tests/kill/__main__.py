"""``python -m tests.kill --rounds 200 --command train``."""

import argparse
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

from .commands import all_commands
from .rounds import Rounds


def main() -> int:
    """Run the rounds of every given command; return 1 if one failed."""
    commands = all_commands()
    parser = argparse.ArgumentParser(prog="python -m tests.kill", description=__doc__)
    parser.add_argument("--command", action="append", choices=[*commands, "all"], required=True)
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, help="keep failed rounds here")
    given = parser.parse_args()
    names = list(commands) if "all" in given.command else given.command
    # Not a TemporaryDirectory: a forked command would remove it as it ends.
    work = given.work or Path(tempfile.mkdtemp(prefix="kill-"))
    os.environ["DEITALK_CACHE"] = str(work / "cache")
    failed = 0
    for name in names:
        failed += _run(name, Rounds(commands[name], work / name, given.seed), given.rounds)
    if not failed and given.work is None:
        shutil.rmtree(work)
    return int(failed > 0)


def _run(name: str, rounds: Rounds, count: int) -> int:
    """Run and report; return the number of failed rounds."""
    began, failed = time.monotonic(), 0
    for number in range(count):
        try:
            rounds.run(number)
        except AssertionError as error:
            failed += 1
            print(f"{name} round {number}: {error}", flush=True)  # noqa: T201
    counts = ", ".join(f"{count} {what}" for what, count in sorted(rounds.counts.items()))
    print(  # noqa: T201
        f"{name}: {count} rounds in {time.monotonic() - began:.0f} s, one run takes "
        f"{rounds.reference.seconds:.2f} s; {counts}; {failed} failures",
        flush=True,
    )
    return failed


if __name__ == "__main__":
    sys.exit(main())
