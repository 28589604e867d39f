"""Servers and recordings of the tests of the service."""

import io
import json
import wave

import numpy as np
import pytest

from api.guard.keys import digest_of
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
        max_job_seconds=30,
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
