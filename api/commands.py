"""Commands of the service, for `deitalk.cli.serve`; heavy imports happen inside them."""

import json
import socket
import sys
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from api.compute.worker import start_early
from api.guard.keys import new_key
from api.settings import ApiKey, Settings, load_settings
from deitalk.config.section import rule
from deitalk.errors import ConfigError
from rig.errors import quoted
from rig.files import atomic_write

ANY_ADDRESS = ("0.0.0.0", "::")


def serve(
    file: Path | None,
    *,
    opens: bool = False,
    migrate: bool = False,
    **given: Any,
) -> None:
    """Serve with the settings of a file, the environment and some given.

    If `opens`, the studio is opened in the user's browser once the service answers; with `migrate`
    only the tables of jobs are brought to this program's schema.

    Raises
    ------
    ConfigError
        If a setting is wrong, the port is taken, or a place of jobs cannot be used.
    MissingError
        If the studio is to be opened and this installation has no page.
    """
    settings = load_settings(file, **given)
    studio = studio_address(settings) if opens else ""
    settings.check()
    if migrate:
        from api.jobs.versions import open_database

        settings.data.mkdir(parents=True, exist_ok=True, mode=0o700)
        open_database(settings.database_url, migrate=True).dispose()
        return
    start_early(settings.backend)
    from api.serving import run

    run(settings, studio)


def studio_address(settings: Settings) -> str:
    """Address of the page of a service that will start, unless something listens there already."""
    from deitalk.preview.page import check_player

    check_player()
    host = "127.0.0.1" if settings.host in ANY_ADDRESS else settings.host
    with socket.socket() as probe:
        if probe.connect_ex((host, settings.port)) == 0:
            raise ConfigError(
                f"port {settings.port} is taken; give another `port`", parameter="port"
            )
    return f"http://{host}:{settings.port}/"


def write_openapi(out: Path) -> None:
    """Write the schema of the default settings as JSON."""
    from api.app import create_app

    schema = create_app(Settings.model_construct()).openapi()
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
        raise ConfigError(f"{first['loc'][0]} {quoted(first['input'])}: {rule(first)}") from None
    sys.stdout.write(
        f"{key}\n\nkeys:\n  - name: {entry.name}\n    sha256: {entry.sha256}\n"
        f"    scopes: [{', '.join(entry.scopes)}]\n"
        f"    requests_per_minute: {entry.requests_per_minute}\n"
    )
