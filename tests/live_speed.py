"""Time of live frames on this machine: ``python -m tests.live_speed [onnx]``.

One voice in blocks of 10 ms, and twenty in one call, on one core. Run it with nothing beside.
"""

import sys
import time
from pathlib import Path

import numpy as np
import torch

from deitalk import LiveAnimator, load_audio

SAMPLE = Path(__file__).resolve().parents[1] / "docs/samples/amiable.flac"
BLOCK, FIRST_FRAMES, SECONDS = 160, 30, 30.0


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
    """Print both."""
    torch.set_num_threads(1)
    waveform = load_audio(SAMPLE).waveform
    sound = np.resize(waveform, int(16_000 * SECONDS))
    backend = "onnx" if "onnx" in sys.argv[1:] else "torch"
    spent = one_voice(sound, backend)
    sys.stdout.write(
        f"one voice: median {np.median(spent):.1f} ms, p99 {np.percentile(spent, 99):.1f} ms a frame\n"
        f"20 voices: {many_voices(sound, 20, backend):.2f} of a core\n"
    )


if __name__ == "__main__":
    main()
