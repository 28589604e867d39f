"""State of the service, and its counts."""

from fastapi import APIRouter, Response

from api.errors import Problem
from api.messages.views import StatusView
from api.routes.deps import MetricsDep, ServiceDep, problems
from deitalk.installed import __version__

router = APIRouter(tags=["state"])


@router.get("/healthz")
async def health() -> StatusView:
    """Whether the service answers."""
    return StatusView(status="ok", version=__version__)


@router.get("/readyz", responses=problems())
async def ready(service: ServiceDep) -> StatusView:
    """Whether a worker has read the models and no live worker has ended; 503 otherwise."""
    if service.is_draining:
        raise Problem(503, "the server ends", "draining", None, {"Retry-After": "1"})
    if not service.pool.is_ready:
        raise Problem(503, "the models are being read", "starting", None, {"Retry-After": "1"})
    if not service.voices.is_ready:
        raise Problem(503, "the live worker starts again", "starting", None, {"Retry-After": "1"})
    return StatusView(status="ready", version=__version__)


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {}}}, **problems()},
)
async def metrics(service: ServiceDep, caller: MetricsDep) -> Response:
    """Counts and times in the text format of Prometheus."""
    counts = service.metrics
    counts.busy.set(service.pool.places.taken)
    counts.lost.set(service.pool.lost)
    counts.left.set(service.pool.left)
    counts.live.set(service.live.taken)
    for status, count in (await service.ask(service.queue.counts)).items():
        counts.jobs.labels(status).set(count)
    return Response(counts.text(), media_type="text/plain; version=0.0.4; charset=utf-8")
