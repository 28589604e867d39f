"""Time per stage, real-time factor and memory of the curve model: ``evaluate --speed``.

All numbers are measured in one run on this machine. RTF is the time over the clip's duration.
Memory is measured in a separate process, because a peak never falls.
"""

import json
import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.audio.frames import SAMPLE_RATE
from rig.arrays import Float32

TABLE_4_SECONDS = 5.1
"""Length of the clip of SDFA's Table 4 (there: 5,095 ms of audio, animated at 60 fps)."""
TABLE_4_MILLISECONDS = {"audio": 553.92, "audio feature": 4200.69, "animation feature": 545.03}
"""Published for SDFA on an i7-8700K with another output; no ratio is printed."""


def speechlike(seconds: float, seed: int = 0) -> Float32:
    """Noise with the spectrum and the rhythm of speech: syllables at 4 Hz, pauses.

    One minute is made and repeated, so that long clips are made quickly.
    """
    rng = np.random.default_rng(seed)
    n = int(seconds * SAMPLE_RATE)
    times = np.arange(min(n, 60 * SAMPLE_RATE)) / SAMPLE_RATE
    tone = np.sin(2 * np.pi * np.cumsum(120 + 20 * np.sin(2 * np.pi * 0.7 * times)) / SAMPLE_RATE)
    noise = rng.standard_normal(len(times))
    rhythm = np.maximum(np.sin(2 * np.pi * 4 * times), 0) * (
        np.sin(2 * np.pi * 0.23 * times) > -0.8
    )
    minute = (0.1 * rhythm * (tone + 0.2 * noise)).astype(np.float32)
    return np.resize(minute, n)


def measure(model: str, seconds: float, threads: int, repeats: int) -> dict[str, Any]:
    """Time of every stage of animating one clip: the best of several runs, after loading.

    Returns
    -------
    dict
        Seconds of every stage, their sum, and RTF (sum over the clip's seconds); wall and CPU.
    """
    import torch

    from deitalk.audio.load import Recording
    from deitalk.models.checkpoint import require_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.pipeline.curves import animate

    torch.set_num_threads(threads)
    network = require_model(model, DEITalk)
    recording = Recording(speechlike(seconds), "speechlike noise", SAMPLE_RATE, 1, 0.0, ())
    animate(recording, "happy", model=network)
    runs: list[dict[str, Any]] = []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        performance = animate(recording, "happy", model=network)
        runs.append(
            {
                "wall_seconds": time.perf_counter() - wall,
                "cpu_seconds": time.process_time() - cpu,
                "stages": performance.timings,
            }
        )
    best = min(runs, key=lambda run: run["cpu_seconds"])
    return {
        "clip_seconds": seconds,
        "threads": threads,
        **best,
        "rtf_cpu": best["cpu_seconds"] / seconds,
        "rtf_wall": best["wall_seconds"] / seconds,
    }


def peak_memory(model: str, seconds: float) -> dict[str, float]:
    """Peak memory of a process that animates one long clip, in MB, and its seconds."""
    script = (
        "import json, sys, time\n"
        "from deitalk.research.evaluation.benchmark_curves import peak_megabytes, speechlike\n"
        "from deitalk.pipeline.curves import animate\n"
        "from deitalk.audio.load import Recording\n"
        "from deitalk.models.checkpoint import load_model\n"
        "network = load_model(sys.argv[1])\n"
        "recording = Recording(speechlike(float(sys.argv[2])), 'noise', 16000, 1, 0.0, ())\n"
        "began = time.perf_counter()\n"
        "animate(recording, 'happy', model=network)\n"
        "print(json.dumps({'megabytes': peak_megabytes(),"
        " 'wall_seconds': time.perf_counter() - began}))\n"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", script, model, str(seconds)],
        capture_output=True,
        text=True,
        check=True,
    )
    result: dict[str, float] = json.loads(done.stdout)
    return {"clip_seconds": seconds, **result}


def peak_megabytes() -> float:
    """Highest resident memory of this process so far, MB.

    On Linux from the kernel's high-water mark: `getrusage` includes memory of the parent process.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        (line,) = (row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
        return int(line.split()[1]) / 1024
    import resource

    unit = 1024**2 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def machine() -> dict[str, Any]:
    """Machine and versions of the measurement."""
    import torch

    return {
        "python": platform.python_version(),
        "torch": torch.__version__,
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
    }


def _processor() -> str:
    """Name of the processor."""
    known = Path("/proc/cpuinfo")
    if known.is_file() and (found := re.search(r"model name\s*:\s*(.+)", known.read_text())):
        return found[1].strip()
    return platform.processor() or platform.machine()
