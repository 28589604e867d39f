"""Arguments of the modules that are run by ``python -m``."""

import argparse
from pathlib import Path

from rig.errors import ExistsError, TargetError, one_line
from rig.files import check_file


def new_file(text: str) -> Path:
    """Path of a file to write, a ``type`` for `argparse` that refuses what `check_file` does."""
    try:
        check_file(text)
    except ExistsError:
        raise argparse.ArgumentTypeError(f"{text} exists; name another file") from None
    except TargetError as error:
        raise argparse.ArgumentTypeError(one_line(str(error))) from None
    return Path(text)
