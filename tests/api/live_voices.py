"""Live voices in real time: ``python -m tests.api.live_voices --voices 16 32``.

Starts the service, opens so many sessions of ``WS /v1/live``, and sends each 100 ms of speech every
100 ms, at phases that differ. Lateness is the time from when the last sound that a frame depends on
was due at the client, to when the client has the frame. The processor time of a voice's frame is
given too, of the server's process, its live workers and the client here: it depends little on what
else the machine does.
"""

import argparse
import asyncio
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from websockets.asyncio.client import ClientConnection, connect

from deitalk import load_audio
from deitalk.research.arguments import new_file
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json
from tests.api.server import Server, processor_seconds, serving, wait_for

SAMPLE = Path(__file__).resolve().parents[2] / "docs/samples/amiable.flac"
RATE, FPS = 16_000, 30
MESSAGE_SECONDS = 0.1
HEAD_BYTES = 16
"""Of a record before its values; its first field is the number of the frame."""
WARM_SECONDS = 3.0
"""Sound of a session that is not counted: its beginning, when all sessions begin."""


@contextmanager
def service(backend: str, workers: int, voices: int) -> Iterator[Server]:
    """A service with this backend for live sessions, whose live workers are ready."""
    given = {
        "live_backend": backend, "live_workers": workers, "live_sessions": 2 * voices,
        "job_workers": 0,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder), **given) as server:
        wait_for(lambda: "live voices are ready" in server.log.read_text())
        yield server


async def opened(port: int) -> tuple[ClientConnection, dict[str, Any]]:
    """A session that takes sound, and its header."""
    address = f"ws://127.0.0.1:{port}/v1/live"
    live = await connect(address, proxy=None, compression=None)
    await live.send(json.dumps({"type": "start", "sample_rate": RATE, "emotion": "happy"}))
    return live, answer(await live.recv())


def answer(message: str | bytes) -> dict[str, Any]:
    """Content of a message in JSON; a problem ends the measurement."""
    content: dict[str, Any] = json.loads(message)
    if content["type"] == "problem":
        raise SystemExit(f"the service ended a session: {content['message']}")
    return content


async def speak(live: ClientConnection, sound: bytes, begin: float, seconds: float) -> None:
    """Send a message when its last sample is due, for some seconds."""
    size = round(2 * RATE * MESSAGE_SECONDS)
    for number in range(round(seconds / MESSAGE_SECONDS)):
        at = number * size % (len(sound) - size)
        await asyncio.sleep(max(begin + (number + 1) * MESSAGE_SECONDS - time.monotonic(), 0))
        await live.send(sound[at : at + size])
    await live.send(json.dumps({"type": "stop"}))


async def lateness(
    live: ClientConnection, header: dict[str, Any], sound: bytes, begin: float, seconds: float
) -> list[float]:
    """Lateness of every frame of a session whose sound begins at a time, ms."""
    late: list[float] = []
    ahead, size = header["lookahead_seconds"], HEAD_BYTES + 4 * len(header["names"])
    sending = asyncio.create_task(speak(live, sound, begin, seconds))
    last = seconds - 2 * MESSAGE_SECONDS - ahead  # later frames do not wait for more sound
    async for message in live:
        now = time.monotonic()
        if isinstance(message, str):
            answer(message)
            break
        for at in range(0, len(message), size):
            spoken = int.from_bytes(message[at : at + 4], "little") / FPS
            if WARM_SECONDS <= spoken < last:
                messages = math.ceil((spoken + ahead) / MESSAGE_SECONDS - 1e-9)
                late.append(1e3 * (now - begin - messages * MESSAGE_SECONDS))
    await sending
    await live.close()
    return late


async def sessions(port: int, count: int, seconds: float) -> np.ndarray:
    """Lateness of all frames of `count` sessions, whose messages are spread over their period."""
    speech = load_audio(SAMPLE).waveform
    sound = (32767 * np.clip(speech, -1, 1)).astype("<i2")
    lives = [await opened(port) for _ in range(count)]
    begin, golden = time.monotonic() + 1, (5**0.5 - 1) / 2
    each = [
        lateness(
            live, header, np.roll(sound, -k * 7919).tobytes(),
            begin + MESSAGE_SECONDS * (k * golden % 1), seconds + WARM_SECONDS,
        )
        for k, (live, header) in enumerate(lives)
    ]  # fmt: skip
    return np.concatenate([np.array(late) for late in await asyncio.gather(*each)])


def _spent(server: Server) -> np.ndarray:
    """Processor seconds of the service's processes, and of the first alone."""
    return np.array([server.processor_seconds, processor_seconds(server.process.pid)])


def measure(backend: str, workers: int, count: int, seconds: float) -> dict[str, Any]:
    """Lateness of so many voices, and what they cost."""
    with service(backend, workers, count) as server:
        before, own = _spent(server), time.process_time()
        late = asyncio.run(sessions(server.address[1], count, seconds))
        client = time.process_time() - own
        whole, alone = _spent(server) - before
    frames = count * (seconds + WARM_SECONDS) * FPS
    return {
        "backend": backend,
        "voices": count,
        "live_workers": workers,
        "frames": len(late),
        "median_ms": float(np.median(late)),
        "p95_ms": float(np.percentile(late, 95)),
        "most_ms": float(late.max()),
        "worker_ms_of_a_frame": 1e3 * (whole - alone) / frames,
        "server_ms_of_a_frame": 1e3 * alone / frames,
        "client_ms_of_a_frame": 1e3 * client / frames,
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """Print a line for each number of voices."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--voices", type=int, nargs="+", default=[16, 32])
    parser.add_argument("--backend", nargs="+", default=["torch", "onnx"], help="torch, onnx")
    parser.add_argument("--workers", type=int, default=min(os.cpu_count() or 1, 4))
    parser.add_argument("--seconds", type=float, default=20, help="of each voice")
    parser.add_argument("--json", type=new_file, help="also write the measures to this file")
    given = parser.parse_args()
    found = []
    for backend in given.backend:
        for count in given.voices:
            found.append(measure(backend, given.workers, count, given.seconds))
            text = ", ".join(
                f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                for key, value in found[-1].items()
            )
            sys.stdout.write(f"{text}\n")
            sys.stdout.flush()
    write_json(given.json, identified("live") | {"machine": machine(), "voices": found})


if __name__ == "__main__":
    main()
