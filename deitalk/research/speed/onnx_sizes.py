"""Size, time and error of `default` as an ONNX file, in each precision.

``python -m deitalk.research.speed.onnx_sizes``.

A recording of a minute (`docs/samples/amiable.flac`, repeated) becomes finished curves on one
thread; differences from float32 are shares of the ranges of the controls. ``--json FILE`` writes
the table. Run it with nothing beside.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from deitalk import load_audio
from deitalk.emotions import LABELS
from deitalk.export.onnx_file import PRECISIONS, export_onnx
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.postprocess.tracks import N_MOTION, N_VARIANTS
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json
from rig import default_controls

SAMPLE = Path(__file__).resolve().parents[3] / "docs/samples/amiable.flac"
SECONDS, RUNS = 60, 3


def predict(path: Path, inputs: dict[str, np.ndarray]) -> tuple[list[np.ndarray], float]:
    """Outputs of the file, and the least processor seconds of some runs."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    times = []
    for _ in range(RUNS):
        began = time.process_time()
        outputs = session.run(["curves", "predicted"], inputs)
        times.append(time.process_time() - began)
    return outputs, min(times)


def measure(folder: Path, model: str) -> dict[str, dict[str, float]]:
    """Size, time and differences of every precision."""
    frames = 30 * SECONDS
    emotion = np.zeros((frames, len(LABELS)), np.float32)
    emotion[:, LABELS.index("happy")] = 1
    intensity = np.tile(np.array([[-1.0], [1.0], [0.5]], np.float32), (1, frames))
    inputs = {
        "sound": np.resize(load_audio(SAMPLE).waveform, 16_000 * SECONDS),
        "emotion": emotion,
        "intensity": intensity,
        "variants": np.zeros((frames, N_VARIANTS + 1), np.float32),
        "motion": np.zeros((frames, N_MOTION), np.float32),
    }
    controls, plain = default_controls(), None
    table: dict[str, dict[str, float]] = {}
    span = controls.maximum - controls.minimum
    for precision in PRECISIONS:
        path = folder / f"{precision}.onnx"
        export_onnx(require_model(model, DEITalk), path, precision=precision)
        outputs, seconds = predict(path, inputs)
        plain = plain or outputs
        off = np.abs(outputs[0] - plain[0]) / span
        table[precision] = {
            "megabytes": path.stat().st_size / 1e6,
            "processor_seconds_per_second": seconds / SECONDS,
            "largest": float(off.max()),
            "rms": float(np.sqrt(np.square(off).mean())),
            "intensity": float(np.abs(outputs[1] - plain[1]).max()),
        }
        sys.stdout.write(f"{precision}: {table[precision]}\n")
    return table


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--model", default="default", help="name or folder of a Whisper model")
    parser.add_argument("--json", type=new_file, help="also write the table to this file")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        table = measure(Path(folder), given.model)
    known: dict[str, Any] = identified(given.model) | {"machine": machine(), "threads": 1}
    write_json(given.json, known | {"kinds": table})


if __name__ == "__main__":
    main()
