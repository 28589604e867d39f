"""Arguments of the modules that are run by ``python -m``."""

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path

from rig.errors import ExistsError, TargetError, UserError, one_line
from rig.files import check_file


def one_line_errors(main: Callable[[Sequence[str] | None], int | None]) -> Callable[..., int]:
    """Wrap a command: what a user can correct is one line on stderr and exit code 1."""

    @wraps(main)
    def told(arguments: Sequence[str] | None = None) -> int:
        try:
            return main(arguments) or 0
        except UserError as error:
            sys.stderr.write(f"deitalk: {error}\n")
            return 1

    return told


def new_file(text: str) -> Path:
    """Path of a file to write, a ``type`` for `argparse` that refuses what `check_file` does."""
    try:
        check_file(text)
    except ExistsError:
        raise argparse.ArgumentTypeError(f"{text} exists; name another file") from None
    except TargetError as error:
        raise argparse.ArgumentTypeError(one_line(str(error))) from None
    return Path(text)
