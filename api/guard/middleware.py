"""Checks of every request before a route: host, origin, key, rate, size and pace of its body.

::

    Host      one of the settings' names: another site cannot point its own name here
    Origin    none or this service's: a page of another site cannot send requests
    key       see `api.guard.keys`
    places    no key, without keys no address, holds more than are free for others
    body      at most `max_bytes`; whole in `body_seconds`, with one more for each `SECOND_BYTES`
"""

import asyncio
import json
import logging
import re
import secrets
from contextlib import AbstractContextManager, nullcontext, suppress
from ipaddress import ip_address
from time import monotonic, perf_counter
from typing import Any
from urllib.parse import urlsplit

import anyio
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect

from api.errors import MEDIA_TYPE, Problem, describe, problem_for
from api.guard.keys import KeyRing, Places, Rates, client_of
from api.guard.metrics import Metrics
from api.guard.traces import Traces, parent_of
from api.settings import Settings, is_loopback

STUDIO_PATH = "/"
OPEN_PATHS = ("/healthz", "/readyz", "/docs", "/openapi.json", "/sample", STUDIO_PATH)
"""Answered without a key: they tell nothing about anyone's work."""
PROBE_PATHS = ("/healthz", "/readyz")
"""Answered without a count. Balancers and the container itself get these by the service's
address, which is none of `hosts`; another site's page has a name."""
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
REQUEST_ID = b"x-request-id"
NO_PATH = "there is no such path; /docs lists all"
SECOND_BYTES = 64 * 1024
"""Fewest bytes a second of a body that takes longer than `body_seconds`."""
SPAN_FACTS = ("request", "key", "key_id")
_PLAIN_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
log = logging.getLogger("deitalk.service")


class _Active:
    """A request at work, which can be ended from outside."""

    def __init__(self, scope: Scope) -> None:
        self.scope, self.cancelling = scope, anyio.CancelScope()
        self.status, self.is_stream = 0, scope["type"] == "websocket"
        self.is_complete, self.is_ended = False, False

    def end(self) -> None:
        """End it; an answer that has not begun becomes Problem 503."""
        self.is_ended = True
        self.cancelling.cancel()


class Traffic:
    """The requests at work, but for probes; their places and their spans.

    Parameters
    ----------
    most : int
        Requests at work, event streams, sessions and those whose bodies come among them.
    """

    def __init__(self, most: int) -> None:
        self.active: set[_Active] = set()
        self.places = Places(most)
        self.is_draining = False
        self.traces = Traces()

    def drain(self) -> None:
        """Refuse what comes now, and end streams, whose clients connect to another server."""
        self.is_draining = True
        for active in [active for active in self.active if active.is_stream]:
            active.end()

    def end_all(self) -> None:
        """End every request at work."""
        for active in list(self.active):
            active.end()


