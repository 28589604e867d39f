"""Parameters that routes have in common."""

from typing import Annotated, Any

from fastapi import Depends, Request

from api.guard.keys import Caller, require
from api.service import Service


def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


def _caller(request: Request) -> Caller:
    caller: Caller = request.state.caller
    return caller


def _animator(caller: Annotated[Caller, Depends(_caller)]) -> Caller:
    require(caller, "animate")
    return caller


def _job_caller(caller: Annotated[Caller, Depends(_caller)]) -> Caller:
    require(caller, "jobs")
    return caller


def _reader(caller: Annotated[Caller, Depends(_caller)]) -> Caller:
    require(caller, "metrics")
    return caller


ServiceDep = Annotated[Service, Depends(_service)]
AnimatorDep = Annotated[Caller, Depends(_animator)]
JobCallerDep = Annotated[Caller, Depends(_job_caller)]
MetricsDep = Annotated[Caller, Depends(_reader)]


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of the problems of a route; those of every route are added."""
    from api.errors import MEDIA_TYPE, STATUS_CODES

    schema = {"$ref": "#/components/schemas/Problem"}
    return {
        status: {"description": STATUS_CODES[status], "content": {MEDIA_TYPE: {"schema": schema}}}
        for status in sorted({400, 401, 403, 413, 422, 429, 503, 507, *statuses})
    }
