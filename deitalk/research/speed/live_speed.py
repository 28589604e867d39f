"""Time of live frames on this machine: ``python -m deitalk.research.speed.live_speed --json FILE``.

One voice in blocks of 10 ms, and twenty in one call, on one core, by torch and by ONNX Runtime; and
the exported file of one voice, one frame and several a run. Run it with nothing beside.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deitalk import LiveAnimator, load_audio
from deitalk.export.onnx_file import export_onnx
from deitalk.models.causal_model import causal_frontend
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json

SAMPLE = Path(__file__).resolve().parents[3] / "docs/samples/amiable.flac"
BLOCK, FIRST_FRAMES, SECONDS, VOICES = 160, 30, 30.0, 20
RUNS = 60
"""Runs of the exported file, after a first one."""


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


def exported_file() -> dict[str, float]:
    """Median processor milliseconds of a frame of the file for other programs, by frames a run.

    As many as a site reads in a run (`deitalk.preview.site`) and one, in turn.
    """
    import onnxruntime

    model, options = require_model("live", DEITalk), onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    counts = 1, causal_frontend(model).delay
    spent: dict[int, list[float]] = {count: [] for count in counts}
    sessions = {}
    with tempfile.TemporaryDirectory() as folder:
        for count in counts:
            path = Path(folder, "live.onnx")
            export_onnx(model, path, precision="float16", n_frames=count)
            sessions[count] = onnxruntime.InferenceSession(path, options)
    for _ in range(1 + RUNS):
        for count, session in sessions.items():
            shapes = {one.name: [1, *one.shape[1:]] for one in session.get_inputs()}
            given = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
            began = time.process_time()
            session.run(None, given)
            spent[count].append(1e3 * (time.process_time() - began) / count)
    return {f"{count} a run": float(np.median(each[1:])) for count, each in spent.items()}


def main() -> None:
    """Print both of either backend, and the file's."""
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
    report["file_ms_of_a_frame"] = exported_file()
    sys.stdout.write(f"exported file, ms of a frame: {report['file_ms_of_a_frame']}\n")
    write_json(given.json, report)


if __name__ == "__main__":
    main()