class Guard:
    """ASGI middleware around the application."""

    def __init__(
        self, app: ASGIApp, settings: Settings, metrics: Metrics, traffic: Traffic
    ) -> None:
        self.app, self.settings, self.metrics, self.traffic = app, settings, metrics, traffic
        self.keys, self.rates = KeyRing(settings), Rates()
        self.hosts = {name.lower() for name in (*settings.hosts, settings.host)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a refused request here; pass on any other."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        began, active = perf_counter(), _Active(scope)
        # The request's own id where it is a plain one, else a new one.
        identity = dict(scope["headers"]).get(REQUEST_ID, b"").decode("latin-1")
        if not _PLAIN_ID.fullmatch(identity):
            identity = secrets.token_hex(8)
        scope.setdefault("state", {})["request"] = identity

        async def sent(message: Message) -> None:
            if message["type"] == "websocket.close" and not active.status:
                await _refuse(scope, Problem(404, NO_PATH), sent)
                return
            await send(_noted(message, active, identity))

        is_probe = scope["path"] in PROBE_PATHS
        if not is_probe:
            self.traffic.active.add(active)
        parent = None if is_probe else parent_of(dict(scope["headers"]))
        with self.traffic.traces.span("request", parent) as facts:
            scope["state"]["trace"] = facts["parent"]
            try:
                await self._answer(active, receive, sent)
            finally:
                self.traffic.active.discard(active)
                self._record(scope, active.status, perf_counter() - began, facts)

    async def _answer(self, active: _Active, receive: Receive, send: Send) -> None:
        """Answer a request; its work ends when its client goes, or when it is ended."""
        if active.scope["type"] == "websocket":
            with active.cancelling:
                await self._run(active, receive, send)
        else:
            body = _Body(receive, self.settings)
            async with anyio.create_task_group() as group:
                active.cancelling = group.cancel_scope
                group.start_soon(body.watch, active)
                await self._run(active, body, send)
                group.cancel_scope.cancel()
        if active.is_ended and not active.is_complete:
            # Answer a request that was ended because the server ends.
            problem = _ending()
            if active.status == 0:
                await _refuse(active.scope, problem, send)
            elif active.scope["type"] == "websocket":
                text = json.dumps({"type": "problem", **problem.content})
                await send({"type": "websocket.send", "text": text})
                await send({"type": "websocket.close", "code": 1012})
            elif active.is_stream:
                event = f"event: {problem.code}\ndata: {json.dumps(problem.content)}\n\n"
                await send({"type": "http.response.body", "body": event.encode()})

    async def _run(self, active: _Active, receive: Receive, send: Send) -> None:
        scope = active.scope
        inner = dict(scope)
        if scope.get("method") == "HEAD":  # the answer to GET, which has no parts
            headers = [header for header in scope["headers"] if header[0] != b"range"]
            inner |= {"method": "GET", "headers": headers}
            send = _head_alone(active, send)
        try:
            with self._admit(scope):
                await self.app(inner, receive, send)
        except WebSocketDisconnect:  # in the handshake
            return
        except Exception as error:
            if active.status:  # the answer has begun: the connection is closed
                log.error("an answer broke off: %s", describe(error))
                return
            await _refuse(scope, problem_for(error), send)
        finally:
            scope["route"] = inner.get("route")

    def _admit(self, scope: Scope) -> AbstractContextManager[None]:
        """The place of a request that is not refused, to be held while it is at work."""
        n_bytes = sum(len(name) + len(value) for name, value in scope["headers"])
        if len(scope["headers"]) > MOST_HEADERS or n_bytes > HEADER_BYTES:
            raise Problem(
                400, f"at most {MOST_HEADERS} headers of {HEADER_BYTES} bytes", "headers_large",
                headers={"Connection": "close"},
            )  # fmt: skip
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        if b"transfer-encoding" in headers and b"content-length" in headers:  # RFC 9112, 6.1
            raise Problem(
                400, "Content-Length beside Transfer-Encoding: send one of both",
                headers={"Connection": "close"},
            )  # fmt: skip
        self._check_host(headers.get(b"host", ""), is_probe=scope["path"] in PROBE_PATHS)
        if scope["path"] != STUDIO_PATH:  # a link of another site may open it
            self._check_origin(headers)
        if scope["path"] in PROBE_PATHS:
            return nullcontext()
        if self.traffic.is_draining:
            raise _ending()
        address = client_of((scope.get("client") or ("unknown",))[0])
        if scope["path"] in OPEN_PATHS:
            self.rates.take(f"address {address}", self.settings.requests_per_minute)
            return self.traffic.places.hold(f"address {address}")
        try:
            caller = self.keys.caller(_key(headers), address)
        except Problem:
            self.rates.take(f"address {address}", self.settings.requests_per_minute)
            raise
        self.rates.take(caller.holder, caller.requests_per_minute)
        scope["state"]["caller"] = caller
        length = headers.get(b"content-length", "0")
        if not length.isdigit() or int(length) > self.settings.max_bytes:
            raise _too_many_bytes(self.settings.max_bytes)
        if headers.get(b"content-encoding", "identity") != "identity":
            raise Problem(415, "send the body without Content-Encoding")
        return self.traffic.places.hold(caller.holder, caller.concurrent)

    def _check_host(self, host: str, *, is_probe: bool) -> None:
        name = _hostname(host)
        if name in self.hosts or (is_loopback(name) and self.settings.is_local):
            return
        if is_probe:
            with suppress(ValueError):
                ip_address(name)
                return
        if self.settings.keys and not self.settings.hosts:
            return  # every request needs a key, which another site's page has not
        raise Problem(403, "the Host header is none of the service's names", "host_unknown")

    def _check_origin(self, headers: dict[bytes, str]) -> None:
        origin = headers.get(b"origin")
        if origin in self.settings.origins:
            return
        is_own = headers.get(b"sec-fetch-site", "none") in ("none", "same-origin")
        if origin is not None:
            site = origin.lower().partition("://")[2]
            is_own = is_own and site != "" and site == headers.get(b"host", "").lower()
        if not is_own:
            raise Problem(403, "requests of other sites' pages are refused", "cross_origin")

    def _record(self, scope: Scope, status: int, seconds: float, span: dict[str, Any]) -> None:
        """Log and count a request by its route's pattern: options and ids of jobs are left out."""
        route = getattr(scope.get("route"), "path", "unknown")
        method = scope.get("method", "WS")
        self.metrics.request(method, route, status, seconds)
        caller = scope["state"].get("caller")
        facts = {"method": method, "route": route, "status": status, "ms": round(1000 * seconds, 1)}
        facts["request"] = scope["state"]["request"]
        if caller is not None:
            facts |= {"key": caller.name, "key_id": caller.id}
        span |= {"name": f"{method} {route}", "http.route": route} | {
            "http.request.method": method, "http.response.status_code": status,
            **{f"deitalk.{name}": value for name, value in facts.items() if name in SPAN_FACTS},
        }  # fmt: skip
        log.info("%s %s %d %.1f ms", *list(facts.values())[:4], extra={"facts": facts})


class _Body:
    """The body of one request, counted while it comes in."""

    def __init__(self, receive: Receive, settings: Settings) -> None:
        self.receive, self.most = receive, settings.max_bytes
        self.end = monotonic() + settings.body_seconds
        self.seconds = settings.body_seconds
        self.n_bytes, self.is_whole = 0, False
        self.whole = asyncio.Event()

    async def watch(self, active: _Active) -> None:
        """Cancel the work on a request whose client goes."""
        await self.whole.wait()
        await self.receive()
        if not active.is_complete:
            active.cancelling.cancel()

    async def __call__(self) -> Message:
        if self.is_whole:  # waiting for the client to go
            return await self.receive()
        try:
            left = self.end + self.n_bytes / SECOND_BYTES - monotonic()
            message = await asyncio.wait_for(self.receive(), max(left, 0.001))
        except TimeoutError:
            raise Problem(
                400,
                f"the body took {self.seconds:g} s and more than one for each {SECOND_BYTES >> 10} "
                "KiB; send it faster",
                "body_slow",
                headers={"Connection": "close"},
            ) from None
        if message["type"] == "http.request":
            self.n_bytes += len(message.get("body", b""))
            if not message.get("more_body", False):
                self.is_whole = True
                self.whole.set()
            if self.n_bytes > self.most:
                raise _too_many_bytes(self.most)
        return message


def _noted(message: Message, active: _Active, identity: str) -> Message:
    """Note where an answer is, and return its message with the headers of every answer."""
    kind = message["type"]
    if kind.endswith("response.body"):
        active.is_complete = not message.get("more_body", False)
    if kind == "websocket.close":
        active.is_complete = True
    if not kind.endswith(("response.start", "websocket.accept")):
        return message
    active.status = message.get("status", 101)
    headers = list(message.get("headers", ()))
    given = {name.lower(): value for name, value in headers}
    active.is_stream |= given.get(b"content-type", b"").startswith(b"text/event-stream")
    added = [(REQUEST_ID, identity.encode()), *(ADDED_HEADERS if "status" in message else ())]
    headers += [header for header in added if header[0] not in given]
    return dict(message) | {"headers": headers}


def _head_alone(active: _Active, send: Send) -> Send:
    """End the work on an answer once its headers are sent."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.body":
            await send({"type": "http.response.body", "body": b""})
            active.cancelling.cancel()
            return
        await send(message)

    return sent


def _ending() -> Problem:
    headers = {"Retry-After": "1", "Connection": "close"}
    return Problem(503, "the server ends; send it again", "draining", headers=headers)


async def _refuse(scope: Scope, problem: Problem, send: Send) -> None:
    length = str(len(problem.body))
    headers = {"content-type": MEDIA_TYPE, "content-length": length, **problem.headers}
    raw = [(name.lower().encode(), value.encode()) for name, value in headers.items()]
    if scope["type"] == "websocket":
        start, end = "websocket.http.response.start", "websocket.http.response.body"
    else:
        start, end = "http.response.start", "http.response.body"
    await send({"type": start, "status": problem.status, "headers": raw})
    await send({"type": end, "body": problem.body})


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


def _too_many_bytes(most: int) -> Problem:
    return Problem(413, f"the body may have at most {most} bytes", headers={"Connection": "close"})
