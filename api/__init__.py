"""The service: HTTP and WebSocket routes over the package `deitalk`.

>>> from api import create_app
>>> app = create_app()
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from api.app import create_app

__all__ = ["create_app"]


def __getattr__(name: str) -> Any:
    """Import `create_app` at its first use: worker processes do without fastapi."""
    if name == "create_app":
        from api.app import create_app

        return create_app
    raise AttributeError(f"module 'api' has no attribute {name!r}")
