"""Servers and recordings of the tests of the service."""

import io
import json
import os
import threading
import wave
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from api.guard.keys import digest_of
from tests.api.bucket import serving_bucket
from tests.api.server import serving

KEYS = {
    "farm": "dk_farm-key-of-the-tests",
    "viewer": "dk_viewer-key-of-the-tests",
    "slow": "dk_slow-key-of-the-tests",
}
SCOPES = {
    "farm": ["animate", "jobs", "live", "metrics"],
    "viewer": ["animate"],
    "slow": ["animate"],
}


def wav(seconds: float = 1.0, rate: int = 16000, channels: int = 1) -> bytes:
    """A buzz with the rhythm of syllables, as WAV."""
    times = np.arange(round(seconds * rate)) / rate
    sound = 0.3 * np.sign(np.sin(2 * np.pi * 120 * times)) * (np.sin(2 * np.pi * 4 * times) > 0)
    pcm = np.repeat((sound * 32767).astype("<i2"), channels)
    buffer = io.BytesIO()
    with wave.open(buffer, "wb") as file:
        file.setparams((channels, 2, rate, 0, "NONE", "NONE"))
        file.writeframes(pcm.tobytes())
    return buffer.getvalue()


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """One server without keys, on loopback."""
    with serving(
        tmp_path_factory.mktemp("service"),
        max_seconds=4,
        max_job_seconds=70,
        max_bytes=4_000_000,
        requests_per_minute=60_000,
        max_pixels=30 * 960 * 720,
        body_seconds=3,
        header_seconds=2,
        live_seconds=20,
    ) as running:
        yield running


@pytest.fixture
def client(server):
    with server.client() as session:
        yield session


@pytest.fixture(scope="session")
def keyed_server(tmp_path_factory):
    """A server with three keys."""
    keys = [
        {
            "name": name,
            "sha256": digest_of(key),
            "scopes": SCOPES[name],
            "requests_per_minute": 10 if name == "slow" else 10_000,
            "jobs": 1,
        }
        for name, key in KEYS.items()
    ]
    with serving(tmp_path_factory.mktemp("keyed"), keys=json.dumps(keys)) as running:
        yield running


def bearer(name: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {KEYS[name]}"}


@pytest.fixture(scope="session")
def bucket(tmp_path_factory):
    """URL of an empty bucket of a real S3 server; the variables of AWS name the server."""
    for needed in ("s3fs", "swift"):
        pytest.importorskip(needed, reason=f"needs {needed} (extra test)")
    folder = tmp_path_factory.mktemp("swift")
    try:
        os.setxattr(folder, "user.deitalk", b"1")
    except OSError:
        pytest.skip("OpenStack Swift needs a file system with extended attributes")
    with serving_bucket(folder) as variables, pytest.MonkeyPatch.context() as patch:
        for name, value in variables.items():
            patch.setenv(name, value)
        s3fs = pytest.importorskip("s3fs")
        s3fs.S3FileSystem().mkdir("deitalk")
        yield "s3://deitalk"


class Receiver(BaseHTTPRequestHandler):
    """Notes what it is sent; ``/slow`` answers a byte a second, to the end of the test."""

    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.calls.append((dict(self.headers), body))
        if self.path == "/slow":
            with suppress(OSError):
                while not self.server.ended.wait(1):
                    self.wfile.write(b"H")
            return
        self.send_response(204)
        self.end_headers()

    def log_message(self, *given):
        pass


@pytest.fixture
def receiver():
    with ThreadingHTTPServer(("127.0.0.1", 0), Receiver) as made:
        made.calls, made.ended = [], threading.Event()
        threading.Thread(target=made.serve_forever, daemon=True).start()
        yield made
        made.ended.set()
        made.shutdown()
