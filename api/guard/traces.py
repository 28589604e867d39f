"""Spans of requests and jobs for OpenTelemetry (extra otel), where a collector is named.

The variables are OpenTelemetry's own: ``OTEL_EXPORTER_OTLP_ENDPOINT`` turns spans on. A span has
the route's pattern, the status, the request's id and the key's name, and nothing of what was
sent.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from deitalk.errors import MissingError

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
