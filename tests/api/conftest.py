"""Servers and recordings of the tests of the service."""

import io
import json
import os
import threading
import wave
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
import pytest
import sqlalchemy as sql
import torch

from api.guard.keys import digest_of
from deitalk.config.curves import Config
from deitalk.models.checkpoint import save_model
from deitalk.models.curve_model import DEITalk
from tests.api.bucket import serving_bucket
from tests.api.database import programs, serving_postgres
from tests.api.server import Server, serving, start, stop
from tests.deitalk.live.conftest import TINY

LIMITS = {
    "farm": {"jobs": 1},
    "viewer": {"scopes": ["animate"]},
    "slow": {"scopes": ["animate"], "requests_per_minute": 10},
    "anna": {},
    "bert": {"concurrent": 2},
    "carl": {"live": 1},
    "dora": {},
    "emil": {},
    "finn": {"audio_seconds_per_hour": 5},
}
"""What a key may not, of all that a key may."""
KEYS = {name: f"dk_{name}-key-of-the-tests" for name in LIMITS}


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


@pytest.fixture(scope="session", autouse=True)
def _opened_once(opened_once):
    """Graphs and the model of phones are opened once in a process."""


@pytest.fixture(scope="session")
def tiny_model(tmp_path_factory):
    """Folder of a small causal model of random weights with two actors."""
    torch.manual_seed(0)
    config = Config.model_validate({"model": TINY | {"actors": ["anna", "eve"]}})
    network = DEITalk(config.model, rules=config.rules)
    with torch.no_grad():
        network.decoder.output.weight.normal_(0, 0.3)
        network.decoder.style.weight.normal_(0, 1.0)
    folder = tmp_path_factory.mktemp("causal") / "tiny"
    save_model(folder, network, config, {})
    return folder


@pytest.fixture(scope="session")
def server(tmp_path_factory, tiny_model):
    """One server without keys, on loopback, which knows the small model too."""
    with serving(
        tmp_path_factory.mktemp("service"),
        models=json.dumps({"tiny": str(tiny_model)}),
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
    """A server of one worker, eight places, and the keys of `LIMITS`."""
    keys = [
        {"name": name, "sha256": digest_of(KEYS[name]), "requests_per_minute": 100_000,
         "scopes": ["animate", "jobs", "live", "metrics"]} | limits
        for name, limits in LIMITS.items()
    ]  # fmt: skip
    with serving(
        tmp_path_factory.mktemp("keyed"), keys=json.dumps(keys), waiting=7, connections=40,
        log="json", live_sessions=2,
    ) as running:  # fmt: skip
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
    """Notes what it is sent."""

    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.calls.append((dict(self.headers), body))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *given):
        pass


@contextmanager
def receiving():
    with ThreadingHTTPServer(("127.0.0.1", 0), Receiver) as made:
        made.calls = []
        threading.Thread(target=made.serve_forever, daemon=True).start()
        yield made
        made.shutdown()


@pytest.fixture(scope="session")
def postgres():
    """URL of an empty database."""
    if programs() is None:
        pytest.skip("needs PostgreSQL (Debian's package postgresql)")
    with serving_postgres() as url:
        yield url


class Observed(NamedTuple):
    """A server, and the receiver of its spans."""

    server: Server
    spans: ThreadingHTTPServer


@pytest.fixture(scope="session")
def observed(tmp_path_factory, request):
    """Its jobs are in PostgreSQL where that is installed."""
    database = {}
    if programs() is not None:
        url = request.getfixturevalue("postgres")
        engine = sql.create_engine(url, isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.execute(sql.text("CREATE DATABASE service"))
        engine.dispose()
        database = {"database": url.removesuffix("postgres") + "service"}
    key = {"name": "farm", "sha256": digest_of(KEYS["farm"])}
    with receiving() as spans:
        with pytest.MonkeyPatch.context() as patch:
            with suppress(ModuleNotFoundError):
                if find_spec("opentelemetry.exporter.otlp.proto.http"):
                    collector = f"http://127.0.0.1:{spans.server_port}"
                    patch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", collector)
            patch.setenv("OTEL_EXPORTER_OTLP_COMPRESSION", "none")
            patch.setenv("OTEL_BSP_SCHEDULE_DELAY", "200")
            running = start(
                tmp_path_factory.mktemp("observed"), keys=json.dumps([key]),
                live_sessions=0, lease_seconds=1.0, **database,
            )  # fmt: skip
        try:
            yield Observed(running, spans)
        finally:
            stop(running)
