"""Counts and times for Prometheus; names and routes only, nothing of any request's content."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest


class Metrics:
    """The service's own registry."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.seconds = Histogram(
            "deitalk_request_seconds",
            "Time of requests by route",
            ["method", "route"],
            registry=self.registry,
        )
        self.requests = Counter(
            "deitalk_requests",
            "Requests by route and status",
            ["method", "route", "status"],
            registry=self.registry,
        )
        self.audio = Counter(
            "deitalk_audio_seconds", "Seconds of speech animated", registry=self.registry
        )
        self.busy = Gauge(
            "deitalk_busy_orders", "Orders in work or waiting", registry=self.registry
        )
        self.lost = Gauge(
            "deitalk_lost_workers", "Worker processes that ended in an order",
            registry=self.registry,
        )  # fmt: skip
        self.jobs = Gauge("deitalk_jobs", "Jobs by status", ["status"], registry=self.registry)
        self.live = Gauge("deitalk_live_sessions", "Open live sessions", registry=self.registry)

    def request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one request."""
        known = method if method in ("GET", "POST", "DELETE", "HEAD", "PUT", "WS") else "other"
        self.requests.labels(known, route, str(status)).inc()
        self.seconds.labels(known, route).observe(seconds)

    def text(self) -> bytes:
        """Everything in the text format of Prometheus."""
        return generate_latest(self.registry)
