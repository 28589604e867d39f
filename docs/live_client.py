"""Curves of `WS /v1/live` for a recording, while it is sent: python live_client.py speech.wav.

Needs numpy, soundfile and websockets. The sound goes out at the pace of speech, or with --fast as
quickly as the service takes it.
"""

import argparse
import json
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import soundfile
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

URL = "ws://127.0.0.1:8000/v1/live"
CHUNK_SECONDS = 0.1


def frames(
    url: str, recording: str, key: str = "", *, is_fast: bool = False
) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield the time and the curves of every frame of a recording, as they come."""
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    with (
        soundfile.SoundFile(recording) as sound,
        connect(url, additional_headers=headers, proxy=None) as live,
    ):
        live.send(json.dumps({"type": "start", "sample_rate": sound.samplerate}))
        names = answer(live.recv())["names"]
        values = ("values", "<f4", len(names))
        record = np.dtype([("index", "<u4"), ("late", "<f4"), ("time", "<f8"), values])
        threading.Thread(target=send, args=(live, sound, is_fast), daemon=True).start()
        while isinstance(message := live.recv(), bytes):
            for frame in np.frombuffer(message, record):
                yield float(frame["time"]), dict(zip(names, frame["values"], strict=True))
        answer(message)


def send(live: ClientConnection, sound: soundfile.SoundFile, is_fast: bool) -> None:
    """Send a recording in chunks; `live.send` waits while the service takes no more."""
    began, count = time.monotonic(), round(CHUNK_SECONDS * sound.samplerate)
    with suppress(ConnectionClosed):  # the receiving side has the reason
        for number, block in enumerate(sound.blocks(count, dtype="float32", always_2d=True), 1):
            mono = np.clip(block.mean(axis=1), -1, 1)
            live.send((mono * 32767).astype("<i2").tobytes())
            if not is_fast:
                time.sleep(max(began + number * CHUNK_SECONDS - time.monotonic(), 0))
        live.send(json.dumps({"type": "stop"}))


def answer(text: str | bytes) -> dict:
    """Return a message in JSON; RuntimeError for a problem."""
    message = json.loads(text)
    if message["type"] == "problem":
        raise RuntimeError(message["message"])
    return message


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", help="WAV, FLAC, Ogg or MP3")
    parser.add_argument("--url", default=URL)
    parser.add_argument("--key", default="", help="where the service needs one")
    parser.add_argument("--fast", action="store_true", help="as quickly as the service takes it")
    given = parser.parse_args()
    for at, curves in frames(given.url, given.recording, given.key, is_fast=given.fast):
        sys.stdout.write(f"{at:.3f} {curves['CTRL_C_jaw.ty']:.3f}\n")
