"""Speech in, an acted MetaHuman face out.

>>> from deitalk import animate
>>> performance = animate("speech.wav", "happy")
>>> performance.curves["CTRL_C_jaw.ty"]
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = ["EMOTIONS", "Performance", "__version__", "animate", "load_model"]

if TYPE_CHECKING:
    from deitalk.checkpoint import load_model
    from deitalk.emotions import EMOTIONS
    from deitalk.pipeline import Performance, animate

_HOME = {
    "EMOTIONS": "deitalk.emotions",
    "Performance": "deitalk.pipeline",
    "animate": "deitalk.pipeline",
    "load_model": "deitalk.checkpoint",
}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, so that ``import deitalk`` costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module 'deitalk' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOME[name]), name)
