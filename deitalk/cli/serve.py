"""`deitalk serve`, its schema and keys: the commands of the service in `api/`.

The service is built on this package, so nothing here imports it: its module is found by name when
one of its commands runs.
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from deitalk.cli.options import CheckedCommands
from deitalk.cli.targets import reserve_file
from deitalk.errors import MissingError

app = CheckedCommands()


@app.callback(invoke_without_command=True)
def serve(
    context: typer.Context,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on (127.0.0.1); others need keys.")
    ] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port (8000).")] = None,
    settings: Annotated[
        Path | None, typer.Option(help="YAML file of settings; see docs/service.md.")
    ] = None,
    backend: Annotated[
        str | None, typer.Option(help="torch, or onnx: ONNX Runtime (extra onnx); no meshes.")
    ] = None,
    opens: Annotated[
        bool,
        typer.Option("--open/--no-open", help="Open the studio, a page for recordings, here."),
    ] = False,
    migrate: Annotated[
        bool, typer.Option("--migrate", help="Only bring the tables of jobs to this version.")
    ] = False,
) -> None:
    """Serve animations over HTTP and WebSocket, and the studio: drop a recording on a page.

    Settings come from a YAML file, then from variables DEITALK_<NAME>, then from these options.

    Examples
    --------
    deitalk serve --open

    deitalk serve --port 9000 --settings service.yaml
    """
    if context.invoked_subcommand is None:
        _commands().serve(
            settings, opens=opens, migrate=migrate, host=host, port=port, backend=backend
        )


@app.command()
def openapi(
    out: Annotated[Path, typer.Option("--out", "-o", help="JSON file to write.")] = Path(
        "openapi.json"
    ),
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write the OpenAPI schema of the service.

    Examples
    --------
    deitalk serve openapi -o openapi.json
    """
    reserve_file(out, force=force)
    _commands().write_openapi(out)


@app.command()
def key(
    name: Annotated[str, typer.Argument(help="Name of the key's owner, for the log.")],
    scopes: Annotated[
        str, typer.Option(help="Of animate, jobs, live and metrics, with commas.")
    ] = "animate,jobs,live",
    per_minute: Annotated[int, typer.Option(min=1, max=1_000_000, help="Requests a minute.")] = 600,
) -> None:
    """Print a new API key, once, and the lines of settings that accept it.

    Examples
    --------
    deitalk serve key farm --scopes animate,jobs
    """
    _commands().print_new_key(name, scopes, per_minute)


def _commands() -> Any:
    try:
        return import_module("api.commands")
    except ModuleNotFoundError as error:
        raise MissingError(f"the service needs {error.name}; install the package again") from None
