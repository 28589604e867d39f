"""What a device does: ``python -m deitalk.research.speed.device --device cuda --json FILE``.

The network of recordings of 10 s in each precision, `read_together` of recordings of 1 to 20 s,
`animate` one by one on the device and on one processor core, live voices in messages of 100 ms,
and what crosses between processor and device; each precision's largest difference from the
processor, as a share of a control's range; and batches. The device's name is in the table. Run it
with nothing beside.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from deitalk import LiveAnimator, animate
from deitalk.audio.frames import SAMPLE_RATE, frame_count
from deitalk.emotions import EMOTIONS
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.load import load_network
from deitalk.models.protocol import Reading
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine, speechlike
from deitalk.research.evaluation.report import identified, write_json
from deitalk.research.speed.batch_rate import steady_rate
from deitalk.research.speed.cold_start import environment, spent
from rig.arrays import Float32

PRECISIONS = ("float32", "tf32", "bfloat16")
LINES = (1, 8, 64, 256)
"""Recordings that are read together."""
VOICES = (1, 4, 16, 64, 256, 512, 1024)
MESSAGES, WARM_MESSAGES = 40, 15
MESSAGE_MS = 100
"""Sound of a message, ms: a call for all voices must end before the next."""
Lines = tuple[list[Float32], list[Float32], list[str]]


class Calls(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Counts calls of torch's functions, and bytes that cross to and from a device."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.count = self.crossed = 0

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None):  # type: ignore[no-untyped-def]
        out, self.count = function(*args, **(kwargs or {})), self.count + 1
        if "_to_copy" in str(function) and out.device != args[0].device:
            self.crossed += out.nbytes
        return out


@contextmanager
def precision(name: str, device: str) -> Iterator[None]:
    """Compute in a precision; float32 is that of the processor."""
    matrices, networks = torch.backends.cuda.matmul, torch.backends.cudnn
    before = matrices.allow_tf32, networks.allow_tf32
    matrices.allow_tf32 = networks.allow_tf32 = name == "tf32"
    kind = torch.device(device).type
    try:
        with torch.autocast(kind, torch.bfloat16, enabled=name == "bfloat16"):
            yield
    finally:
        matrices.allow_tf32, networks.allow_tf32 = before


def lines(count: int, shortest: float, longest: float) -> Lines:
    """Recordings of lengths between two, their emotions and no actors."""
    lengths = np.random.default_rng(count).uniform(shortest, longest, count)
    sounds = [speechlike(length, seed=k) for k, length in enumerate(lengths)]
    emotions = np.eye(len(EMOTIONS), dtype=np.float32)
    weights = [emotions[[k % len(EMOTIONS)] * frame_count(len(x))] for k, x in enumerate(sounds)]
    return sounds, weights, [""] * count


def times_real_time(work: Callable[[], object], sounds: list[Float32], runs: int = 3) -> float:
    """Seconds of sound in a second, at best; `work` ends with arrays on the processor."""
    taken = []
    work()
    for _ in range(runs):
        began = time.perf_counter()
        work()
        taken.append(time.perf_counter() - began)
    return sum(map(len, sounds)) / SAMPLE_RATE / min(taken)


def largest(found: list[Reading], expected: list[Reading], model: DEITalk) -> float:
    """Largest difference of curves, as a share of the range of a control."""
    span = model.controls.maximum - model.controls.minimum
    pairs = zip(found, expected, strict=True)
    return max(float((abs(a.emotional - b.emotional) / span).max()) for a, b in pairs)


def live_ms(device: str, backend: str, count: int) -> dict[str, float]:
    """Time of the call that takes the next message of so many voices, ms; torch's calls in it."""
    network: Any = load_network("live", backend=backend, device=device)
    animator = LiveAnimator(network, "happy", streams=count)
    sound, step = speechlike(10), SAMPLE_RATE * MESSAGE_MS // 1000
    wall, spent = [], []
    for place in range(MESSAGES):
        piece = sound[place * step : (place + 1) * step]
        began, used = time.perf_counter(), time.process_time()
        animator.feed([piece] * count if count > 1 else piece)
        wall.append(1e3 * (time.perf_counter() - began))
        spent.append(1e3 * (time.process_time() - used))
    late = wall[WARM_MESSAGES:]
    with Calls() as calls:
        animator.feed([piece] * count if count > 1 else piece)
    return {
        "median_ms": float(np.median(late)),
        "p95_ms": float(np.percentile(late, 95)),
        "processor_ms_of_a_voice": float(np.median(spent[WARM_MESSAGES:])) / count,
        "calls": calls.count,
        "megabytes_crossed": calls.crossed / 1e6,
    }


