"""Time of a whole `deitalk animate` beside that of ``import torch``.

``python -m deitalk.research.speed.cold_start``.

Processes of their own, with bytecode and exports cached by a first run, in turn; medians of
processor time and of wall time. Run it with nothing beside. ``--json FILE`` writes the medians.
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json

SAMPLE = Path(__file__).resolve().parents[3] / "docs/samples/promise.flac"
RUNS = 7


def spent(arguments: list[str], where: dict[str, str]) -> tuple[float, float]:
    """Processor and wall seconds of one process."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-P", *arguments]
    subprocess.run(command, check=True, capture_output=True, env=where)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def environment(folder: str) -> dict[str, str]:
    """Variables of the environment, with bytecode kept in a folder."""
    return os.environ | {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}


def main() -> None:
    """Print the medians of both."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", type=new_file, help="also write the medians to this file")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        where = environment(folder)
        animate = ["-m", "deitalk", "animate", str(SAMPLE), "-e", "happy", "--force"]
        commands = {"import torch": ["-c", "import torch"]}
        for backend in ("torch", "onnx"):
            for out in ("curves.csv", "take/"):
                name = f"animate --backend {backend} -o {out}"
                commands[name] = [*animate, "--backend", backend, "-o", f"{folder}/{backend}-{out}"]
        for command in commands.values():
            spent(command, where)
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
        for _ in range(RUNS):
            for name, command in commands.items():
                times[name].append(spent(command, where))
    medians = {
        name: [statistics.median(column) for column in zip(*runs, strict=True)]
        for name, runs in times.items()
    }
    unit = medians["import torch"]
    report = {
        name: {
            "processor_seconds": processor,
            "wall_seconds": wall,
            "processor_of_import_torch": processor / unit[0],
            "wall_of_import_torch": wall / unit[1],
        }
        for name, (processor, wall) in medians.items()
    }
    for name, row in report.items():
        sys.stdout.write(f"{name:40s} {row}\n")
    known = identified("default") | {"machine": machine(), "threads": os.cpu_count(), "runs": RUNS}
    write_json(given.json, known | {"commands": report})


if __name__ == "__main__":
    main()
