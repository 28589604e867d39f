"""Binary frames of `WS /v1/live` for the samples of a file: python live_client.py speech.raw."""

import json
import sys

import numpy as np
from websockets.sync.client import connect

URL = "ws://127.0.0.1:8000/v1/live"


def frames(url: str, samples: bytes) -> "list[tuple[float, dict[str, float]]]":
    """Return the time and the curves of every frame of 16-bit samples at 16 kHz, mono."""
    given = []
    with connect(url, proxy=None) as live:
        live.send(json.dumps({"type": "start", "sample_rate": 16000}))
        names = json.loads(live.recv())["names"]
        values = ("values", "<f4", len(names))
        record = np.dtype([("index", "<u4"), ("late", "<f4"), ("time", "<f8"), values])
        live.send(samples)
        live.send(json.dumps({"type": "stop"}))
        while isinstance(message := live.recv(), bytes):
            for frame in np.frombuffer(message, record):
                given.append((float(frame["time"]), dict(zip(names, frame["values"], strict=True))))
    return given


if __name__ == "__main__":
    with open(sys.argv[1], "rb") as file:
        for time, curves in frames(URL, file.read()):
            sys.stdout.write(f"{time:.3f} {curves['CTRL_C_jaw.ty']:.3f}\n")
