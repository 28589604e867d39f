"""The running server: uvicorn with limits of headers, connections and messages, and its log."""

import logging.config
import os
import socket
import sys
from typing import Any

import uvicorn

from api.app import create_app
from api.guard.middleware import HEADER_BYTES
from api.guard.protocol import GuardedProtocol
from api.settings import Settings
from deitalk import __version__
from deitalk.errors import ConfigError

LIVE_MESSAGE_BYTES = 1 << 20
KEEP_ALIVE_SECONDS = 10


def run(settings: Settings) -> None:
    """Print the settings and serve until SIGINT or SIGTERM.

    Raises
    ------
    ConfigError
        If a setting is wrong or the port is taken.
    """
    app = create_app(settings)
    print_settings(settings)
    log_to_stderr()
    check_port(settings)
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
        ws_per_message_deflate=False,  # a kilobyte could stand for a megabyte
        h11_max_incomplete_event_size=HEADER_BYTES,
        limit_concurrency=settings.connections,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=10,
        access_log=False,
        log_config=None,
        server_header=False,
        proxy_headers=False,
    )


def print_settings(settings: Settings) -> None:
    """Print the version and one line for each setting."""
    lines = "".join(f"  {line}\n" for line in settings.lines())
    sys.stderr.write(f"deitalk {__version__}\n{lines}")


def check_port(settings: Settings) -> None:
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


def log_to_stderr() -> None:
    """Send the service's lines and uvicorn's warnings to stderr."""
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
