"""What is installed: the version, and `deitalk.research` in a checkout, which a wheel lacks."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from deitalk.errors import MissingError
from rig.errors import quoted

__version__ = "0.1.0"
VERBS = ("ablate", "attention", "corpus", "evaluate", "study", "train")
"""Verbs of the command line that `deitalk.research.cli` adds."""


def has_research() -> bool:
    """Whether `deitalk.research` is there."""
    return find_spec("deitalk.research") is not None


def research(module: str, what: str) -> Any:
    """Import a module of `deitalk.research`.

    Parameters
    ----------
    module : str
        Its name below ``deitalk.research``.
    what : str
        What needs it, for the message.

    Raises
    ------
    MissingError
        If the package was installed without it.
    """
    if not has_research():
        raise MissingError(
            f"{quoted(what)} needs deitalk.research, which a wheel lacks; clone the repository and "
            "pip install -e ."
        )
    return import_module(f"deitalk.research.{module}")
