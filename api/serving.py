"""The running server: uvicorn with limits of headers, connections and messages, and its log."""

import logging.config
import os
import socket
import sys
from collections.abc import Callable
from typing import Any

import uvicorn

from api.app import create_app
from api.guard.middleware import HEADER_BYTES
from api.guard.protocol import GuardedProtocol, GuardedSocket
from api.jobs.store import Store
from api.jobs.table import open_database
from api.settings import Settings
from deitalk.errors import ConfigError
from deitalk.installed import __version__
from rig.errors import one_line

LIVE_MESSAGE_BYTES = 1 << 20
KEEP_ALIVE_SECONDS = 10


def run(settings: Settings) -> None:
    """Print the settings and serve until SIGINT or SIGTERM.

    Raises
    ------
    ConfigError
        If a setting is wrong, the port is taken, or a place of jobs cannot be used.
    """
    app = create_app(settings)
    print_settings(settings)
    log_to_stderr()
    check_port(settings)
    check_places(settings)
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
        ws=GuardedSocket,
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


def check_places(settings: Settings) -> None:
    """Refuse a data folder, a database or a store that cannot be used, before the workers start.

    Database drivers and file systems raise classes of their own: every exception is reported.
    """
    places: dict[str, Callable[[], object]] = {
        "data": lambda: settings.data.mkdir(parents=True, exist_ok=True, mode=0o700),
        "database": lambda: open_database(settings.database_url).dispose(),
        "storage": lambda: Store(settings.storage_url).check(),
    }
    for name, use in places.items():
        try:
            use()
        except Exception as error:
            given = one_line(f"{name} = {settings.shown[name]}: {_reason(error)}")
            raise ConfigError(
                f"{given}; check it, or change the setting (DEITALK_{name.upper()})"
            ) from None


def _reason(error: Exception) -> str:
    """First line of the message of an operating system or a database driver."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    said = str(getattr(error, "orig", None) or error).partition("\n")[0]
    return said or type(error).__name__


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
