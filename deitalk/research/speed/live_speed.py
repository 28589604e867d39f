"""Time of live frames on this machine: ``python -m deitalk.research.speed.live_speed --json FILE``.

One voice in blocks of 10 ms, and twenty in one call, on one core, by torch and by ONNX Runtime. Run
it with nothing beside.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deitalk import LiveAnimator, load_audio
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json

SAMPLE = Path(__file__).resolve().parents[3] / "docs/samples/amiable.flac"
BLOCK, FIRST_FRAMES, SECONDS, VOICES = 160, 30, 30.0, 20


def one_voice(sound: np.ndarray, backend: str) -> np.ndarray:
    """Milliseconds of computing of every frame after the first second."""
    animator = LiveAnimator("live", emotion="happy", sample_rate=16_000, backend=backend)
    spent: list[float] = []
    for start in range(0, len(sound), BLOCK):
        began = time.perf_counter()
        frames = animator.feed(sound[start : start + BLOCK])
        if len(frames):
            spent.append(1e3 * (time.perf_counter() - began) / len(frames))
    return np.array(spent[FIRST_FRAMES:])


def many_voices(sound: np.ndarray, count: int, backend: str) -> float:
    """Share of a core that `count` voices take."""
    animator = LiveAnimator("live", emotion="happy", streams=count, backend=backend)
    began = time.perf_counter()
    for start in range(0, len(sound), 533):
        animator.feed([sound[start : start + 533]] * count)
    return (time.perf_counter() - began) * 16_000 / len(sound)


def main() -> None:
    """Print both of either backend."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", type=new_file, help="also write the times to this file")
    given = parser.parse_args()
    torch.set_num_threads(1)
    waveform = load_audio(SAMPLE).waveform
    sound = np.resize(waveform, int(16_000 * SECONDS))
    report: dict[str, Any] = identified("live") | {
        "machine": machine(),
        "threads": 1,
        "backends": {},
    }
    for backend in ("torch", "onnx"):
        spent = one_voice(sound, backend)
        found = {
            "median_ms": float(np.median(spent)),
            "p99_ms": float(np.percentile(spent, 99)),
            "voices": VOICES,
            "cores_of_the_voices": many_voices(sound, VOICES, backend),
        }
        report["backends"][backend] = found
        sys.stdout.write(f"{backend}: {found}\n")
    write_json(given.json, report)


if __name__ == "__main__":
    main()
