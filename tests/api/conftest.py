"""Servers and recordings of the tests of the service."""

import io
import json
import subprocess
import sys
import time
import wave
from contextlib import suppress

import httpx
import numpy as np
import pytest

from api.guard.keys import digest_of
from tests.api.server import free_port, serving

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
def bucket():
    """A bucket of moto's S3 server, in a process of its own; the variables of AWS name it."""
    for needed in ("s3fs", "moto", "flask"):
        pytest.importorskip(needed, reason="needs s3fs and moto's server (extra test)")
    port = free_port()
    address = f"http://127.0.0.1:{port}"
    given = {
        "AWS_ENDPOINT_URL": address, "AWS_ACCESS_KEY_ID": "tests", "AWS_SECRET_ACCESS_KEY": "tests",
        "AWS_DEFAULT_REGION": "us-east-1",
    }  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-p", str(port)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        with pytest.MonkeyPatch.context() as patch:
            for name, value in given.items():
                patch.setenv(name, value)
            end = time.monotonic() + 60
            while True:
                with suppress(httpx.HTTPError):
                    if httpx.put(f"{address}/deitalk", trust_env=False).is_success:
                        break
                assert time.monotonic() < end and process.poll() is None
                time.sleep(0.1)
            yield "s3://deitalk"
    finally:
        process.terminate()
        process.wait()
