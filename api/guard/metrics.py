"""Counts and times for Prometheus, spans for OpenTelemetry; nothing of any request's content."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

from deitalk.errors import MissingError

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


# Spans of requests and jobs for OpenTelemetry (extra otel), where a collector is named.
#
# The variables are OpenTelemetry's own: ``OTEL_EXPORTER_OTLP_ENDPOINT`` turns spans on. A span has
# the route's pattern, the status, the request's id and the key's name, and nothing of what was
# sent.


VARIABLE = "OTEL_EXPORTER_OTLP_ENDPOINT"


class Traces:
    """Begins and ends spans; without a collector it does nothing.

    Raises
    ------
    MissingError
        If a collector is named and OpenTelemetry is not installed.
    """

    def __init__(self) -> None:
        self._tracer: Any = None
        if not os.environ.get(VARIABLE):
            return
        try:
            from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
            from opentelemetry.sdk.resources import Resource
            from opentelemetry.sdk.trace import TracerProvider
            from opentelemetry.sdk.trace.export import BatchSpanProcessor
        except ImportError as error:
            raise MissingError(
                f"{VARIABLE} is set and {error.name} is not installed; `pip install "
                "'deitalk[otel]'`, or unset it"
            ) from None
        name = os.environ.get("OTEL_SERVICE_NAME", "deitalk")
        self._provider = TracerProvider(resource=Resource.create({"service.name": name}))
        self._provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
        self._tracer = self._provider.get_tracer("deitalk")

    @contextmanager
    def span(self, name: str, parent: str | None) -> Iterator[dict[str, Any]]:
        """Yield the attributes of a span, to be filled in; ``name`` and ``parent`` are among them.

        Parameters
        ----------
        name : str
            Of the span.
        parent : str
            A ``traceparent`` (W3C Trace Context), or empty; None makes no span.
        """
        facts: dict[str, Any] = {"name": name, "parent": parent or ""}
        if self._tracer is None or parent is None:
            yield facts
            return
        from opentelemetry.trace import SpanKind
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        context = TraceContextTextMapPropagator()
        kind = SpanKind.SERVER if name == "request" else SpanKind.CONSUMER
        before = context.extract({"traceparent": parent})
        with self._tracer.start_as_current_span(name, before, kind) as span:
            carrier: dict[str, str] = {}
            context.inject(carrier)
            facts["parent"] = carrier["traceparent"]
            yield facts
            span.update_name(facts.pop("name"))
            span.set_attributes({n: v for n, v in facts.items() if n != "parent"})

    def stop(self) -> None:
        """Send what is left."""
        if self._tracer is not None:
            self._provider.shutdown()


def parent_of(headers: Mapping[bytes, bytes]) -> str:
    """The ``traceparent`` of a request; OpenTelemetry checks it."""
    return headers.get(b"traceparent", b"").decode("latin-1")[:100]
