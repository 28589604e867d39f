"""The command line in this process: exit code, stdout and stderr of `deitalk.cli.main`."""

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from typing import Any, NamedTuple
from unittest.mock import patch

from typer.testing import CliRunner

from deitalk.cli import app, main

CHECKOUT = (
    "ablate", "attention", "corpus", "evaluate", "folds", "lips", "sheet", "study", "train", "tuned",
)  # fmt: skip
"""Verbs of `python -m deitalk.research`."""


def commands_of(verb: str) -> Any:
    """The application that has a verb."""
    if verb not in CHECKOUT:
        return app
    from deitalk.research.cli import app as checkout

    return checkout


class Done(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str


def deitalk(*arguments: object, stdin: bytes = b"") -> Done:
    """Run a command as its program does, but for the process."""
    out, err = io.StringIO(), io.StringIO()
    line = ["deitalk", *map(str, arguments)]
    given = patch.multiple(sys, argv=line, stdin=io.TextIOWrapper(io.BytesIO(stdin)))
    with given, redirect_stdout(out), redirect_stderr(err):
        try:
            main(commands_of(str(arguments[0]) if arguments else ""))
        except SystemExit as ended:
            return Done(int(ended.code or 0), out.getvalue(), err.getvalue())
    raise AssertionError("main returns by an exit alone")


def refused(*arguments: object, code: int = 1) -> str:
    """The line of a command that must fail: one on stderr, nothing on stdout."""
    done = deitalk(*arguments)
    assert (done.code, done.out) == (code, ""), done
    (line,) = done.err.splitlines()
    assert line.startswith("deitalk: ")
    return line


def ran(*arguments: object) -> Any:
    """The result of a command, run by Typer, that must succeed."""
    done = CliRunner().invoke(
        commands_of(str(arguments[0])), [str(argument) for argument in arguments]
    )
    assert done.exit_code == 0, (done.output, done.exception)
    return done
