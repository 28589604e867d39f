"""The version, and what is imported by its name."""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"


def imported(name: str) -> Any:
    """Return what ``module:name`` names."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)
