"""Jobs: long recordings, their progress and results."""

import asyncio
import re
from collections.abc import AsyncIterator
from typing import Annotated, Literal

import anyio
from fastapi import APIRouter, Path, Query, Request, Response
from starlette.responses import StreamingResponse

from api.errors import Problem
from api.guard.keys import Caller
from api.jobs.table import DONE, Job
from api.messages.formats import ANIMATION_FORMATS
from api.messages.options import AnimationOptions
from api.messages.outgoing import ServiceRequest, result_headers
from api.messages.views import JOB_EXAMPLE, JobsView, JobView, view_of
from api.routes import form_schema
from api.routes.animations import ANIMATION, SPEECH, speech
from api.routes.deps import JobCallerDep, ServiceDep, problems
from api.service import Service
from deitalk.config.section import Pattern

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], responses=problems(404))
POLL_SECONDS = 0.25
QUIET_SECONDS = 15.0
"""Longest silence of a stream of events: proxies close what is silent for longer."""
JobId = Annotated[
    str,
    Path(examples=[JOB_EXAMPLE]),
    Pattern(r"[A-Za-z0-9_-]{43}", "the id of a job, 43 of A to Z, a to z, 0 to 9, _ -"),
]
Status = Literal["queued", "running", "done", "failed", "cancelled"]


@router.post(
    "",
    status_code=202,
    response_class=Response,
    responses=form_schema.answers(ANIMATION_FORMATS, JobView, at_once=False) | problems(409, 415),
    openapi_extra=form_schema.body(AnimationOptions, SPEECH, ANIMATION_FORMATS, raw=True),
)
async def create_job(request: Request, service: ServiceDep, caller: JobCallerDep) -> Response:
    """Animate a recording of any length; with an `Idempotency-Key` the same request is one job."""
    return await speech(ServiceRequest(request, service, caller), ANIMATION, at_once=False)


@router.get("")
async def list_jobs(
    service: ServiceDep,
    caller: JobCallerDep,
    status: Status | None = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
    before: Annotated[
        float | None, Query(ge=0, le=1e11, description="Made before, seconds since 1970")
    ] = None,
) -> JobsView:
    """The key's own jobs, the newest first."""
    jobs = await service.ask(service.queue.newest, caller, status, limit, before)
    return JobsView(jobs=[view_of(job) for job in jobs])


@router.get("/{job_id}")
async def show_job(job_id: JobId, service: ServiceDep, caller: JobCallerDep) -> JobView:
    """A job and its progress."""
    return view_of(await service.ask(service.queue.get, job_id, caller))


@router.get(
    "/{job_id}/events",
    response_class=Response,
    responses={200: {"description": "Events", "content": {"text/event-stream": {}}}},
)
async def follow_job(job_id: JobId, service: ServiceDep, caller: JobCallerDep) -> Response:
    """Progress as server-sent events `job`, to the end of the job."""
    job = await service.ask(service.queue.get, job_id, caller)
    headers = {"X-Accel-Buffering": "no"}
    return StreamingResponse(
        _events(service, caller, job), headers=headers, media_type="text/event-stream"
    )


@router.get(
    "/{job_id}/result",
    response_class=Response,
    responses=problems(409, 410, 416)
    | {
        200: {"description": "The result", "content": {"application/octet-stream": {}}},
        206: {"description": "The part of a `Range`", "content": {"application/octet-stream": {}}},
        304: {"description": "As the `If-None-Match` has it"},
    },
)
async def job_result(
    job_id: JobId, request: Request, service: ServiceDep, caller: JobCallerDep
) -> Response:
    """The file of a job that is done, or one part of it; 409 before."""
    job = await service.ask(service.queue.get, job_id, caller)
    if job.status != DONE or job.result is None:
        raise Problem(409, f"the job is {job.status}; it has no result", "job_without_result")
    name = job.result.rpartition("/")[2][len(job.id) + 1 :]  # ids and holders are as long
    tag = f'"{job.result.rpartition("/")[2][:16]}"'
    headers = result_headers(name, (job.answer or {}).get("notes", []))
    headers |= {"ETag": tag, "Accept-Ranges": "bytes"}
    known = request.headers.get("if-none-match", "")
    if tag in known or known.strip() == "*":
        return Response(status_code=304, headers=headers)
    wanted = request.headers.get("range") if (request.headers.get("if-range", tag) == tag) else None
    begin, end = part_of(wanted, job.result_bytes)
    headers["Content-Length"] = str(end - begin)
    status = 200
    if wanted is not None and (begin, end) != (0, job.result_bytes):
        status = 206
        headers["Content-Range"] = f"bytes {begin}-{end - 1}/{job.result_bytes}"
    blocks = await anyio.to_thread.run_sync(
        service.store.read, job.result, begin, end, job.result_bytes
    )
    return StreamingResponse(blocks, status, headers, media_type=job.work["media_type"])


def part_of(header: str | None, size: int) -> tuple[int, int]:
    """Return begin and end of the part that a ``Range`` asks for; all for what is no single part.

    Raises
    ------
    Problem
        416 if it lies beyond the file.
    """
    found = re.fullmatch(r"bytes=(\d{0,18})-(\d{0,18})", (header or "").strip())
    if found is None or not any(found.groups()):
        return 0, size
    first, last = found.groups()
    if not first:
        begin, end = max(size - int(last), 0), size
    else:
        begin, end = int(first), min(int(last) + 1, size) if last else size
    if last and first and int(last) < int(first):
        return 0, size
    if begin >= size or begin >= end:
        raise Problem(
            416, f"the file has {size} bytes", "range_invalid",
            headers={"Content-Range": f"bytes */{size}"},
        )  # fmt: skip
    return begin, end


@router.post("/{job_id}/cancel")
async def cancel_job(job_id: JobId, service: ServiceDep, caller: JobCallerDep) -> JobView:
    """End a job; one that has ended stays as it is."""
    await service.ask(service.queue.cancel, await service.ask(service.queue.get, job_id, caller))
    return view_of(await service.ask(service.queue.get, job_id, caller))


@router.delete("/{job_id}", status_code=204, responses=problems(409))
async def delete_job(job_id: JobId, service: ServiceDep, caller: JobCallerDep) -> None:
    """Delete a job that has ended, with its files; 409 while it is queued or runs."""
    job = await service.ask(service.queue.get, job_id, caller)
    if not await service.ask(service.queue.remove_ended, [job.id]):
        raise Problem(409, f"the job is {job.status}; cancel it first", "job_active")
    await anyio.to_thread.run_sync(service.store.remove, job.id)


async def _events(service: Service, caller: Caller, job: Job) -> AsyncIterator[str]:
    last, quiet = None, 0.0
    while True:
        view = view_of(job).model_dump_json()
        if view != last:
            yield f"event: job\ndata: {view}\n\n"
            last, quiet = view, 0.0
        elif quiet >= QUIET_SECONDS:
            yield ": still there\n\n"
            quiet = 0.0
        if job.has_ended:
            return
        await asyncio.sleep(POLL_SECONDS)
        quiet += POLL_SECONDS
        try:
            job = await service.ask(service.queue.get, job.id, caller)
        except Problem as problem:
            if problem.status == 404:  # deleted meanwhile; else the database is away
                return
