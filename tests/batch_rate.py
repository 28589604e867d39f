"""Rate of `deitalk batch` beside its network alone: ``python -m tests.batch_rate LINES``.

The network hears the recordings of a folder one after the other on one thread; then a batch makes them
with two processes, which counts loading, files and journal. Run it with nothing beside.
"""

import sys
import tempfile
from pathlib import Path

import torch

from deitalk import animate, load_audio, load_model
from tests.cold_start import environment, spent

WARM_UP = 5


def network_seconds(lines: list[Path]) -> float:
    """Mean seconds of the network alone for a line, one at a time."""
    torch.set_num_threads(1)
    model, total = load_model(), 0.0
    for place, path in enumerate(lines):
        performance = animate(load_audio(path), "happy", model=model)
        if place >= WARM_UP:
            total += performance.timings["network"]
    return total / (len(lines) - WARM_UP)


def main(folder: str) -> None:
    """Print both, and the share of twice the single rate that the batch reaches."""
    lines = sorted(path for path in Path(folder).iterdir() if path.is_file())
    alone = network_seconds(lines)
    with tempfile.TemporaryDirectory() as out:
        command = ["-m", "deitalk", "batch", folder, "-e", "happy", "--workers", "2", "-o"]
        for name in ("first", "second"):  # the first writes the bytecode
            processor, wall = spent([*command, f"{out}/{name}"], environment(out))
    n = len(lines)
    sys.stdout.write(
        f"{n} lines: network alone {1e3 * alone:.0f} ms a line; batch {1e3 * processor / n:.0f} ms "
        f"of a core and {1e3 * wall / n:.0f} ms a line, {alone * n / wall / 2:.0%} of twice the rate "
        "of the network\n"
    )


if __name__ == "__main__":
    main(sys.argv[1])
