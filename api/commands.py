"""Commands of the service, for `deitalk.cli.serve`."""

import json
import logging
import logging.config
import os
import socket
import sys
from pathlib import Path
from typing import Any, cast

import uvicorn
from pydantic import ValidationError

from api.app import create_app
from api.guard.keys import new_key
from api.guard.middleware import HEADER_BYTES
from api.guard.protocol import GuardedProtocol
from api.settings import ApiKey, Settings, load_settings
from deitalk import __version__
from deitalk.errors import ConfigError
from rig.errors import quoted
from rig.files import atomic_write

LIVE_MESSAGE_BYTES = 1 << 20
KEEP_ALIVE_SECONDS = 10


def serve(file: Path | None, **given: Any) -> None:
    """Print the settings and serve until SIGINT or SIGTERM.

    Raises
    ------
    ConfigError
        If a setting is wrong.
    """
    settings = load_settings(file, **given)
    app = create_app(settings)
    say = sys.stderr.write
    say(f"deitalk {__version__}\n" + "".join(f"  {line}\n" for line in settings.lines()))
    _log_to_stderr()
    _check_port(settings)
    server = uvicorn.Server(server_config(app, settings))
    server.run()
    if not server.started:
        raise ConfigError(f"the service did not start on {settings.host} port {settings.port}")


def server_config(app: Any, settings: Settings) -> uvicorn.Config:
    """Return uvicorn's configuration: limits of headers, connections and messages."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=GuardedProtocol.limited(settings.header_seconds),
        ws="websockets-sansio",
        ws_max_size=LIVE_MESSAGE_BYTES,
        h11_max_incomplete_event_size=HEADER_BYTES,
        limit_concurrency=settings.connections,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=10,
        access_log=False,
        log_config=None,
        server_header=False,
        proxy_headers=False,
    )


def write_openapi(out: Path) -> None:
    """Write the schema of the default settings as JSON."""
    schema = create_app(Settings.model_construct(**_defaults())).openapi()
    with atomic_write(out) as beside:
        beside.write_text(json.dumps(schema, indent=1) + "\n", encoding="utf-8")


def print_new_key(name: str, scopes: str, per_minute: int) -> None:
    """Print a key, and its entry for the settings.

    Raises
    ------
    ConfigError
        If the name or a scope is wrong.
    """
    key, digest = new_key()
    try:
        entry = ApiKey(
            name=name,
            sha256=digest,
            scopes=cast(Any, tuple(scope.strip() for scope in scopes.split(","))),
            requests_per_minute=per_minute,
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(f"{first['loc'][0]} {quoted(first['input'])}: {first['msg']}") from None
    sys.stdout.write(
        f"{key}\n\nkeys:\n  - name: {entry.name}\n    sha256: {entry.sha256}\n"
        f"    scopes: [{', '.join(entry.scopes)}]\n"
        f"    requests_per_minute: {entry.requests_per_minute}\n"
    )


def _defaults() -> dict[str, Any]:
    return {name: field.get_default(call_default_factory=True)
            for name, field in Settings.model_fields.items()}  # fmt: skip


def _check_port(settings: Settings) -> None:
    """Refuse a port that is taken, before the workers start."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((settings.host, settings.port))
        except OSError as error:
            raise ConfigError(
                f"port {settings.port} of {settings.host}: {os.strerror(error.errno or 0)}; give "
                "another `port`", parameter="port",
            ) from None  # fmt: skip


def _log_to_stderr() -> None:
    logging.config.dictConfig({
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"line": {"format": "%(asctime)s %(levelname)s %(message)s"}},
        "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "line"}},
        "loggers": {
            "deitalk.service": {"handlers": ["stderr"], "level": "INFO", "propagate": False},
            "uvicorn": {"handlers": ["stderr"], "level": "WARNING", "propagate": False},
        },
    })  # fmt: skip
