"""Parameters that routes have in common."""

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import Depends, Request

from api.errors import MEDIA_TYPE, STATUS_CODES
from api.guard.keys import Caller, require
from api.service import Service
from api.settings import Scope


def service_of(request: Request) -> Service:
    """Return the service of a request's application."""
    service: Service = request.app.state.service
    return service


def with_scope(scope: Scope) -> Callable[[Request], Caller]:
    """Return a dependency that gives the caller, and refuses one whose key has not the scope."""

    def caller_of(request: Request) -> Caller:
        require(request.state.caller, scope)
        caller: Caller = request.state.caller
        return caller

    return caller_of


ServiceDep = Annotated[Service, Depends(service_of)]
AnimatorDep = Annotated[Caller, Depends(with_scope("animate"))]
JobCallerDep = Annotated[Caller, Depends(with_scope("jobs"))]
MetricsDep = Annotated[Caller, Depends(with_scope("metrics"))]


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of the problems of a route; those of every route are added."""
    schema = {"$ref": "#/components/schemas/Problem"}
    return {
        status: {"description": STATUS_CODES[status], "content": {MEDIA_TYPE: {"schema": schema}}}
        for status in sorted({400, 401, 403, 413, 422, 429, 503, 507, *statuses})
    }
