"""Recordings that the service animates in a second, for 1, 4, 16 and 64 clients without pause.

::

    python -m tests.api.throughput                 # a server with a worker for each processor
    python -m tests.api.throughput --together      # one network for several recordings in one call
"""

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

from deitalk.acting import Acting
from tests.api.conftest import wav
from tests.api.load import at_once, say
from tests.api.server import serving

CLIENTS = (1, 4, 16, 64)
REQUESTS = 64
SECONDS = 10.0
"""Of a recording of `tests.api.load`."""


def clients() -> None:
    """Print rate and times for each number of clients."""
    settings = {"workers": os.cpu_count(), "requests_per_minute": 1_000_000, "waiting": 64}
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder), **settings) as server:
        at_once(server, 4, 2)
        for count in CLIENTS:
            began = time.perf_counter()
            times = at_once(server, count, REQUESTS // count)
            rate = len(times) / (time.perf_counter() - began)
            late = times[int(0.95 * len(times))]
            say(
                f"{count} clients: {rate:.1f} requests/s, {rate * SECONDS:.0f} x real time, median "
                f"{statistics.median(times):.0f} ms, 95th percentile {late:.0f} ms"
            )


def together() -> None:
    """Print processor time of a recording: the whole request, the network alone, and in groups."""
    import torch

    from api.compute.warm import models
    from deitalk.audio.load import load_audio
    from deitalk.pipeline.curves import prepare

    torch.set_num_threads(1)
    network = models["default"]
    for seconds in (2.0, 3.0, 10.0):
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "speech.wav").write_bytes(wav(seconds))
            recording = load_audio(Path(folder) / "speech.wav")
        say(
            f"{seconds:g} s: {costs(network, partial(prepare, recording, Acting(), lambda: network))}"
        )


def costs(network: Any, prepare: Callable[[], Any]) -> str:
    """Processor time of a recording, ms."""
    from deitalk.pipeline.curves import finish

    ready = prepare()
    sound, weights = ready.inputs
    whole = least_ms(lambda: finish(prepare(), ready.read()))
    text = f"whole {whole:.0f} ms, network alone {least_ms(ready.read):.0f}"
    for count in (2, 4, 8):
        group = [count * [part] for part in (sound * ready.speech.gain, weights, ready.style)]
        took = least_ms(partial(network.read_together, *group)) / count
        text += f", {count} together {took:.0f} each"
    return text


def least_ms(work: Callable[[], object]) -> float:
    """Least processor time of three calls."""
    spent = []
    for _ in range(4):
        began = time.process_time()
        work()
        spent.append(1000 * (time.process_time() - began))
    return min(spent[1:])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.api.throughput")
    parser.add_argument("--together", action="store_true")
    (together if parser.parse_args().together else clients)()
