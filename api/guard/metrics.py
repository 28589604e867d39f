"""Counts and times for Prometheus, spans for OpenTelemetry; nothing of any request's content."""

from collections.abc import Mapping
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

METHODS = ("GET", "POST", "DELETE", "HEAD", "PUT", "WS")
JOB_BUCKETS = (0.5, 1, 2, 5, 10, 30, 60, 300, 1800, 7200)
LATE_BUCKETS = (0.1, 0.2, 0.25, 0.3, 0.4, 0.6, 1, 2, 5)


class Metrics:
    """The service's own registry."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()

        def made(
            kind: type, name: str, text: str, labels: tuple[str, ...] = (), **more: Any
        ) -> Any:
            return kind(f"deitalk_{name}", text, labels, registry=self.registry, **more)

        route = ("method", "route")
        self.seconds = made(Histogram, "request_seconds", "Time of requests by route", route)
        self.requests = made(Counter, "requests", "Requests by route", (*route, "status"))
        self.audio = made(Counter, "audio_seconds", "Seconds of speech animated", ("by",))
        self.busy = made(Gauge, "busy_orders", "Orders in work or waiting")
        self.lost = made(Gauge, "lost_workers", "Worker processes that ended in an order")
        self.left = made(Gauge, "left_orders", "Orders dropped because their client went")
        self.jobs = made(Gauge, "jobs", "Jobs by status", ("status",))
        self.waited = made(
            Histogram, "job_wait_seconds", "Time of jobs in the queue", buckets=JOB_BUCKETS
        )
        self.job_seconds = made(
            Histogram, "job_seconds", "Work on jobs by format", ("format",), buckets=JOB_BUCKETS
        )
        self.live = made(Gauge, "live_sessions", "Open live sessions")
        self.late = made(
            Histogram, "live_late_seconds", "From a frame's sound to its sending",
            buckets=LATE_BUCKETS,
        )  # fmt: skip

    def request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one request."""
        known = method if method in METHODS else "other"
        self.requests.labels(known, route, str(status)).inc()
        self.seconds.labels(known, route).observe(seconds)

    def read(self, answer: Mapping[str, Any], by: str) -> float:
        """Count what an order of a ``request`` or a ``job`` read; return its seconds of speech."""
        seconds: float = answer.get("facts", {}).get("seconds", 0.0)
        self.audio.labels(by).inc(seconds)
        return seconds

    def text(self) -> bytes:
        """Everything in the text format of Prometheus."""
        return generate_latest(self.registry)
