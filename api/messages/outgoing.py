"""Answers: JSON; a result at once, or a job for what takes longer."""

import hashlib
import json
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, NamedTuple

import anyio
from fastapi import Request, Response
from starlette.responses import StreamingResponse

from api.compute.order import Answer, Order
from api.compute.pool import result_path
from api.errors import Problem
from api.guard.keys import Caller, require
from api.jobs.queue import new_id
from api.jobs.table import Job
from api.messages.formats import OutputFormat
from api.messages.views import view_of
from api.service import Service

AT_ONCE_BYTES = 16 << 20
"""Larger results are sent from their file."""
LONGEST_NOTES = 2000
LONGEST_KEY = 200


class ServiceRequest(NamedTuple):
    """A request, the service that answers it, and who makes it."""

    request: Request
    service: Service
    caller: Caller


async def answer_order(
    asked: ServiceRequest, folder: Path, work: Order, output: OutputFormat, *, waits: bool
) -> Response:
    """Carry out an order now if its recording is short for its format, else accept a job.

    Parameters
    ----------
    asked : ServiceRequest
        Of the route.
    folder : Path
        With the order's files; it is removed.
    work : Order
        Kind and options.
    output : OutputFormat
        Of the result.
    waits : bool
        Whether the client waits for a short one; else it is a job too.
    """
    _, service, caller = asked
    settings = service.settings
    at_once = min(settings.max_seconds, output.at_once_seconds(settings.work_seconds))
    work = work | {
        "options": work["options"] | {"format": output.name, "suffix": output.suffix},
        "at_once_seconds": at_once, "most_seconds": settings.max_job_seconds,
    }  # fmt: skip
    try:
        if waits:
            answer = await service.pool.run(work | {"folder": str(folder)}, caller)
            if "long" not in answer:
                await service.count(caller, service.metrics.read(answer, "request"))
                return await file_answer(folder, answer, output)
        job = await accept(asked, folder, work, output)
        body = view_of(job).model_dump_json()
        headers = {"Location": f"/v1/jobs/{job.id}"}
        return Response(body, 202, headers, "application/json")
    finally:
        await anyio.to_thread.run_sync(shutil.rmtree, folder, True)


async def accept(asked: ServiceRequest, folder: Path, work: Order, output: OutputFormat) -> Job:
    """Put an order into the queue of jobs.

    Raises
    ------
    Problem
        403 without the scope, 409 for an idempotency key of another request, 429, 503.
    """
    request, service, caller = asked
    require(caller, "jobs")
    key = request.headers.get("idempotency-key")
    if key is not None and not (0 < len(key) <= LONGEST_KEY and key.isprintable()):
        raise Problem(400, f"Idempotency-Key must be 1 to {LONGEST_KEY} printable letters")
    order: Order = work | {"at_once_seconds": service.settings.max_job_seconds}
    content = {"order": order, "media_type": output.media_type, "format": output.name}

    digest = await anyio.to_thread.run_sync(_digest, folder, content)
    job = await service.ask(service.queue.known, caller, key, digest)
    if job is not None:
        return job
    await service.ask(service.queue.check_room, caller)
    job_id, traced = new_id(), content | {"trace": request.state.trace}
    try:
        await anyio.to_thread.run_sync(service.store.put_folder, folder, job_id)
        job = await service.ask(service.queue.add, job_id, caller, traced, digest, key)
    except Exception:
        await anyio.to_thread.run_sync(service.store.remove, job_id)
        raise
    if job.id != job_id:
        await anyio.to_thread.run_sync(service.store.remove, job_id)
    service.runner.wake()
    return job


def _digest(folder: Path, content: dict[str, Any]) -> str:
    """SHA-256 of everything that a request sent."""
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for path in sorted(path for path in folder.iterdir() if path.is_file()):
        digest.update(path.name.encode())
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()


async def file_answer(folder: Path, answer: Answer, output: OutputFormat) -> Response:
    """Return the file that an order wrote into its folder, with its notes."""
    path = result_path(folder, answer)
    headers = result_headers(path.name, answer.get("notes", []))
    if path.stat().st_size <= AT_ONCE_BYTES:
        return Response(path.read_bytes(), headers=headers, media_type=output.media_type)
    file = path.open("rb")  # the folder goes, the open file stays

    async def blocks() -> AsyncIterator[bytes]:
        with file:
            while block := await anyio.to_thread.run_sync(file.read, 1 << 20):
                yield block

    return StreamingResponse(blocks(), headers=headers, media_type=output.media_type)


def result_headers(name: str, notes: list[str]) -> dict[str, str]:
    """Headers of a result: its file name, and the notes as ASCII JSON."""
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    while notes and len(json.dumps(notes)) > LONGEST_NOTES:
        notes = notes[:-1]
    if notes:
        headers["Deitalk-Notes"] = json.dumps(notes)
    return headers
