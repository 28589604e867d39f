"""``python -m tests.kill --rounds 200 --command train``."""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def main() -> int:
    """Run the rounds of every command asked for; return 1 if one failed."""
    os.environ["OMP_NUM_THREADS"] = "1"
    from .commands import all_commands
    from .rounds import Rounds

    commands = all_commands()
    parser = argparse.ArgumentParser(prog="python -m tests.kill", description=__doc__)
    parser.add_argument("--command", action="append", choices=[*commands, "all"], required=True)
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, help="keep failed rounds here")
    asked = parser.parse_args()
    names = list(commands) if "all" in asked.command else asked.command
    failed = 0
    with tempfile.TemporaryDirectory() as temporary:
        work = asked.work or Path(temporary)
        os.environ["DEITALK_CACHE"] = str(work / "cache")
        for name in names:
            began = time.monotonic()
            rounds = Rounds(commands[name], work / name, asked.seed)
            for number in range(asked.rounds):
                try:
                    rounds.run(number)
                except AssertionError as error:
                    failed += 1
                    print(f"{name} round {number}: {error}", flush=True)  # noqa: T201
            counts = ", ".join(f"{count} {what}" for what, count in rounds.counts.items())
            seconds = time.monotonic() - began
            print(  # noqa: T201
                f"{name}: {asked.rounds} rounds in {seconds:.0f} s, one takes "
                f"{rounds.reference.seconds:.2f} s; {counts}; {failed} failures so far",
                flush=True,
            )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
