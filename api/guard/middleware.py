"""What every request passes before a route: host, origin, key, rate, size and pace of its body.

::

    Host      one of the settings' names: another site cannot point its own name here
    Origin    none or this service's: a page of another site cannot send requests
    key       see `api.guard.keys`
    body      at most `max_bytes`, whole within `body_seconds`
"""

import asyncio
import json
import logging
from ipaddress import ip_address
from time import monotonic, perf_counter
from typing import Any
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.errors import MEDIA_TYPE, Problem, describe, internal_problem
from api.guard.keys import KeyRing, Rates
from api.settings import Settings, is_loopback

STUDIO_PATH = "/"
OPEN_PATHS = ("/healthz", "/readyz", "/docs", "/openapi.json", STUDIO_PATH)
"""Answered without a key: they tell nothing about anyone's work."""
PROBE_PATHS = ("/healthz", "/readyz")
"""Answered without a count. Balancers and the container itself get these by the service's address, which is none of `hosts`;
another site's page has a name."""
MOST_HEADERS = 100
HEADER_BYTES = 16 * 1024
SUBPROTOCOL, KEY_SUBPROTOCOL = "deitalk", "deitalk.key."
"""A browser's WebSocket cannot send headers: its key comes as a subprotocol beside the one that the
server names in its answer."""
ADDED_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cache-control", b"no-store"),
    (b"content-security-policy", b"default-src 'none'; style-src 'unsafe-inline'; sandbox"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
log = logging.getLogger("deitalk.service")


class Guard:
    """ASGI middleware around the application."""

    def __init__(self, app: ASGIApp, settings: Settings, metrics: Any) -> None:
        self.app, self.settings, self.metrics = app, settings, metrics
        self.keys, self.rates = KeyRing(settings), Rates()
        self.hosts = {name.lower() for name in (*settings.hosts, settings.host)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a refused request here; pass on any other."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        began, status = perf_counter(), 0

        async def sent(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                given = {name.lower() for name, _ in message["headers"]}
                added = [header for header in ADDED_HEADERS if header[0] not in given]
                message = dict(message) | {"headers": [*message["headers"], *added]}
            await send(message)

        try:
            self._admit(scope)
            body = _Body(receive, self.settings) if scope["type"] == "http" else receive
            await self.app(scope, body, sent)
        except Problem as problem:
            await _refuse(scope, problem, sent)
        except Exception as error:
            if status:  # the answer has begun: the connection is closed
                log.error("an answer broke off: %s", describe(error))
                return
            await _refuse(scope, internal_problem(error), sent)
        finally:
            self._record(scope, status, perf_counter() - began)

    def _admit(self, scope: Scope) -> None:
        n_bytes = sum(len(name) + len(value) for name, value in scope["headers"])
        if len(scope["headers"]) > MOST_HEADERS or n_bytes > HEADER_BYTES:
            raise Problem(
                400, f"at most {MOST_HEADERS} headers of {HEADER_BYTES} bytes", "headers_large",
                headers={"Connection": "close"},
            )  # fmt: skip
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        host = headers.get(b"host", "")
        if not (scope["path"] in PROBE_PATHS and _is_address(host)):
            self._check_host(host)
        if scope["path"] != STUDIO_PATH:  # a link of another site may open it
            self._check_origin(headers)
        if scope["path"] in PROBE_PATHS:
            return
        client = (scope.get("client") or ("unknown",))[0]
        if scope["path"] in OPEN_PATHS:
            self.rates.take(f"address {client}", self.settings.requests_per_minute)
            return
        try:
            caller = self.keys.caller(_key(headers))
        except Problem:
            self.rates.take(f"address {client}", self.settings.requests_per_minute)
            raise
        self.rates.take(f"key {caller.name}", caller.requests_per_minute)
        scope["state"]["caller"] = caller
        length = headers.get(b"content-length", "0")
        if not length.isdigit() or int(length) > self.settings.max_bytes:
            raise _too_many_bytes(self.settings.max_bytes)
        if headers.get(b"content-encoding", "identity") != "identity":
            raise Problem(415, "send the body without Content-Encoding")

    def _check_host(self, host: str) -> None:
        name = _hostname(host)
        if name in self.hosts or (is_loopback(name) and self.settings.is_local):
            return
        if self.settings.keys and not self.settings.hosts:
            return  # every request needs a key, which another site's page has not
        raise Problem(403, "the Host header is none of the service's names", "host_unknown")

    def _check_origin(self, headers: dict[bytes, str]) -> None:
        origin = headers.get(b"origin")
        if origin in self.settings.origins:
            return
        if origin is not None and _netloc(origin) != headers.get(b"host", "").lower():
            raise Problem(403, "requests of other sites' pages are refused", "cross_origin")
        if headers.get(b"sec-fetch-site", "none") not in ("none", "same-origin"):
            raise Problem(403, "requests of other sites' pages are refused", "cross_origin")

    def _record(self, scope: Scope, status: int, seconds: float) -> None:
        """Log and count a request by its route's pattern: ids and options are left out."""
        route = getattr(scope.get("route"), "path", "unknown")
        method = scope.get("method", "WS")
        self.metrics.request(method, route, status, seconds)
        log.info("%s %s %d %.1f ms", method, route, status, 1000 * seconds)


class _Body:
    """The body of one request, counted while it comes in."""

    def __init__(self, receive: Receive, settings: Settings) -> None:
        self.receive, self.most = receive, settings.max_bytes
        self.end = monotonic() + settings.body_seconds
        self.seconds = settings.body_seconds
        self.n_bytes, self.is_whole = 0, False

    async def __call__(self) -> Message:
        if self.is_whole:  # waiting for the client to go
            return await self.receive()
        try:
            message = await asyncio.wait_for(self.receive(), max(self.end - monotonic(), 0.001))
        except TimeoutError:
            raise Problem(
                400,
                f"the body took more than {self.seconds:g} s; send it faster, or less",
                "body_slow",
                headers={"Connection": "close"},
            ) from None
        if message["type"] == "http.request":
            self.n_bytes += len(message.get("body", b""))
            self.is_whole = not message.get("more_body", False)
            if self.n_bytes > self.most:
                raise _too_many_bytes(self.most)
        return message


async def _refuse(scope: Scope, problem: Problem, send: Send) -> None:
    body = json.dumps(problem.content).encode()
    headers = {"content-type": MEDIA_TYPE, "content-length": str(len(body)), **problem.headers}
    raw = [(name.lower().encode(), value.encode()) for name, value in headers.items()]
    if scope["type"] == "websocket":
        if "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008})
            return
        start, end = "websocket.http.response.start", "websocket.http.response.body"
    else:
        start, end = "http.response.start", "http.response.body"
    await send({"type": start, "status": problem.status, "headers": raw})
    await send({"type": end, "body": body})


def _key(headers: dict[bytes, str]) -> str | None:
    scheme, _, key = headers.get(b"authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return key.strip()
    for part in headers.get(b"sec-websocket-protocol", "").split(","):
        if part.strip().startswith(KEY_SUBPROTOCOL):
            return part.strip().removeprefix(KEY_SUBPROTOCOL)
    return None


def _hostname(host: str) -> str:
    """Name or address of a Host header, without its port; empty if it is malformed."""
    if len(host) > 255 or not all(c.isalnum() or c in ".:[]-_" for c in host):
        return ""
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:  # a bracket without the other
        return ""


def _is_address(host: str) -> bool:
    try:
        ip_address(_hostname(host))
    except ValueError:
        return False
    return True


def _netloc(origin: str) -> str:
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return ""


def _too_many_bytes(most: int) -> Problem:
    return Problem(413, f"the body may have at most {most} bytes", headers={"Connection": "close"})
