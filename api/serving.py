"""The running server: uvicorn with limits of headers, connections and messages, and its log."""

import asyncio
import json
import logging.config
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable
from datetime import UTC, datetime
from time import monotonic
from types import FrameType
from typing import Any

import uvicorn

from api.app import create_app
from api.errors import describe
from api.guard.middleware import HEADER_BYTES
from api.guard.protocol import GuardedProtocol, GuardedSocket
from api.jobs.store import Store
from api.jobs.versions import open_database
from api.service import Service
from api.settings import Settings
from deitalk.errors import ConfigError
from deitalk.installed import __version__
from deitalk.models.device import require_device
from rig.errors import one_line

LIVE_MESSAGE_BYTES = 1 << 20
KEEP_ALIVE_SECONDS = 10
OF_CLIENTS = (
    "ASGI callable returned without completing handshake.",
    "Invalid UTF-8 sequence received from client.",
)
"""Errors in uvicorn's log that are its clients': one leaves in the handshake, or sends no text."""


def run(settings: Settings, studio: str = "") -> None:
    """Print the settings and serve until SIGINT or SIGTERM.

    With the address of the studio, which the user's browser opens once the service is ready, only
    the settings that were given are printed.

    Raises
    ------
    ConfigError
        If a setting is wrong, the port is taken, or a place of jobs cannot be used.
    DeitalkError
        If there is no such device.
    """
    if settings.device != "cpu":
        require_device(settings.device)
    app = create_app(settings)
    print_settings(settings, studio)
    log_to_stderr(settings.log)
    check_port(settings)
    check_places(settings)
    server = Server(server_config(app, settings), app.state.service, studio)
    server.run()
    if not server.started:
        raise ConfigError(f"the service did not start on {settings.host} port {settings.port}")


class Server(uvicorn.Server):
    """Ends in steps: not ready, no new work, no work that goes on for longer than is allowed.

    Parameters
    ----------
    config : uvicorn.Config
    service : Service
        Of the application.
    studio : str
        Address that the user's browser opens once the service is ready; empty: none.
    """

    def __init__(self, config: uvicorn.Config, service: Service, studio: str = "") -> None:
        super().__init__(config)
        self.service, self.studio = service, studio
        self._signal: int | None = None
        self._task: asyncio.Task[None] | None = None

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Begin to end; end at once at the second signal."""
        if self._signal is not None:
            super().handle_exit(sig, frame)
        self._signal = sig

    async def on_tick(self, counter: int) -> bool:
        """Drain once a signal has come; open the studio once the service is ready."""
        if self.studio and self.service.pool.is_ready and self.service.voices.is_ready:
            threading.Thread(target=webbrowser.open, args=(self.studio,), daemon=True).start()
            self.studio = ""
        if self._signal is not None and self._task is None:
            self._task = asyncio.create_task(self._drain(self._signal))
        return await super().on_tick(counter)

    async def _drain(self, sig: int) -> None:
        settings, traffic = self.service.settings, self.service.traffic
        self.service.drain()
        await asyncio.sleep(settings.drain_notice_seconds)
        traffic.drain()
        end = monotonic() + settings.drain_seconds
        while (traffic.active or self.service.runner.at_work) and monotonic() < end:
            await asyncio.sleep(0.05)
        traffic.end_all()
        await asyncio.sleep(0.2)  # the answers to those that were ended
        super().handle_exit(sig, None)


def server_config(app: Any, settings: Settings) -> uvicorn.Config:
    """Return uvicorn's configuration: limits of headers, connections and messages."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=GuardedProtocol.limited(settings),
        ws=GuardedSocket,
        ws_max_size=LIVE_MESSAGE_BYTES,
        ws_per_message_deflate=False,  # a kilobyte could stand for a megabyte
        h11_max_incomplete_event_size=HEADER_BYTES,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=2,  # for what `Server` left
        access_log=False,
        log_config=None,
        server_header=False,
        proxy_headers=bool(settings.proxies),
        forwarded_allow_ips=list(settings.proxies),
    )


def print_settings(settings: Settings, studio: str = "") -> None:
    """Print the version and one line for each setting; with a studio for those that were given."""
    shown = settings.shown
    names = [name for name in shown if not studio or name in settings.model_fields_set]
    lines = "".join(f"  {name} = {shown[name]}\n" for name in names)
    where = f", studio at {studio}; Ctrl-C ends it" if studio else ""
    sys.stderr.write(f"deitalk {__version__}{where}\n{lines}")


def check_port(settings: Settings) -> None:
    """Refuse a port that is taken, before the workers start."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    for name in ("port", "grpc_port"):
        port = getattr(settings, name)
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((settings.host, port))
            except OSError as error:
                raise ConfigError(
                    f"port {port} of {settings.host}: {os.strerror(error.errno or 0)}; give "
                    f"another `{name}`", parameter=name,
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
            # The first line of the operating system or of a database driver.
            reason = str(getattr(error, "orig", None) or error).partition("\n")[0]
            reason = getattr(error, "strerror", None) or reason or type(error).__name__
            given = one_line(f"{name} = {settings.shown[name]}: {reason}")
            raise ConfigError(
                f"{given}; check it, or change the setting (DEITALK_{name.upper()})"
            ) from None


class LineFormatter(logging.Formatter):
    """A line a record; of an exception its class and functions, without text and paths."""

    def __init__(self, *, as_json: bool = False) -> None:
        super().__init__("%(asctime)s %(levelname)s %(message)s")
        self.as_json = as_json

    def formatException(self, ei: Any) -> str:
        """Describe an exception."""
        return describe(ei[1])

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        if not self.as_json:
            return one_line(super().format(record))
        time = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        content = {"time": time, "level": record.levelname, "message": record.getMessage().strip()}
        if record.exc_info and record.exc_info[1]:
            content["error"] = describe(record.exc_info[1])
        return json.dumps(content | getattr(record, "facts", {}))


def log_to_stderr(form: str = "text") -> None:
    """Send the service's lines and uvicorn's warnings to stderr, as ``text`` or ``json``."""
    logging.config.dictConfig({
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"line": {"()": LineFormatter, "as_json": form == "json"}},
        "filters": {"ours": {"()": lambda: lambda record: record.getMessage() not in OF_CLIENTS}},
        "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "line"}},
        "loggers": {
            "deitalk.service": {"handlers": ["stderr"], "level": "INFO", "propagate": False},
            "python_multipart": {"level": "ERROR"},
            "uvicorn": {"handlers": ["stderr"], "level": "WARNING", "propagate": False},
            "uvicorn.error": {"filters": ["ours"]},
        },
    })  # fmt: skip
