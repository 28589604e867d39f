"""Size, time and error of `default` in int8 by ONNX Runtime.

``python -m deitalk.research.speed.onnx_sizes``.

Dynamic quantisation of the weights by `onnxruntime.quantization.quantize_dynamic` on the layers
named, one scale a channel. A recording of a minute (`docs/samples/amiable.flac`, repeated) is
predicted on one thread; differences from float32 are shares of the ranges of the controls. ``--json
FILE`` writes the table. Run it with nothing beside.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from deitalk import load_audio
from deitalk.audio.voice_activity import normalise_level
from deitalk.export.onnx_file import export_onnx
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json
from rig import default_controls

SAMPLE = Path(__file__).resolve().parents[3] / "docs/samples/amiable.flac"
SECONDS, RUNS = 60, 3
KINDS = {
    "float32": (),
    "int8 feed-forward layers": ("fc1", "fc2"),
    "int8 linear layers of the encoder": ("fc1", "fc2", "q_proj", "k_proj", "v_proj", "out_proj"),
}
"""Names of the layers that are int8."""


def predict(path: Path, inputs: dict[str, np.ndarray]) -> tuple[list[np.ndarray], float]:
    """Outputs of the file, and the least processor seconds of some runs."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    times = []
    for _ in range(RUNS):
        began = time.process_time()
        outputs = session.run(["curves", "intensity"], inputs)
        times.append(time.process_time() - began)
    return outputs, min(times)


def measure(folder: Path, model: str) -> dict[str, dict[str, float]]:
    """Size, time and differences of every kind."""
    import onnx
    from onnxruntime.quantization import QuantType, quantize_dynamic

    sound = normalise_level(np.resize(load_audio(SAMPLE).waveform, 16_000 * SECONDS))
    frames = 30 * SECONDS
    emotion = np.zeros((frames, 5), np.float32)
    emotion[:, 2] = 1
    place = (np.arange(frames) / frames).astype(np.float32)
    peak = np.array(-10, np.float32)
    inputs = {"sound": sound, "emotion": emotion, "place": place, "peak": peak}
    controls, table, plain = default_controls(), {}, None
    span = controls.maximum - controls.minimum
    whole = folder / "float32.onnx"
    export_onnx(require_model(model, DEITalk), whole)
    nodes = [node.name for node in onnx.load(str(whole)).graph.node]
    for name, layers in KINDS.items():
        path = whole if not layers else folder / f"{len(layers)}.onnx"
        if layers:
            others = [node for node in nodes if not any(layer in node for layer in layers)]
            quantize_dynamic(
                whole,
                path,
                op_types_to_quantize=["MatMul", "Gemm"],
                per_channel=True,
                nodes_to_exclude=others,
                weight_type=QuantType.QUInt8,  # saturates nowhere on processors without VNNI
            )
        outputs, seconds = predict(path, inputs)
        plain = plain or outputs
        off = np.abs(outputs[0] - plain[0]) / span
        table[name] = {
            "megabytes": path.stat().st_size / 1e6,
            "processor_seconds_per_second": seconds / SECONDS,
            "largest": float(off.max()),
            "rms": float(np.sqrt(np.square(off).mean())),
            "intensity": float(np.abs(outputs[1] - plain[1]).max()),
        }
        sys.stdout.write(f"{name}: {table[name]}\n")
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