def batch(device: str, workers: int) -> dict[str, float]:
    """Rate of a batch of recordings of 1 to 20 s, a hundred for each process."""
    with tempfile.TemporaryDirectory() as folder:
        sounds, count = lines(64, 1, 20)[0], 100 * workers
        for place in range(count):
            soundfile.write(f"{folder}/{place:04d}.wav", sounds[place % len(sounds)], SAMPLE_RATE)
        command = ["-m", "deitalk", "batch", folder, "-e", "happy", "-o", f"{folder}/out"]
        command += ["--device", device, "--workers", str(workers)]
        spent(command, environment(folder))
        seconds = sum(map(len, sounds)) / len(sounds) / SAMPLE_RATE
        return {"rate": steady_rate(Path(folder, "out"), seconds)}


def measure(device: str, most: int, say: Callable[[str, Any], None]) -> None:
    """Measure everything, of at most so many recordings or voices."""
    model, here = (
        require_model("default", DEITalk, device=device),
        require_model("default", DEITalk),
    )
    is_cuda = device.startswith("cuda")
    tens, mixed = lines(64 if is_cuda else 4, 10, 10), lines(4, 1, 20)
    expected = here.read_together(*mixed)
    kinds = PRECISIONS if is_cuda else ("float32", "bfloat16")
    for name in kinds:
        with precision(name, device):
            rate = times_real_time(lambda: model.read_together(*tens), tens[0])
            off = largest(model.read_together(*mixed), expected, here)
        say(f"network, {len(tens[0])} recordings of 10 s, {name}", {"rate": rate, "largest": off})
    for count in (count for count in LINES if count <= most):
        given = lines(count, 1, 20)
        rate = times_real_time(lambda: model.read_together(*given), given[0], 2)  # noqa: B023
        with Calls() as calls:
            model.read_together(*given)
        found = {"rate": rate, "calls": calls.count, "megabytes_crossed": calls.crossed / 1e6}
        say(f"read_together of {count} recordings of 1 to 20 s", found)
    sounds = mixed[0]

    def each(network: Any) -> Callable[[], object]:
        return lambda: [animate(x, "happy", model=network, sample_rate=16_000) for x in sounds]

    say("animate one by one", {"rate": times_real_time(each(model), sounds, 1)})
    engine = load_network("default", backend="onnx")
    say("animate on one processor core", {"rate": times_real_time(each(engine), sounds, 1)})
    for workers in (12, 15) if is_cuda else (1, 2):
        say(f"`deitalk batch`, {workers} processes, when all work", batch(device, workers))
    for backend in ("torch", "onnx") if device == "cpu" else ("torch",):
        for count in (count for count in VOICES if count <= most):
            found = live_ms(device, backend, count)
            say(f"live, {count} voices, {backend}", found)
            if found["median_ms"] > MESSAGE_MS:
                break


def main() -> None:
    """Print a line for each measure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--most", type=int, default=1024, help="most recordings and voices")
    parser.add_argument("--json", type=new_file, help="also write the measures to this file")
    given = parser.parse_args()
    torch.set_num_threads(1)
    is_cuda = given.device.startswith("cuda")
    name = torch.cuda.get_device_name(given.device) if is_cuda else given.device
    measures: dict[str, Any] = {}

    def say(title: str, values: dict[str, float]) -> None:
        measures[title] = values
        text = ", ".join(f"{key} {value:.4g}" for key, value in values.items())
        sys.stdout.write(f"{title}: {text}\n")
        sys.stdout.flush()

    measure(given.device, given.most, say)
    known = identified("default") | {"machine": machine(), "device": name, "threads": 1}
    write_json(given.json, known | {"measures": measures})


if __name__ == "__main__":
    main()
