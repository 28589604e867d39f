"""An S3 server for tests: OpenStack Swift with its S3 interface, all of it on this machine."""

import getpass
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx

from tests.api.server import free_port

KINDS = ("account", "container", "object")
SECONDS = 60
SERVER = """[DEFAULT]
bind_ip = 127.0.0.1
bind_port = {port}
workers = 0
user = {user}
swift_dir = {folder}
devices = {folder}/devices
mount_check = false
disable_fallocate = true
log_level = ERROR
[pipeline:main]
pipeline = {middleware} {kind}-server
[app:{kind}-server]
use = egg:swift#{kind}
account_autocreate = true
[filter:s3api]
use = egg:swift#s3api
[filter:tempauth]
use = egg:swift#tempauth
user_deitalk_tests = secret .admin
"""
"""Of all four servers; those of KINDS keep the data, and the proxy answers S3 requests."""
FILTERS = ("catch_errors", "listing_formats", "bulk", "s3api", "tempauth", "copy", "slo", "dlo")
RING = (
    "[swift-hash]\nswift_hash_path_suffix = tests\n[storage-policy:0]\nname = one\ndefault = yes\n"
)
RINGS = """
import json, sys
from swift.common.ring import RingBuilder
for path, port in json.loads(sys.argv[1]).items():
    ring = RingBuilder(0, 1, 0)
    ring.add_dev({"id": 0, "region": 1, "zone": 1, "weight": 1, "device": "disk", "ip": "127.0.0.1", "port": port})
    ring.rebalance()
    ring.get_ring().save(path)
"""
"""One place for everything; in a process of its own, as Swift changes the modules of sockets."""


@contextmanager
def serving_bucket(folder: Path) -> Iterator[dict[str, str]]:
    """Serve an empty bucket `deitalk`; yield the variables by which AWS's clients find it."""
    programs = Path(sys.executable).parent
    ports = {kind: free_port() for kind in (*KINDS, "proxy")}
    (folder / "devices" / "disk").mkdir(parents=True)
    (folder / "swift.conf").write_text(RING)
    environment = os.environ | {"SWIFT_CONF_DIR": str(folder)}
    places = {str(folder / f"{kind}.ring.gz"): ports[kind] for kind in KINDS}
    command = [sys.executable, "-c", RINGS, json.dumps(places)]
    subprocess.run(command, check=True, env=environment)
    servers = []
    try:
        for kind, port in ports.items():
            made = _configuration(kind, port, folder)
            with (folder / f"{kind}.log").open("wb") as log:
                command = [str(programs / f"swift-{kind}-server"), str(made)]
                servers.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))
        address = f"http://127.0.0.1:{ports['proxy']}"
        _wait(address, folder)
        yield {
            "AWS_ENDPOINT_URL": address,
            "AWS_ACCESS_KEY_ID": "deitalk:tests",
            "AWS_SECRET_ACCESS_KEY": "secret",
            "AWS_DEFAULT_REGION": "us-east-1",
        }
    finally:
        for server in servers:
            server.terminate()
            server.wait()


def _configuration(kind: str, port: int, folder: Path) -> Path:
    middleware = " ".join(FILTERS) if kind == "proxy" else ""
    text = SERVER.format(
        kind=kind, port=port, folder=folder, user=getpass.getuser(), middleware=middleware
    )
    for name in FILTERS if kind == "proxy" else ():
        if f"[filter:{name}]" not in text:
            text += f"[filter:{name}]\nuse = egg:swift#{name}\n"
    path = folder / f"{kind}.conf"
    path.write_text(text)
    return path


def _wait(address: str, folder: Path) -> None:
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        with suppress(httpx.HTTPError):
            if httpx.get(address, trust_env=False).status_code == 404:
                return
        time.sleep(0.1)
    raise AssertionError((folder / "proxy.log").read_text())
