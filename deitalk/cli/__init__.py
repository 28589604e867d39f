"""The command line is built here, and errors become one line on stderr.

Each verb is a function in a module of its name; it imports slow packages when it is called.
"""

import atexit
import gc
import os
import sys
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any, cast

import typer

from deitalk.cli.console import emit, name_option, prepare_streams
from deitalk.cli.options import CheckedCommands
from deitalk.cli.targets import check_working_folder, hold_targets
from deitalk.installed import __version__
from deitalk.safe_path import safe_path
from deitalk.signals import CTRL_C_CODE, catch_signals, leave_on_ctrl_c, received, release_signals
from rig.errors import UserError, one_line

VERBS = (
    *("animate", "batch", "live", "preview", "convert", "diff", "dub", "validate", "retarget"),
    *("finetune", "face", "install", "serve", "data", "model", "export"),
)
"""In the order of the help, each a function or a group in the module of its name."""
TOGETHER = {"diff": "edits", "dub": "edits"}
"""Modules of other names."""
NO_ROOM = ("failed to map segment", "cannot allocate memory", "can't allocate memory")
"""What the loader of libraries and torch say where memory ends."""


def commands(asked: str = "") -> CheckedCommands:
    """The command line; of the verb that is asked for alone, which is built sooner."""
    app = CheckedCommands(
        name="deitalk",
        help="MetaHuman facial animation from speech and an emotion.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(root)
    for verb in (asked,) if asked in VERBS else VERBS:
        module = import_module(f"deitalk.cli.{TOGETHER.get(verb, verb)}")
        if hasattr(module, "app"):
            app.add_typer(module.app, name=verb)
        else:
            app.command(verb)(getattr(module, verb))
    return app


def __getattr__(name: str) -> Any:
    """``app``: the whole command line, which is built when it is asked for."""
    if name == "app":
        return commands()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _version(wanted: bool) -> None:
    if wanted:
        emit(__version__)
        raise typer.Exit


def root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """MetaHuman facial animation from speech and an emotion."""
    hold_targets(context)


UsageError = cast(type[Exception], typer.BadParameter.__base__)  # typer does not export it


def program() -> None:
    """Run `main` as a process of its own, which leaves its memory to the system at its end.

    Python would free every object and library one by one, in a twentieth of the time of a command.
    """
    code: Any = 1

    def leave() -> None:
        for stream in (sys.stdout, sys.stderr):
            with suppress(AttributeError, OSError, ValueError):  # none, broken, closed
                stream.flush()
        os._exit(code)

    atexit.register(leave)  # the first to be registered is the last to be called
    try:
        main()
    except SystemExit as end:
        code = end.code or 0
        leave_on_ctrl_c()  # all is done
        raise


def main(app: typer.Typer | None = None, name: str = "deitalk") -> None:
    """Run a command; an error that a user can correct is one line on stderr.

    The exit code is 2 for a wrong command line, 128 and the number of the signal for a command
    that Ctrl-C, SIGTERM or SIGHUP stopped, otherwise 1.
    """
    usual = gc.get_threshold()
    gc.set_threshold(100_000)  # imports make many objects and few cycles to search for
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # a search in all installed packages
    prepare_streams()
    try:
        catch_signals()
        check_working_folder()
        with safe_path():
            app = app or commands(*sys.argv[1:2])
            code = app(prog_name=name, standalone_mode=False)
        if code == CTRL_C_CODE:
            raise KeyboardInterrupt
        sys.exit(code)
    except UsageError as error:
        _fail(_usage(error), 2)
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted", CTRL_C_CODE)
    except UserError as error:
        _fail(name_option(error))
    except BrokenPipeError:
        sys.stderr.close()  # the reader of a pipe has ended
        sys.exit(1)
    except (MemoryError, ImportError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and not any(told in str(error) for told in NO_ROOM):
            raise
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
