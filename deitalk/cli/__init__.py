"""The command line: one thin function per verb; heavy imports happen inside them."""

import gc
import os
import sys
from contextlib import suppress
from typing import Annotated, Any, cast

import typer

from deitalk.cli.animate import animate
from deitalk.cli.batch import batch
from deitalk.cli.console import emit, escape_what_cannot_be_encoded, name_option
from deitalk.cli.convert import convert
from deitalk.cli.data import app as data_app
from deitalk.cli.edits import diff, dub
from deitalk.cli.export import app as export_app
from deitalk.cli.face import app as face_app
from deitalk.cli.finetune import finetune
from deitalk.cli.install import app as install_app
from deitalk.cli.live import live
from deitalk.cli.model import app as model_app
from deitalk.cli.options import CheckedCommands
from deitalk.cli.preview import preview
from deitalk.cli.retarget import retarget
from deitalk.cli.serve import app as serve_app
from deitalk.cli.signals import CTRL_C_CODE, Terminated, catch_signals, received, release_signals
from deitalk.cli.targets import hold_targets
from deitalk.cli.validate import validate
from deitalk.installed import __version__
from deitalk.workers import safe_path
from rig.errors import UserError, one_line

app = CheckedCommands(
    name="deitalk",
    help="MetaHuman facial animation from speech and an emotion.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _verb in (animate, batch, live, preview, convert, diff, dub, validate, retarget):
    app.command()(_verb)
app.add_typer(face_app, name="face")
app.add_typer(install_app, name="install")
app.add_typer(serve_app, name="serve")
app.add_typer(data_app, name="data")
app.command()(finetune)
app.add_typer(model_app, name="model")
app.add_typer(export_app, name="export")


def _version(wanted: bool) -> None:
    if wanted:
        emit(__version__)
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """MetaHuman facial animation from speech and an emotion."""
    hold_targets(context)


UsageError = cast(type[Exception], typer.BadParameter.__base__)  # typer does not export it


def main(commands: typer.Typer = app, name: str = "deitalk") -> None:
    """Run a command; an error that a user can correct is one line on stderr.

    The exit code is 2 for a wrong command line, 128 and the number of the signal for a command
    that Ctrl-C, SIGTERM or SIGHUP stopped, otherwise 1.
    """
    usual = gc.get_threshold()
    gc.set_threshold(10_000)  # imports make many objects and few cycles to search for
    escape_what_cannot_be_encoded()
    try:
        catch_signals()
        with safe_path():
            code = commands(prog_name=name, standalone_mode=False)
        if code == CTRL_C_CODE:
            _fail("stopped", CTRL_C_CODE)
        sys.exit(code)
    except UsageError as error:
        _fail(_usage(error), 2)
    except (typer.Abort, Terminated):
        _fail("stopped", CTRL_C_CODE)
    except UserError as error:
        _fail(name_option(error))
    except BrokenPipeError:
        sys.stderr.close()  # the reader of a pipe has ended
        sys.exit(1)
    except MemoryError:
        _fail("not enough memory; give a shorter recording or a smaller file")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _fail(f"{where}{error.strerror or error}; check the path, the permissions and the space")
    finally:
        release_signals()
        gc.set_threshold(*usual)
        gc.freeze()  # the last search for cycles would take a quarter of a second in torch


def _usage(error: Any) -> str:
    """Message for a wrong command line, with the command that prints its help."""
    problem = str(error.format_message()).rstrip(".")
    command = error.ctx.command_path if error.ctx else "deitalk"
    files = [word for word in sys.argv[1:] if word.startswith("-") and os.path.isfile(word)]
    if files:
        return f"{problem}; write ./{files[0]} for the file of that name"
    return f"{problem}; see `{command} --help`"


def _fail(message: str, code: int = 1) -> None:
    """Print one line and exit; after a signal the line names the signal, whatever the error."""
    if (stopped := received()) is not None:
        message, code = f"stopped by {stopped.name}", stopped.exit_code
    with suppress(OSError):  # the terminal may be closed
        typer.secho(f"deitalk: {one_line(message)}", fg="red", err=True)
    sys.exit(code)
