"""Rate of `deitalk batch` beside its network alone.

``python -m deitalk.research.speed.batch_rate LINES``.

The network hears the recordings of a folder one after the other on one thread; then a batch makes
them with two processes, which counts loading, files and journal. Run it with nothing beside.
``--json FILE`` writes the rates. With `--device cuda --workers 12` the networks are on a GPU.
"""

import argparse
import resource
import sys
import tempfile
from pathlib import Path

import torch

from deitalk import animate, load_audio
from deitalk.models.load import load_network
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json
from deitalk.research.speed.cold_start import environment, spent

WARM_UP = 5


def network_seconds(lines: list[Path]) -> tuple[float, float]:
    """Mean seconds of the network alone for a line, one at a time, and of the lines' sound."""
    torch.set_num_threads(1)
    model, total, sound = load_network("default"), 0.0, 0.0
    for place, path in enumerate(lines):
        recording = load_audio(path)
        sound += len(recording.waveform) / 16_000
        performance = animate(recording, "happy", model=model)
        if place >= WARM_UP:
            total += performance.timings["network"]
    return total / (len(lines) - WARM_UP), sound / len(lines)


def steady_rate(outputs: Path, sound: float) -> float:
    """Seconds of sound a second, between the fifth and the last tenth of the lines."""
    ends = sorted(path.stat().st_mtime for path in outputs.glob("*.csv"))
    first, last = len(ends) // 5, 9 * len(ends) // 10
    return sound * (last - first) / (ends[last] - ends[first])


def main() -> None:
    """Print both, and the share that the batch reaches of the network's rate on each worker."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", help="recordings")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=new_file, help="also write the rates to this file")
    given = parser.parse_args()
    folder = given.folder
    lines = sorted(path for path in Path(folder).iterdir() if path.is_file())
    alone, sound = network_seconds(lines)
    with tempfile.TemporaryDirectory() as out:
        command = ["-m", "deitalk", "batch", folder, "-e", "happy"]
        command += ["--device", given.device, "--workers", str(given.workers), "-o"]
        for name in ("first", "second"):  # the first writes the bytecode
            processor, wall = spent([*command, f"{out}/{name}"], environment(out))
        steady = steady_rate(Path(out) / "second", sound)
    n = len(lines)
    report = {
        "lines": n,
        "seconds_of_a_line": sound,
        "workers": given.workers,
        "device": given.device,
        "network_ms": 1e3 * alone,
        "processor_ms": 1e3 * processor / n,
        "wall_ms": 1e3 * wall / n,
        "share_of_the_network": alone * n / wall / given.workers,
        "times_real_time_when_all_work": steady,
        "largest_process_mb": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024,
    }
    sys.stdout.write(f"{report}\n")
    write_json(given.json, identified("default") | {"machine": machine(), "threads": 1, **report})


if __name__ == "__main__":
    main()
